"""What the car knew in a simulated drive: the part of the truth that a real car has, too."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from foreglow.calibration import read_calibration
from foreglow.datasets.json_files import Record, read_json_lines
from foreglow.datasets.vehicle_data import VehicleData
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
        self._camera = cache(self._read_camera)
        self._frames = cache(self._read_frames)

    def camera(self, frame: Frame) -> Camera | None:
        """The drive's calibration.

        Raises:
            ValueError: If `camera.toml` is broken.
        """
        return self._camera(frame.sequence)

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Speed and yaw rate, as wheels and a gyroscope measure them; the pitch of the body is not known.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        known = self._frames(frame.sequence).get(frame.frame)
        return None if known is None else EgoMotion(known.ego_speed_mps, known.ego_yaw_rate_radps)

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead by the street message.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        known = self._frames(frame.sequence).get(frame.frame)
        return None if known is None else road_from_message(known.street)

    def _read_camera(self, sequence: str) -> Camera | None:
        path = self._root / sequence / "camera.toml"
        return read_calibration(path) if path.exists() else None

    def _read_frames(self, sequence: str) -> dict[int, _CarTruth]:
        path = self._root / sequence / "frames.jsonl"
        return {known.image_id: known for _, known in read_json_lines(path, _CarTruth)} if path.exists() else {}
