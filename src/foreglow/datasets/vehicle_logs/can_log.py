"""A CAN log as what a car knew at any time: the latest street message and the latest motion."""

from __future__ import annotations

import math
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from foreglow.config import read_toml, validated
from foreglow.datasets.vehicle_logs.mapping import CanMapping, NumberSignal
from foreglow.datasets.vehicle_logs.street_frames import StreetFrames
from foreglow.street import StreetMessage
from foreglow.types import EgoMotion

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

STREET_STALE_S = 1.0
"""A street message that is older is no longer used."""

MOTION_STALE_S = 0.5
"""Nor a speed or a yaw rate that is older."""

LOG_SUFFIXES = (".asc", ".blf", ".log")
"""Vector's text and binary logs, and candump's."""

OWN_DBC, OWN_MAPPING = (Path(__file__).with_name(name) for name in ("street.dbc", "street.toml"))

Value = TypeVar("Value")


class Latest(Generic[Value]):
    """Values over time, of which the latest counts.

    Attributes:
        times_ns: Their times, not falling.
        values: As many.
        stale_s: How long one counts.
    """

    def __init__(self, pairs: Sequence[tuple[int, Value]], stale_s: float) -> None:
        ordered = sorted(pairs, key=lambda pair: pair[0])
        self.times_ns = [time_ns for time_ns, _ in ordered]
        self.values = [value for _, value in ordered]
        self.stale_s = stale_s

    def at(self, timestamp_ns: int) -> Value | None:
        """The latest value at or before a time; None where there is none, or it is stale."""
        place = bisect_right(self.times_ns, timestamp_ns) - 1
        if place < 0 or timestamp_ns - self.times_ns[place] > self.stale_s * 1e9:
            return None
        return self.values[place]


class CanLog:
    """What a car told on its bus over time.

    Attributes:
        first_ns: Time of the first frame that was used.
        last_ns: Time of the last.
        has_street: Whether any whole street message is in it.
    """

    def __init__(
        self,
        streets: Sequence[tuple[int, StreetMessage | None]],
        speeds_mps: Sequence[tuple[int, float]],
        yaw_rates_radps: Sequence[tuple[int, float]],
    ) -> None:
        """Takes values with their times in nanoseconds, at least one; None is a position that the car does not know."""
        self._streets = Latest(streets, STREET_STALE_S)
        self._speeds_mps = Latest(speeds_mps, MOTION_STALE_S)
        self._yaw_rates_radps = Latest(yaw_rates_radps, MOTION_STALE_S)
        times_ns = [*self._streets.times_ns, *self._speeds_mps.times_ns, *self._yaw_rates_radps.times_ns]
        self.first_ns, self.last_ns = min(times_ns), max(times_ns)
        self.has_street = any(message is not None for _, message in streets)

    def street(self, timestamp_ns: int) -> StreetMessage | None:
        """The street message of the latest position at or before a time; None if it is stale or unknown."""
        return self._streets.at(timestamp_ns)

    def motion(self, timestamp_ns: int) -> EgoMotion | None:
        """The latest speed and yaw rate at or before a time; None if one is stale."""
        speed_mps, yaw_rate_radps = self._speeds_mps.at(timestamp_ns), self._yaw_rates_radps.at(timestamp_ns)
        if speed_mps is None or yaw_rate_radps is None:
            return None
        return EgoMotion(speed_mps, yaw_rate_radps)


def read_can_log(path: Path | str, dbc: Path | None = None, mapping: Path | None = None) -> CanLog:
    """The CAN log in the file `path`: Vector's .asc or .blf, or candump's .log.

    The times of .asc count from its start. Frames that the mapping does not name are passed over, and so are
    multiplexed ones without its signals.

    Args:
        path: The log.
        dbc: What is in the frames; None for our own, as `write_can_log` writes.
        mapping: What its signals mean; goes with `dbc`.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If cantools or python-can is not installed (extra `can`).
        ValueError: If a file is broken, the mapping names what the DBC does not have, or no frame of it is in the log.
    """
    path = Path(path)
    if (dbc is None) != (mapping is None):
        raise ValueError(f"{dbc or mapping}: expected a DBC and a mapping together, got one of them")
    return _Decoder(dbc or OWN_DBC, mapping or OWN_MAPPING).read(path)


def read_mapping(path: Path) -> CanMapping:
    """The mapping in the TOML file `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is missing or unknown.
    """
    return validated(CanMapping, read_toml(path), str(path))


