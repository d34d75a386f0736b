"""The frames in a file of CAN traffic: Vector's .asc and .blf, and candump's .log, read by python-can within bounds."""

from __future__ import annotations

import codecs
import io
import math
import re
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from foreglow.files import bounded_lines, check_file
from foreglow.wording import shortened

if TYPE_CHECKING:
    import can

MAX_LOG_BYTES = 1 << 32
"""Largest log: that of hours on a busy bus."""

MAX_LOG_LINE_BYTES = 1 << 16
"""Longest line of a log in text."""

MAX_LOG_FRAMES = 2_000_000
"""Frames of interest in a log, which take half a kilobyte each: hours of motion and road."""

MAX_STEP_BACK_NS = 1_000_000_000
"""Frames of several buses may be stored a little out of order; if times fall by more, a clock was set, or logs were
put together, and the frames of two drives would be mixed."""

MAX_TIME_S = 1 << 33
"""Latest time of a frame, two centuries after 1970: a later one is no time, and too many nanoseconds."""

MAX_OBJECT_BYTES = 1 << 24
"""Largest object of a .blf, unpacked; Vector's containers have 128 KiB."""

_BYTE_ORDER_MARK = codecs.BOM_UTF8.decode("latin-1")
_RELATIVE = re.compile(  # each time counts from the event before; on a line of its own, too, or before the base
    r"\s*(base\s+\w+\s+)?timestamps\s+relative", re.IGNORECASE
)
_BASE = re.compile(r"\s*base\s", re.IGNORECASE)
_KNOWN_BASE = re.compile(r"\s*base\s+(hex|dec)(\s+timestamps\s+(absolute|relative))?\s*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"^(\s*\d+),(?=\d+\s)")  # of a time
_BINARY = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]")  # in no encoding of text but UTF-16; DOS ends it with 0x1a
_CANDUMP_LINE = re.compile(  # time, bus, identifier; a length, up to 8 bytes, or the flags of CAN FD and more
    r"\s*\(\d+(\.\d*)?\)\s+\S+\s+[0-9A-F]{1,8}#(R\d*|([0-9A-F]{2}){0,8}|#\d([0-9A-F]{2}){0,64})(\s|$)",
    re.IGNORECASE | re.ASCII,
)
_ASC_FRAME = re.compile(  # time, channel, identifier, direction, kind: of other events of a log, none is like it
    r"\s*(?!//|-?\d+\.\d+\s)\S+\s+(\d\S*\s+\S+\s+(Rx|Tx|TxRq)\s+[dr]\s+\S|CANFD\s+\d+\s+(Rx|Tx|TxRq)\s)"
    r"|\s*\d+\.\d+\s+(?!\d+\s+\w+\s)\d\S*\s+\S+\s+(Rx|Tx|TxRq)\s+[dr]\s+\S",
    re.IGNORECASE | re.ASCII,
)
"""What is a frame of an .asc with a time, channel or identifier that cannot be read, which python-can passes over."""

_ASC_HEAD = re.compile(r"\s*(date\s|base\s|//|(no)?\s*internal\s+events\s+logged)", re.IGNORECASE)
_ASC_HEAD_END = re.compile(r"\s*((no)?\s*internal\s+events\s+logged|begin\s+trigger|\d)", re.IGNORECASE)
_ASC_DATA = re.compile(r"\s*\S+\s+\d+\s+\S+\s+\S+\s+d\s+(\S+)\s*(.*)", re.IGNORECASE)  # length and bytes
_MAX_DLC = 15  # of four bits; above 8 it means 8 bytes without CAN FD
_BLF_CONTAINER = 10
_FILE_HEAD = 24  # bytes: signature, size of the header, versions, size of the file
_MIN_BLF_BYTES = 144  # of the file's header
_OBJECT_HEAD = 16  # bytes: signature, size of the header, version, size and kind of the object

