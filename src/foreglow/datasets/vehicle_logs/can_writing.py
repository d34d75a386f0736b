"""Street messages and motions written as a CAN log by our own DBC, for tests and for other tools."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from foreglow.datasets.vehicle_logs.can_log import OWN_DBC, OWN_MAPPING, read_mapping
from foreglow.datasets.vehicle_logs.dbc import read_dbc
from foreglow.datasets.vehicle_logs.log_frames import LOG_SUFFIXES
from foreglow.datasets.vehicle_logs.street_frames import position_values, segment_values
from foreglow.files import checked_path
from foreglow.street import NUM_SEGMENT_IDS, StreetMessage
from foreglow.types import EgoMotion
from foreglow.types.arrays import check_kind, checked_time_ns
from foreglow.whole_files import write_atomic
from foreglow.wording import shortened

if TYPE_CHECKING:
    import can

Sent = TypeVar("Sent")

FIRST_DATE_S = 631_152_000
"""The first of January 1990; python-can takes earlier times for no dates."""


def write_can_log(
    path: Path | str,
    streets: Iterable[tuple[int, StreetMessage]],
    motions: Iterable[tuple[int, EgoMotion]] = (),
) -> None:
    """Writes a CAN log that `read_can_log` reads back; speeds to 0.01 m/s, yaw rates to 0.0001 rad/s.

    A street message becomes a frame for each segment and then a frame for the position, all at its time. Times are kept
    to a microsecond; an .asc file counts them from its first frame.

    Args:
        path: The file, which ends in .asc, .blf or .log.
        streets: Times in nanoseconds, and messages whose segments follow each other.
        motions: Times in nanoseconds, and motions; the pitch is not written.

    Raises:
        ModuleNotFoundError: If cantools or python-can is not installed (extra `can`).
        ValueError: If the ending is another, there is nothing to write, the segments of a message do not follow each
            other, or a motion does not fit into a frame.
        OSError: If it cannot be written.
    """
    import can

    path = checked_path(path)
    if path.suffix.lower() not in LOG_SUFFIXES:
        raise ValueError(f"{path}: expected a CAN log that ends in {', '.join(LOG_SUFFIXES)}, got {path.suffix!r}")
    streets, motions = _timed("streets", streets, StreetMessage), _timed("motions", motions, EgoMotion)
    frames = _Encoder().frames(streets, motions)
    ordered = sorted(frames, key=lambda frame: frame.timestamp)
    if not ordered:
        raise ValueError(f"{path}: expected at least one message or motion to write, got none")
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / f"log{path.suffix.lower()}"
        with can.Logger(temporary) as log:
            keep_times(log, ordered[0].timestamp)
            for frame in ordered:
                log(frame)
        write_atomic(path, temporary.read_bytes())


def keep_times(log: Any, first_s: float) -> None:
    """Has a new log of python-can, where it is a .blf, keep times that are no dates as they are.

    Its header has the date of its beginning, from which all times count; for earlier ones it has none, and times from
    the first frame on would be taken for times from 0 on.

    Args:
        log: The log, into which nothing was written yet.
        first_s: Time of its first frame.
    """
    import can

    if isinstance(log, can.BLFWriter) and 0 <= first_s < FIRST_DATE_S:
        log.start_timestamp = 0.0


def _timed(field: str, values: object, kind: type[Sent]) -> tuple[tuple[int, Sent], ...]:
    """What is sent, each with its time; ValueError if it is something else."""
    check_kind(field, values, Iterable)
    given: tuple[Any, ...] = tuple(values)  # type: ignore[arg-type]
    for pair in given:
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not isinstance(pair[1], kind):
            raise ValueError(f"{field}: expected times, each with a {kind.__name__}, got {shortened(pair)}")
        checked_time_ns(field, pair[0])
    return given


class _Encoder:
    def __init__(self) -> None:
        self._messages = read_dbc(OWN_DBC)
        self._sections = dict(read_mapping(OWN_MAPPING).sections())

    def frames(
        self, streets: Iterable[tuple[int, StreetMessage]], motions: Iterable[tuple[int, EgoMotion]]
    ) -> Iterator[can.Message]:
        """The frames; those of a message in the order in which they are sent."""
        for time_ns, message in streets:
            _check_order(message, time_ns)
            for segment in message.segments:
                yield self._frame("segment", segment_values(segment), time_ns)
            yield self._frame("position", position_values(message), time_ns)
        for time_ns, motion in motions:
            values = {"Speed": motion.speed_mps, "YawRate": motion.yaw_rate_radps}
            yield self._encoded(self._sections["speed"].message, values, time_ns)

    def _frame(self, section: str, values: dict[str, float], time_ns: int) -> can.Message:
        signals = self._sections[section].signals()
        return self._encoded(
            self._sections[section].message, {signals[field]: value for field, value in values.items()}, time_ns
        )

    def _encoded(self, name: str, values: dict[str, float], time_ns: int) -> can.Message:
        import can
        import cantools

        message: Any = self._messages[name]
        try:
            data = message.encode(values)
        except cantools.Error as error:
            raise ValueError(f"{name} at {time_ns} ns: {error}") from None
        return can.Message(
            timestamp=time_ns / 1e9,
            arbitration_id=message.frame_id,
            is_extended_id=message.is_extended_frame,
            data=data,
        )


def _check_order(message: StreetMessage, time_ns: int) -> None:
    numbers = [segment.segment_id for segment in message.segments]
    for index, segment in enumerate(message.segments):
        if index and segment.parent_id != numbers[index - 1]:
            raise ValueError(
                f"street message at {time_ns} ns: segments.{index}.parent_id: expected {numbers[index - 1]}, the "
                f"segment before it, got {segment.parent_id}"
            )
    if len(set(numbers)) < len(numbers) or not all(1 <= number <= NUM_SEGMENT_IDS for number in numbers):
        raise ValueError(
            f"street message at {time_ns} ns: segment_id: expected numbers of 1 to {NUM_SEGMENT_IDS}, each once, got "
            f"{numbers}"
        )
