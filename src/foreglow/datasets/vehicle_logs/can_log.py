"""CAN logs: the latest street message, motion, and report of the production system of a car at any time."""

from __future__ import annotations

import codecs
import io
import math
import re
import struct
import threading
import zlib
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, cast

from foreglow.config import read_toml, validated
from foreglow.datasets.vehicle_logs.mapping import CanMapping, NumberSignal
from foreglow.datasets.vehicle_logs.street_frames import StreetFrames
from foreglow.files import MIB, bounded_lines, check_file, read_text, shortened
from foreglow.street import StreetMessage
from foreglow.types import EgoMotion

if TYPE_CHECKING:
    import can
    from cantools.database.can import Database, Message

STREET_STALE_S = 1.0
"""Older street messages are not used."""

MOTION_STALE_S = 0.5
"""Older speeds, yaw rates and reports of the production system are not used."""

RESOLUTION_NS = 1000
"""Logs in text round times to a microsecond: a message that came with a frame may seem to come after it."""

MAX_DBC_BYTES = 4 * MIB
"""Largest DBC: it takes 100 times its size while it is read, and 3 s for each MiB."""

MAX_MESSAGE_BYTES = 4096
"""Longest message of a DBC: one of CAN FD has 64 bytes, one of several frames 1785."""

MAX_MULTIPLEX_VALUES = 65_536
"""Values in all ranges of multiplexed signals of a DBC: cantools lists each."""

MAX_LOG_BYTES = 1 << 32
"""Largest log: that of hours on a busy bus."""

MAX_LOG_LINE_BYTES = 1 << 16
"""Longest line of a log in text."""

MAX_LOG_FRAMES = 2_000_000
"""Frames of interest in a log, which take half a kilobyte each: hours of motion and road."""

MAX_OBJECT_BYTES = 1 << 24
"""Largest object of a .blf, unpacked; Vector's containers have 128 KiB."""

_BYTE_ORDER_MARK = codecs.BOM_UTF8.decode("latin-1")
_BLF_CONTAINER = 10
_FILE_HEAD = 24  # bytes: signature, size of the header, versions, size of the file
_MIN_BLF_BYTES = 144  # of the file's header
_OBJECT_HEAD = 16  # bytes: signature, size of the header, version, size and kind of the object

LOG_SUFFIXES = (".asc", ".blf", ".log")
"""Vector's text and binary logs, and candump's."""

OWN_DBC, OWN_MAPPING = (Path(__file__).with_name(name) for name in ("street.dbc", "street.toml"))

Value = TypeVar("Value")

CanKey: TypeAlias = tuple[int, bool]
"""A frame's identifier, and whether that is extended."""


class Latest(Generic[Value]):
    """Values over time, of which the latest counts, to `RESOLUTION_NS`.

    Attributes:
        times_ns: Their times, never falling.
        values: The values at these times.
        stale_s: A value counts for so long.
    """

    def __init__(self, stale_s: float) -> None:
        self.times_ns: list[int] = []
        self.values: list[Value] = []
        self.stale_s = stale_s

    def add(self, time_ns: int, value: Value) -> None:
        """Adds the latest value."""
        self.times_ns.append(time_ns)
        self.values.append(value)

    def at(self, timestamp_ns: int) -> Value | None:
        """The latest value at or before a time; None where there is none, or it is stale."""
        index = bisect_right(self.times_ns, timestamp_ns + RESOLUTION_NS) - 1
        if index < 0 or timestamp_ns - self.times_ns[index] > self.stale_s * 1e9:
            return None
        return self.values[index]

    def forget(self, before_ns: int) -> None:
        """Drops the values before a time."""
        num_old = bisect_left(self.times_ns, before_ns)
        del self.times_ns[:num_old], self.values[:num_old]