CANDUMP = ".log"
LOG_SUFFIXES = (".asc", ".blf", CANDUMP)
"""Vector's text and binary logs, and candump's."""

CanKey: TypeAlias = tuple[int, bool]
"""A frame's identifier, and whether that is extended."""


def read_frames(path: Path, keys: Collection[CanKey], bus: str | None = None) -> list[tuple[int, CanKey, bytes]]:
    """Time in ns, key and data of each frame in the log `path` that has one of these keys, in the file's order.

    Args:
        path: The log.
        keys: Keys of the frames.
        bus: Frames of other buses are left out: `can0` in candump's logs, `1` in Vector's. None: a key comes from one.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If python-can is not installed (extra `can`).
        ValueError: If the log is broken, or beyond a bound, or its times jump back, or a key comes from several buses,
            on each of which it may mean something else.
    """
    import can

    readers: dict[str, Any] = dict(
        zip(LOG_SUFFIXES, (can.ASCReader, can.BLFReader, can.CanutilsLogReader), strict=True)
    )
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a CAN log that ends in {', '.join(LOG_SUFFIXES)}, got {path.suffix!r}")
    check_file(path, MAX_LOG_BYTES)
    found: list[tuple[int, CanKey, bytes]] = []
    bus_of: dict[CanKey, str] = {}
    latest_ns = -math.inf
    if reader is can.BLFReader:
        _check_objects(path)
    # Opened here: BLFReader leaves a broken file open. Text is ASCII but for comments, in whatever encoding.
    opened: Any = path.open("rb") if reader is can.BLFReader else _TextLog(path)
    with opened as file:
        for frame in _read_frames(reader, file, path):
            key = frame.arbitration_id, bool(frame.is_extended_id)
            own_bus = _bus_of(frame, path)
            if key in keys and bus in (None, own_bus) and not (frame.is_error_frame or frame.is_remote_frame):
                if bus_of.setdefault(key, own_bus) != own_bus:
                    expected = f"expected frames {key[0]:X} of one bus, got those of {bus_of[key]} and {own_bus}"
                    raise ValueError(f"{_where(file, path)}: {expected}: name one as `bus` in the mapping")
                if not abs(frame.timestamp) <= MAX_TIME_S:
                    raise ValueError(f"{_where(file, path)}: expected the time of a frame, got {frame.timestamp:g} s")
                time_ns = round(frame.timestamp * 1e9)
                if time_ns < latest_ns - MAX_STEP_BACK_NS:
                    expected = f"expected times that do not fall by more than {MAX_STEP_BACK_NS / 1e9:g} s"
                    got = f"got {time_ns / 1e9:.6f} s after {latest_ns / 1e9:.6f} s"
                    raise ValueError(f"{_where(file, path)}: {expected}, {got}: a clock was set, or logs put together")
                latest_ns = max(latest_ns, time_ns)
                found.append((time_ns, key, bytes(frame.data)))
            if len(found) > MAX_LOG_FRAMES:
                raise ValueError(f"{path}: expected at most {MAX_LOG_FRAMES} frames of interest, got more")
    return found


def _read_frames(reader: Any, file: Any, path: Path) -> Iterator[can.Message]:
    """The frames of a log, as python-can reads them."""
    from can.io.blf import BLFParseError

    try:
        with reader(file) as log:
            for frame in log:
                # python-can takes any characters around a time for parentheses, and bits of any identifier.
                if path.suffix.lower() == CANDUMP and not _CANDUMP_LINE.match(file.line):
                    raise ValueError
                if path.suffix.lower() == ".asc" and not _has_its_bytes(frame, file.line, log.base):
                    raise ValueError
                yield frame
    # The documentation does not say what python-can's readers raise for a broken file.
    except (ValueError, LookupError, EOFError, struct.error, zlib.error, BLFParseError):
        if isinstance(file, _TextLog) and not file.is_told:
            got = shortened(file.line.strip())
            words = f"expected a frame as a CAN log of the kind {path.suffix} has it, got {got}"
            raise ValueError(f"{_where(file, path)}: {words}") from None
        if isinstance(file, _TextLog):
            raise
        raise ValueError(f"{path}: expected a CAN log of the kind {path.suffix}, it is damaged") from None


