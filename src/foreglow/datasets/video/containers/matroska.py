"""Where a Matroska or WebM file ends, and whether its elements lie one behind the other up to there.

FFmpeg looks for the next cluster where it finds no element, and leaves out blocks of unknown tracks: it says neither,
and numbers the frames behind them on. Source: RFC 8794 (EBML), sections 4 to 6; RFC 9559 (Matroska), section 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

MAGIC = b"\x1a\x45\xdf\xa3"
"""How every EBML file begins."""

_EBML = 0x1A45DFA3
_SEGMENT = 0x18538067
_CLUSTER = 0x1F43B675
_TRACKS = 0x1654AE6B
_TRACK_ENTRY, _TRACK_NUMBER = 0xAE, 0xD7
_BLOCK_GROUP, _BLOCK, _SIMPLE_BLOCK = 0xA0, 0xA1, 0xA3

_ONLY_IN_SEGMENT = frozenset(
    {_CLUSTER, _TRACKS, _EBML, 0x114D9B74, 0x1549A966, 0x1C53BB6B, 0x1941A469, 0x1043A770, 0x1254C367}
)
_ANYWHERE = frozenset({0xEC, 0xBF})  # filler, checksum
_IN_SEGMENT = _ONLY_IN_SEGMENT | _ANYWHERE
_IN_CLUSTER = _ANYWHERE | {0xE7, 0x5854, 0xA7, 0xAB, _SIMPLE_BLOCK, _BLOCK_GROUP, 0xAF}
_IN_GROUP = _ANYWHERE | {_BLOCK, 0xA2, 0x75A1, 0x9B, 0xFA, 0xFB, 0xFD, 0xA4, 0x75A2, 0x8E, 0xC8}
_PIECE = 1 << 20  # bytes

MAX_ELEMENTS = 4_000_000
"""Of a file with more elements, which is two days of 25 frames a second, the rest is not checked."""


class _DamagedError(Exception):
    """No element that belongs there: at which byte, and whether it may just lack its end at the end of the file."""


def matroska_end(path: Path) -> int:
    """Where the file's segment ends; the size of the file if the segment states none."""
    size = path.stat().st_size
    with path.open("rb") as file:
        return _segment(file, size)[1]


def first_damage(path: Path) -> int | None:
    """The first byte at which an element was expected and none of those that belong there is; None in a whole file.

    Only where elements begin and end, and which track blocks belong to, is checked: their data is the decoder's to
    judge. What a recorder left that was killed, an element without its end at the end of the file, is no damage.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        start, end = _segment(file, size)
        try:
            _Elements(file, size).check_segment(start, min(end, size))
        except _DamagedError as damage:
            position = int(damage.args[0])
            is_left_open = end == size and damage.args[1] and not _has_cluster(file, position + 1)
            return None if is_left_open else position
    return None


def _segment(file: BinaryIO, size: int) -> tuple[int, int]:
    """Where the content of the segment begins and ends; (`size`, `size`) without a segment."""
    file.seek(4)
    length, _ = _number(file)
    file.seek(length, 1)
    if int.from_bytes(file.read(4), "big") != _SEGMENT:
        return size, size
    length, is_unknown = _number(file)
    return file.tell(), size if is_unknown else file.tell() + length


def _has_cluster(file: BinaryIO, position: int) -> bool:
    """Whether a cluster seems to begin at `position` or behind."""
    file.seek(position)
    kept = b""
    while data := file.read(_PIECE):
        if _CLUSTER.to_bytes(4, "big") in kept + data:
            return True
        kept = data[-3:]
    return False


class _Elements:
    """The elements of a file of `size` bytes; `_DamagedError` where none begins that belongs there."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self._tracks: set[int] = set()
        self._num_seen = 0

    def check_segment(self, position: int, end: int) -> None:
        while position < end and self._num_seen < MAX_ELEMENTS:
            name, start, stop = self._element(position, end, _IN_SEGMENT)
            if name == _EBML:  # another file was appended to one whose length is unknown
                return
            if name == _TRACKS:
                self._read_tracks(start, self._known(position, stop))
            if name == _CLUSTER:
                position = self._check_cluster(start, end if stop is None else stop, is_open=stop is None)
            else:
                position = self._known(position, stop)

    def _check_cluster(self, position: int, end: int, *, is_open: bool) -> int:
        """Where the cluster ends; one of unknown length (`is_open`) ends before an element that only a segment has."""
        while position < end and self._num_seen < MAX_ELEMENTS:
            name, start, stop = self._element(position, end, _IN_CLUSTER | _ONLY_IN_SEGMENT if is_open else _IN_CLUSTER)
            if name in _ONLY_IN_SEGMENT:
                break
            stop = self._known(position, stop)
            if name == _SIMPLE_BLOCK:
                self._check_block(start)
            elif name == _BLOCK_GROUP:
                for inner, begin, _ in self._children(start, stop, _IN_GROUP):
                    if inner == _BLOCK:
                        self._check_block(begin)
            position = stop
        return position

    def _check_block(self, position: int) -> None:
        self._file.seek(position)
        if _number(self._file)[0] not in self._tracks:
            raise _DamagedError(position, False)

    def _read_tracks(self, position: int, end: int) -> None:
        for name, start, stop in self._children(position, end):
            if name == _TRACK_ENTRY:
                for inner, begin, behind in self._children(start, stop):
                    if inner == _TRACK_NUMBER:
                        self._file.seek(begin)
                        self._tracks.add(int.from_bytes(self._file.read(min(behind - begin, 8)), "big"))

    def _children(self, position: int, end: int, known: frozenset[int] | None = None) -> Iterator[tuple[int, int, int]]:
        while position < end and self._num_seen < MAX_ELEMENTS:
            name, start, stop = self._element(position, end, known)
            stop = self._known(position, stop)
            yield name, start, stop
            position = stop

    def _known(self, position: int, stop: int | None) -> int:
        """`stop`, of an element at `position` that must say where it ends."""
        if stop is None:
            raise _DamagedError(position, False)
        return stop

    def _element(self, position: int, end: int, known: frozenset[int] | None) -> tuple[int, int, int | None]:
        """Name of the element at `position`, where its data begins and ends; None as the end if its length is unknown.

        It is one of the `known`, if any are given, and over at `end`.
        """
        self._num_seen += 1
        self._file.seek(position)
        first = self._file.read(1)
        num_more = 8 - first[0].bit_length() if first else 8
        name = int.from_bytes(first + self._file.read(min(num_more, 3)), "big")
        if num_more > 3 or (known is not None and name not in known):
            raise _DamagedError(position, position + num_more >= self._size)
        length, is_unknown = _number(self._file)
        start = self._file.tell()
        if start + length > end and not (is_unknown and start <= end):
            raise _DamagedError(position, start + length > self._size)
        return name, start, None if is_unknown else start + length


def _number(file: BinaryIO) -> tuple[int, bool]:
    """An EBML variable-size integer, and whether it means `unknown` (all bits set)."""
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, True
    num_more = 8 - first[0].bit_length()
    value = (first[0] & (0xFF >> (num_more + 1))) << (8 * num_more) | int.from_bytes(file.read(num_more), "big")
    return value, value == (1 << (7 * (num_more + 1))) - 1