class CanLog:
    """What a car sent on its bus over time; a thread may add to it while another one reads.

    Attributes:
        first_ns: Time of the first value; 0 while it is empty.
        last_ns: Time of the last value.
        has_street: Whether it has a whole street message.
        is_empty: Whether it has no value.
    """

    def __init__(self, keep_s: float = math.inf) -> None:
        """An empty log, which drops values that are older than the last by more than `keep_s`."""
        self._keep_ns = keep_s * 1e9
        self._streets = Latest[StreetMessage | None](STREET_STALE_S)
        self._numbers = {name: Latest[float](MOTION_STALE_S) for name in ("speed", "yaw_rate", "production")}
        self._lock = threading.Lock()
        self.first_ns = self.last_ns = 0
        self.has_street, self.is_empty = False, True

    def add_street(self, time_ns: int, message: StreetMessage | None) -> None:
        """Adds the road at the latest position, None for an unknown position; times must not fall."""
        self.has_street |= message is not None
        self._add(self._streets, time_ns, message)

    def add_number(self, quantity: str, time_ns: int, value: float) -> None:
        """Adds a `speed` in m/s, a `yaw_rate` in rad/s, or what `production` reports; times must not fall."""
        self._add(self._numbers[quantity], time_ns, value)

    def street(self, timestamp_ns: int) -> StreetMessage | None:
        """The street message of the latest position at or before a time; None if it is stale or unknown."""
        with self._lock:
            return self._streets.at(timestamp_ns)

    def motion(self, timestamp_ns: int) -> EgoMotion | None:
        """The latest speed and yaw rate at or before a time; None if either is stale or missing."""
        speed_mps, yaw_rate_radps = self._number("speed", timestamp_ns), self._number("yaw_rate", timestamp_ns)
        if speed_mps is None or yaw_rate_radps is None:
            return None
        return EgoMotion(speed_mps, yaw_rate_radps)

    def is_reported(self, timestamp_ns: int) -> bool | None:
        """Whether the production system reports a vehicle, by its latest message; None if that is stale or missing."""
        number = self._number("production", timestamp_ns)
        return None if number is None else number > 0

    def _number(self, quantity: str, timestamp_ns: int) -> float | None:
        with self._lock:
            return self._numbers[quantity].at(timestamp_ns)

    def _add(self, latest: Latest[Value], time_ns: int, value: Value) -> None:
        with self._lock:
            self.first_ns = time_ns if self.is_empty else min(self.first_ns, time_ns)
            self.last_ns = time_ns if self.is_empty else max(self.last_ns, time_ns)
            self.is_empty = False
            latest.add(time_ns, value)
            if math.isfinite(self._keep_ns):
                latest.forget(time_ns - round(self._keep_ns))