def _has_its_bytes(frame: can.Message, line: str, base: str) -> bool:
    """Whether a frame of an .asc has a length that can be, and as many bytes; python-can takes any."""
    if frame.is_error_frame or frame.is_remote_frame:
        return True
    found = _ASC_DATA.match(line)
    if found is not None and not frame.is_fd:
        longest = 3 if base == "dec" else 2
        if not 0 <= int(found[1], 10 if base == "dec" else 16) <= _MAX_DLC:
            return False
        if any(len(byte) > longest for byte in found[2].split()[: len(frame.data)]):
            return False
    return 0 <= (frame.dlc if frame.is_fd else min(frame.dlc, 8)) <= len(frame.data) <= 64


def _bus_of(frame: can.Message, path: Path) -> str:
    """The frame's bus, as the log writes it; python-can counts Vector's channels from 0 on."""
    is_counted = isinstance(frame.channel, int) and path.suffix.lower() != CANDUMP
    return str(int(frame.channel) + 1 if is_counted else frame.channel)  # type: ignore[arg-type]  # as checked


def _where(file: Any, path: Path) -> str:
    return f"{path}: line {file.number}" if isinstance(file, _TextLog) else str(path)


class _TextLog(io.TextIOWrapper):
    """The lines of a log in text.

    Attributes:
        line: The latest.
        number: Its number, from 1 on.
        is_told: Whether an error has said what is wrong with the line after it, or with itself.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path.open("rb"), encoding="latin-1")
        self._path = path
        lines: Any = super()
        self._lines: Iterator[str] = bounded_lines(lines, path, MAX_LOG_LINE_BYTES)
        self.line, self.number, self.is_told = "", 0, False
        self._is_head, self._waits = path.suffix.lower() == ".asc", False

    def __next__(self) -> str:  # type: ignore[override]  # typeshed has bytes there, for all files
        """The next line; of the head of an .asc those that python-can knows, and an empty one at its end.

        python-can ends the head with the first line that it does not know, and leaves that out, even if it is a frame.
        """
        if self._waits:
            self._waits = False
            return self.line
        line = self._next()
        while self._is_head:
            self._is_head = not _ASC_HEAD_END.match(line)
            if _ASC_HEAD.match(line):
                return line
            if not self._is_head:
                self._waits = True
                return "\n"
            line = self._next()
        return line

    def _next(self) -> str:
        try:
            self.line = next(self._lines)
        except ValueError:
            self.is_told = True
            raise
        self.number += 1
        if self.number == 1:
            self.line = self.line.removeprefix(_BYTE_ORDER_MARK)
        if self._path.suffix.lower() == ".asc":  # python-can passes over a time with a comma, as Windows may write it
            self.line = _DECIMAL_COMMA.sub(r"\1.", self.line)
            if _ASC_FRAME.match(self.line):
                raise ValueError
        if _RELATIVE.match(self.line):
            self.is_told = True
            raise ValueError(f"{self._path}: line {self.number}: expected timestamps absolute, got relative ones")
        if self._is_head and _BASE.match(self.line) and not _KNOWN_BASE.fullmatch(self.line):
            self.is_told = True  # python-can takes it for hexadecimal and absolute
            words = f"expected base hex or dec, timestamps absolute, got {shortened(self.line.strip())}"
            raise ValueError(f"{self._path}: line {self.number}: {words}")
        if _BINARY.search(self.line):  # python-can passes over a line of .asc that it does not know
            self.is_told = True
            raise ValueError(f"{self._path}: line {self.number}: expected text, got {shortened(self.line.strip())}")
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
