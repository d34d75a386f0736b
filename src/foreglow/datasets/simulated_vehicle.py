"""What the car knew in a simulated drive: the part of the truth beside its images that a real car has, too."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from foreglow.calibration import read_calibration
from foreglow.datasets.json_files import Record, parse_json
from foreglow.geometry import Camera
from foreglow.street import StreetMessage, road_from_message
from foreglow.types import EgoMotion, Frame, RoadAhead


class _CarRecord(Record):
    """The fields of a line of `frames.jsonl` that a car knows; those that only a simulator knows are passed over."""

    image_id: int
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    street: StreetMessage


class SimulatedVehicle:
    """The vehicle data of a simulated split, `SPLIT/simulation/S00001`: exact calibration, speed and yaw rate, and the
    street message with its errors. Sequences without such a folder have none.

    Its files are read when a frame of their sequence is first asked for.
    """

    def __init__(self, split: Path) -> None:
        self._root = split / "simulation"
        self._camera = cache(self._read_camera)
        self._records = cache(self._read_records)

    def camera(self, frame: Frame) -> Camera | None:
        """The drive's calibration.

        Raises:
            ValueError: If `camera.toml` is broken.
        """
        return self._camera(frame.sequence)

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Speed and yaw rate, as wheels and a gyroscope tell them; the pitch of the body is not known.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        record = self._records(frame.sequence).get(frame.frame)
        return None if record is None else EgoMotion(record.ego_speed_mps, record.ego_yaw_rate_radps)

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road that the street message tells.

        Raises:
            ValueError: If `frames.jsonl` is broken.
        """
        record = self._records(frame.sequence).get(frame.frame)
        return None if record is None else road_from_message(record.street)

    def _read_camera(self, sequence: str) -> Camera | None:
        path = self._root / sequence / "camera.toml"
        return read_calibration(path) if path.exists() else None

    def _read_records(self, sequence: str) -> dict[int, _CarRecord]:
        path = self._root / sequence / "frames.jsonl"
        if not path.exists():
            return {}
        lines = enumerate(path.read_bytes().splitlines())
        records = (parse_json(line, _CarRecord, f"{path}: line {place + 1}") for place, line in lines)
        return {record.image_id: record for record in records}