def read_can_log(path: Path | str, dbc: Path | None = None, mapping: Path | None = None) -> CanLog:
    """The CAN log in the file `path`: Vector's .asc or .blf, or candump's .log.

    The times of .asc count from its start. Frames that the mapping does not name are ignored, and so are multiplexed
    frames without its signals.

    Args:
        path: The log.
        dbc: Description of the frames; None for our own, as `write_can_log` writes them.
        mapping: Meaning of its signals; goes with `dbc`.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If cantools or python-can is not installed (extra `can`).
        ValueError: If a file is broken, the mapping names something that the DBC does not have, or the log has none of
            its frames.
    """
    path = Path(path)
    decoder = CanDecoder(dbc, mapping)
    for time_ns, key, data in sorted(_frames(path, decoder.keys), key=lambda frame: frame[0]):
        decoder.take(time_ns, key, data, f"{path}: frame at {time_ns / 1e9:.6f} s")
    if decoder.log.is_empty:
        raise ValueError(f"{path}: expected frames of {', '.join(decoder.message_names)}, got none")
    return decoder.log


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

    text = read_text(path, MAX_DBC_BYTES, "cp1252", "replace")
    _check_dbc(text, str(path))
    try:
        # Not strict: public descriptions of real cars have signals that overlap.
        database = cantools.database.load_string(text, database_format="dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise ValueError(f"{path}: expected a DBC file: {error}") from None
    return {message.name: message for message in cast("Database", database).messages}


def _check_dbc(text: str, origin: str) -> None:
    """ValueError if a message of a DBC is too long, or its ranges are."""
    ends = [(int(size[:20]), "a message") for size in re.findall(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)", text)]
    ends += [
        ((int(start[:20]) + int(length[:20])) // 8, "a signal")
        for start, length in re.findall(r":\s*(\d+)\s*\|\s*(\d+)\s*@", text)
    ]
    longest = max(ends, default=(0, ""))
    if longest[0] > MAX_MESSAGE_BYTES:
        raise ValueError(f"{origin}: {longest[1]}: expected at most {MAX_MESSAGE_BYTES} bytes, got {longest[0]}")
    num_values = 0
    for ranges in re.findall(r"\bSG_MUL_VAL_\s([^;]*)", text):
        num_values += sum(
            abs(int(last[:20]) - int(first[:20])) for first, last in re.findall(r"(\d+)\s*-\s*(\d+)", ranges)
        )
    if num_values > MAX_MULTIPLEX_VALUES:
        raise ValueError(f"{origin}: SG_MUL_VAL_: expected ranges of at most {MAX_MULTIPLEX_VALUES}, got {num_values}")


class CanDecoder:
    """Turns frames into a log, by a DBC and a mapping of its signals.

    Attributes:
        log: The log of the frames so far.
    """

    def __init__(self, dbc: Path | None = None, mapping: Path | None = None, *, keep_s: float = math.inf) -> None:
        """Reads both files; None for our own.

        Args:
            dbc: Description of the frames.
            mapping: Meaning of its signals; goes with `dbc`.
            keep_s: Values are kept for so long.

        Raises:
            FileNotFoundError: If there is no such file.
            ModuleNotFoundError: If cantools is not installed (extra `can`).
            ValueError: If a file is broken, or the mapping names something that the DBC does not have.
        """
        if (dbc is None) != (mapping is None):
            raise ValueError(f"{dbc or mapping}: expected a DBC and a mapping together, got one of them")
        dbc, mapping = dbc or OWN_DBC, mapping or OWN_MAPPING
        self.log = CanLog(keep_s)
        messages = read_dbc(dbc)
        self._mapping = read_mapping(mapping)
        self._street_frames = StreetFrames(self._mapping)
        self._sections: dict[CanKey, tuple[Message, list[tuple[str, dict[str, str]]]]] = {}
        for name, section in self._mapping.sections():
            if section.message not in messages:
                known = ", ".join(sorted(messages)[:20])
                raise ValueError(
                    f"{mapping}: {name}.message: expected a message of {dbc}, such as {known}, got {section.message!r}"
                )
            message = messages[section.message]
            signals = {signal.name for signal in message.signals}
            for field, name_in_dbc in section.signals().items():
                if name_in_dbc not in signals:
                    raise ValueError(
                        f"{mapping}: {name}.{field}: expected a signal of {section.message}, one of "
                        f"{', '.join(sorted(signals))}, got {name_in_dbc!r}"
                    )
            key = message.frame_id, message.is_extended_frame
            self._sections.setdefault(key, (message, []))[1].append((name, section.signals()))

    @property
    def keys(self) -> Collection[CanKey]:
        """Keys of the frames that it decodes."""
        return self._sections.keys()

    @property
    def message_names(self) -> list[str]:
        """Names of the messages that it decodes."""
        return [message.name for message, _ in self._sections.values()]

    def take(self, time_ns: int, key: CanKey, data: bytes, where: str) -> None:
        """Adds the values of a frame to the log; frames must come in the order of time, and be among `keys`.

        Raises:
            ValueError: If the frame is not as the DBC says; the message begins with `where`.
        """
        message, sections = self._sections[key]
        try:
            decoded = _decoded(message, data, where)
            for name, signals in sections:
                if all(signal in decoded for signal in signals.values()):
                    self._add(time_ns, name, {field: decoded[signal] for field, signal in signals.items()})
        except OverflowError as error:
            raise ValueError(f"{where}: {message.name}: expected numbers that can be computed with: {error}") from None

    def _add(self, time_ns: int, section: str, values: dict[str, float]) -> None:
        if section == "segment":
            self._street_frames.add_segment(values, time_ns)
        elif section == "slope":
            self._street_frames.add_slope(values)
        elif section == "position":
            self.log.add_street(time_ns, self._street_frames.message(values, time_ns))
        else:
            self.log.add_number(section, time_ns, _number(values, getattr(self._mapping, section)))


def _frames(path: Path, keys: Collection[CanKey]) -> list[tuple[int, CanKey, bytes]]:
    import can

    readers: dict[str, Any] = dict(
        zip(LOG_SUFFIXES, (can.ASCReader, can.BLFReader, can.CanutilsLogReader), strict=True)
    )
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a CAN log that ends in {', '.join(LOG_SUFFIXES)}, got {path.suffix!r}")
    check_file(path, MAX_LOG_BYTES)
    found = []
    if reader is can.BLFReader:
        _check_objects(path)
    # Opened here: BLFReader leaves a broken file open. Text is ASCII but for comments, in whatever encoding.
    opened: Any = path.open("rb") if reader is can.BLFReader else _TextLog(path)
    with opened as file:
        for frame in _read_frames(reader, file, path):
            key = frame.arbitration_id, bool(frame.is_extended_id)
            if key in keys and not (frame.is_error_frame or frame.is_remote_frame):
                if not math.isfinite(frame.timestamp):
                    raise ValueError(f"{_where(file, path)}: expected the time of a frame, got {frame.timestamp}")
                found.append((round(frame.timestamp * 1e9), key, bytes(frame.data)))
            if len(found) > MAX_LOG_FRAMES:
                raise ValueError(f"{path}: expected at most {MAX_LOG_FRAMES} frames of interest, got more")
    return found


def _read_frames(reader: Any, file: Any, path: Path) -> Iterator[can.Message]:
    """The frames of a log, as python-can reads them."""
    from can.io.blf import BLFParseError

    try:
        with reader(file) as log:
            yield from log
    # The documentation does not say what python-can's readers raise for a broken file.
    except (ValueError, LookupError, EOFError, struct.error, zlib.error, BLFParseError):
        if isinstance(file, _TextLog) and not file.is_too_long:
            got = shortened(file.line.strip())
            words = f"expected a frame as a CAN log of the kind {path.suffix} has it, got {got}"
            raise ValueError(f"{_where(file, path)}: {words}") from None
        if isinstance(file, _TextLog):
            raise
        raise ValueError(f"{path}: expected a CAN log of the kind {path.suffix}, it is damaged") from None


def _where(file: Any, path: Path) -> str:
    return f"{path}: line {file.number}" if isinstance(file, _TextLog) else str(path)


class _TextLog(io.TextIOWrapper):
    """The lines of a log in text.

    Attributes:
        line: The latest.
        number: Its number, from 1 on.
        is_too_long: Whether the line after it is.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path.open("rb"), encoding="latin-1")
        lines: Any = super()
        self._lines: Iterator[str] = bounded_lines(lines, path, MAX_LOG_LINE_BYTES)
        self.line, self.number, self.is_too_long = "", 0, False

    def __next__(self) -> str:  # type: ignore[override]  # typeshed has bytes there, for all files
        try:
            self.line = next(self._lines)
        except ValueError:
            self.is_too_long = True
            raise
        self.number += 1
        if self.number == 1:
            self.line = self.line.removeprefix(_BYTE_ORDER_MARK)
        return self.line


def _check_objects(path: Path) -> None:
    """Checks that a .blf is whole, and its objects of sizes that can be; python-can (can.io.blf) takes what there is.

    Raises:
        ValueError: If it is not; the message says at which byte.
    """
    num_bytes = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_FILE_HEAD)
        if head[:4] != b"LOGG"[: len(head)]:
            raise ValueError(f"{path}: expected a CAN log of the kind {path.suffix}, which begins with LOGG")
        header_size, stated = struct.unpack_from("<I8xQ", head.ljust(_FILE_HEAD, b"\0"), 4)
        if num_bytes < max(stated, _MIN_BLF_BYTES):  # one that is still written to states less
            missing = max(stated, _MIN_BLF_BYTES) - num_bytes
            raise ValueError(f"{path}: truncated CAN log, {missing} bytes are missing at the end")
        _check_object(header_size, f"{path}: header")
        file.seek(header_size)
        rest = b""
        while head := file.read(_OBJECT_HEAD):
            origin = f"{path}: byte {file.tell() - len(head)}"
            if head[:4] != b"LOBJ"[: len(head)]:
                raise ValueError(f"{origin}: expected an object, which begins with LOBJ")
            if len(head) < _OBJECT_HEAD:
                raise ValueError(f"{origin}: truncated CAN log, its last object is not whole")
            size, kind = struct.unpack_from("<II", head, 8)
            _check_object(size, origin)
            data = file.read(size - _OBJECT_HEAD)
            if len(data) < size - _OBJECT_HEAD:
                raise ValueError(f"{origin}: truncated CAN log, its last object is not whole")
            file.seek(size % 4, 1)
            if kind == _BLF_CONTAINER:
                rest = _after_objects(rest + _unpacked(data, origin), origin)
        if rest.strip(b"\0"):
            raise ValueError(f"{path}: truncated CAN log, the last object in its last container is not whole")


def _check_object(size: int, origin: str) -> None:
    if not _OBJECT_HEAD <= size <= MAX_OBJECT_BYTES:
        raise ValueError(f"{origin}: expected an object of {_OBJECT_HEAD} to {MAX_OBJECT_BYTES} bytes, got {size}")


def _unpacked(data: bytes, origin: str) -> bytes:
    """What is in a container."""
    if data[:2] != b"\2\0":  # not deflated
        return data[16:]
    inflating = zlib.decompressobj()
    try:
        unpacked = inflating.decompress(data[16:], MAX_OBJECT_BYTES + 1)
    except zlib.error:
        raise ValueError(f"{origin}: expected a container that can be unpacked, it is damaged") from None
    _check_object(max(len(unpacked), _OBJECT_HEAD), f"{origin}: unpacked")
    if not inflating.eof:
        raise ValueError(f"{origin}: expected a container that can be unpacked, its end is missing")
    return unpacked


def _after_objects(data: bytes, origin: str) -> bytes:
    """What follows the whole objects in `data`: the beginning of one that goes on in the next container."""
    position = 0
    while 0 <= (begin := data.find(b"LOBJ", position, position + 8)) <= len(data) - _OBJECT_HEAD:
        (size,) = struct.unpack_from("<I", data, begin + 8)
        _check_object(size, f"{origin}: object {begin} bytes into the container")
        if begin + size > len(data):
            break
        position = begin + size
    return data[position:]


def _decoded(message: Message, data: bytes, where: str) -> dict[str, float]:
    """The finite signals of a frame; a multiplexed frame has only some of them."""
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