def read_dbc(path: Path) -> dict[str, Message]:
    """The messages in the DBC file `path`, by name.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If cantools is not installed.
        ValueError: If it is no DBC.
    """
    import cantools

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        # Not strict: public descriptions of real cars have signals that overlap.
        database = cantools.database.load_file(path, database_format="dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise ValueError(f"{path}: expected a DBC file: {error}") from None
    return {message.name: message for message in cast("Database", database).messages}


class _Decoder:
    """Turns frames into values, by a DBC and a mapping that fits it."""

    def __init__(self, dbc: Path, mapping: Path) -> None:
        messages = read_dbc(dbc)
        self._mapping = read_mapping(mapping)
        self._sections: dict[tuple[int, bool], tuple[Message, list[tuple[str, dict[str, str]]]]] = {}
        for name, section in self._mapping.sections():
            if section.message not in messages:
                known = ", ".join(sorted(messages)[:20])
                raise ValueError(
                    f"{mapping}: {name}.message: expected a message of {dbc}, such as {known}, got {section.message!r}"
                )
            message = messages[section.message]
            signals = {one.name for one in message.signals}
            for field, signal in section.signals().items():
                if signal not in signals:
                    raise ValueError(
                        f"{mapping}: {name}.{field}: expected a signal of {section.message}, one of "
                        f"{', '.join(sorted(signals))}, got {signal!r}"
                    )
            key = message.frame_id, message.is_extended_frame
            self._sections.setdefault(key, (message, []))[1].append((name, section.signals()))

    def read(self, path: Path) -> CanLog:
        """What the log at `path` tells."""
        streets: list[tuple[int, StreetMessage | None]] = []
        numbers: dict[str, list[tuple[int, float]]] = {"speed": [], "yaw_rate": []}
        frames = StreetFrames(self._mapping)
        for time_ns, section, values in self._values(path):
            if section == "segment":
                frames.add_segment(values, time_ns)
            elif section == "slope":
                frames.add_slope(values)
            elif section == "position":
                streets.append((time_ns, frames.message(values, time_ns)))
            else:
                numbers[section].append((time_ns, _number(values, getattr(self._mapping, section))))
        if not streets and not any(numbers.values()):
            names = ", ".join(message.name for message, _ in self._sections.values())
            raise ValueError(f"{path}: expected frames of {names}, got none")
        return CanLog(streets, numbers["speed"], numbers["yaw_rate"])

    def _values(self, path: Path) -> Iterator[tuple[int, str, dict[str, float]]]:
        """For each frame that a section names, in order of time: the time, the section and its values by field."""
        for time_ns, key, data in sorted(_frames(path, self._sections), key=lambda frame: frame[0]):
            message, sections = self._sections[key]
            decoded = _decoded(message, data, f"{path}: frame at {time_ns / 1e9:.6f} s")
            for name, signals in sections:
                if all(signal in decoded for signal in signals.values()):
                    yield time_ns, name, {field: decoded[signal] for field, signal in signals.items()}


def _frames(path: Path, keys: Any) -> list[tuple[int, tuple[int, bool], bytes]]:
    """Time, key and data of the frames in a log whose key (id, is extended) is among `keys`."""
    import can
    from can.io.blf import BLFParseError

    readers: dict[str, Any] = dict(
        zip(LOG_SUFFIXES, (can.ASCReader, can.BLFReader, can.CanutilsLogReader), strict=True)
    )
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a CAN log that ends in {', '.join(LOG_SUFFIXES)}, got {path.suffix!r}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    found = []
    try:
        # Opened here: BLFReader leaves a broken file open. Text is ASCII but for comments, in whatever encoding.
        with path.open("rb") if reader is can.BLFReader else path.open(encoding="latin-1") as file, reader(file) as log:
            for frame in log:
                key = frame.arbitration_id, bool(frame.is_extended_id)
                if key in keys and not (frame.is_error_frame or frame.is_remote_frame):
                    found.append((round(frame.timestamp * 1e9), key, bytes(frame.data)))
    # What python-can's readers raise for a broken file is not documented.
    except (ValueError, LookupError, EOFError, struct.error, zlib.error, BLFParseError) as error:
        raise ValueError(f"{path}: expected a CAN log of the kind {path.suffix}: {error}") from None
    return found


def _decoded(message: Message, data: bytes, where: str) -> dict[str, float]:
    """The finite signals of a frame; a multiplexed one has only some."""
    import cantools

    try:
        decoded = message.decode(data, decode_choices=False)
    except cantools.Error as error:
        raise ValueError(f"{where}: {message.name}: {error}") from None
    values: dict[Any, Any] = dict(decoded)
    return {name: float(value) for name, value in values.items() if math.isfinite(value)}


def _number(values: dict[str, float], section: NumberSignal) -> float:
    value = values["signal"] * section.factor
    return -abs(value) if values.get("is_negative") else value
