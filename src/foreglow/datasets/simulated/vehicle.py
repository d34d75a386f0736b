"""What the car knew in a simulated drive, as a real car does, and its light at other drivers' eyes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from foreglow.calibration import read_calibration
from foreglow.datasets.json_files import Record, read_json_lines
from foreglow.datasets.simulated.files import MAX_FRAMES, SequenceTruth, read_truth
from foreglow.datasets.vehicle_data import VehicleData, fitting
from foreglow.geometry import Camera
from foreglow.street import StreetMessage, road_from_message
from foreglow.types import EgoMotion, Frame, RoadAhead


class _CarTruth(Record):
    """The fields of a `FrameTruth` that a car knows; the others are not read."""

    image_id: int
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    street: StreetMessage


class SimulatedVehicle(VehicleData):
    """The vehicle data of a simulated split: exact calibration, speed and yaw rate, and the street message with its
    errors. Sequences without a folder `SPLIT/simulation/S00001` have none.

    A sequence's files are read when its first frame is asked for.
    """

    def __init__(self, split: Path) -> None:
        self._root = split / "simulation"
        # By sequence, and of a camera by the frames' size; dictionaries, as sources are pickled.
        self._cameras: dict[tuple[str, tuple[int, int]], Camera | None] = {}
        self._frames: dict[str, dict[int, _CarTruth]] = {}

    def camera(self, frame: Frame) -> Camera | None:
        """The drive's calibration, scaled to the frame's size.

        Raises:
            ValueError: If `camera.toml` is broken, or the frame's sides have another ratio than its.
        """
        path, size_px = self._root / frame.sequence / "camera.toml", (frame.width_px, frame.height_px)
        if (frame.sequence, size_px) not in self._cameras:
            known = read_calibration(path) if path.exists() else None
            self._cameras[frame.sequence, size_px] = None if known is None else fitting(known, *size_px, path)
        return self._cameras[frame.sequence, size_px]

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Speed and yaw rate, as wheels and a gyroscope measure them; the pitch of the body is not known.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        known = self._known(frame)
        return None if known is None else EgoMotion(known.ego_speed_mps, known.ego_yaw_rate_radps)

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead by the street message.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        known = self._known(frame)
        return None if known is None else road_from_message(known.street)

    def _known(self, frame: Frame) -> _CarTruth | None:
        if frame.sequence not in self._frames:
            self._frames[frame.sequence] = self._read_frames(frame.sequence)
        return self._frames[frame.sequence].get(frame.frame)

    def _read_frames(self, sequence: str) -> dict[int, _CarTruth]:
        path = self._root / sequence / "frames.jsonl"
        return {known.image_id: known for _, known in read_json_lines(path, _CarTruth)} if path.exists() else {}


class RecordedLux:
    """The light of ours that reached each other driver's eye, for a frame of a simulated split.

    It is the light of the beam with which the drive was simulated, whatever the beam is commanded to do now.
    """

    def __init__(self, split: Path) -> None:
        """Lists the sequences; each is read when its first frame comes.

        Raises:
            FileNotFoundError: If the split is not simulated.
            ValueError: If its `info.json` is broken.
        """
        self._truth = read_truth(split)
        self._latest: SequenceTruth | None = None

    def __call__(self, frame: Frame) -> Mapping[str, float]:
        """Lux by kind and number of the vehicle, such as `car 0`; empty where nothing is known about the sequence.

        Raises:
            ValueError: If the truth is broken; the message names path, line and field.
        """
        sequence_id = frame.frame // MAX_FRAMES
        if sequence_id not in self._truth.sequence_ids:
            return {}
        if self._latest is None or self._latest.sequence_id != sequence_id:
            self._latest = self._truth.sequence(sequence_id)
        vehicles = self._latest.frame(frame.frame).vehicles
        return {f"{vehicle.kind} {vehicle.vehicle_id}": vehicle.eye_lx.get("ego", 0.0) for vehicle in vehicles}
