"""Where a Matroska or WebM file ends, and whether its elements lie one behind the other up to there.

FFmpeg looks for the next cluster where it finds no element, leaves out blocks of unknown tracks, and reads a second
film behind the first as if it went on: it says nothing, and numbers the frames behind them on. Source: RFC 8794 (EBML),
sections 4 to 6; RFC 9559 (Matroska), section 5.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

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
_BEGIN_A_FILM = frozenset({_EBML, _CLUSTER})
_IN_CLUSTER = _ANYWHERE | {0xE7, 0x5854, 0xA7, 0xAB, _SIMPLE_BLOCK, _BLOCK_GROUP, 0xAF}
_IN_GROUP = _ANYWHERE | {_BLOCK, 0xA2, 0x75A1, 0x9B, 0xFA, 0xFB, 0xFD, 0xA4, 0x75A2, 0x8E, 0xC8}
_PIECE = 1 << 20  # bytes
_FOREVER = 1 << 62

MAX_ELEMENTS = 4_000_000
"""Of a file with more elements, which is two days of 25 frames a second, the rest is not checked."""

MAX_SPANS = 100_000
"""Nor is what comes behind so much damage."""


class Contents(NamedTuple):
    """What a file holds.

    Attributes:
        end: Where its segment ends, beyond the size of a file that was cut; that size if the segment states no end.
        damage: At which byte an element is first missing, or one of an unknown track is; None for a whole file.
        spans: Where damage may be: half-open intervals of bytes in order, each from the element before what is missing,
            of which bytes may be missing, up to where elements begin again.
        film: Where a second film begins behind the first, or clusters behind the segment's end; None for neither.
    """

    end: int
    damage: int | None
    spans: list[tuple[int, int]]
    film: int | None


class _DamagedError(Exception):
    """No element that belongs there: at which byte, and whether it may just lack its end at the end of the file."""


def end_of(file: BinaryIO, size: int) -> int:
    """Where the file's segment ends; the size of the file if the segment states none."""
    end = _segment(file, size)[1]
    return size if end == _FOREVER else end


def walk(file: BinaryIO, size: int) -> Contents:
    """What a file of `size` bytes holds, up to a second film.

    Only where elements begin and end, and which track blocks belong to, is checked: their data is the decoder's to
    judge. An element without its end at the end of the file, as in a cut file, or one whose recorder was killed, is no
    damage.
    """
    start, end = _segment(file, size)
    elements = _Elements(file, size)
    elements.check_segment(start, end)
    film = elements.film
    if film is None and not elements.spans and end < size:
        film = elements.next_part(end, _BEGIN_A_FILM)
    return Contents(size if end == _FOREVER else end, elements.damage, elements.spans, film)


def _segment(file: BinaryIO, size: int) -> tuple[int, int]:
    """Where the content of the segment begins and ends, which may be unknown; (`size`, `size`) without a segment."""
    file.seek(4)
    length, _ = _number(file)
    file.seek(length, 1)
    if int.from_bytes(file.read(4), "big") != _SEGMENT:
        return size, size
    length, is_unknown = _number(file)
    return file.tell(), _FOREVER if is_unknown or not length else file.tell() + length


class _Elements:
    """The elements of a file of `size` bytes.

    Attributes:
        damage: As in `Contents`, and so are the `spans`.
        film: Where another film begins before the end of the segment.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.damage: int | None = None
        self.spans: list[tuple[int, int]] = []
        self.film: int | None = None
        self._file, self._size = file, size
        self._tracks: set[int] = set()
        self._num_seen = 0
        self._latest = 0  # where the data of the last element begin

    def check_segment(self, position: int, end: int) -> None:
        """Looks at the elements from `position` to `end`; where there is damage, it looks for the next."""
        while self.film is None and self._has_more(position, end):
            try:
                position = self._check_part(position, end)
            except _DamagedError as damage:
                found = self.next_part(self._latest + 1, _ONLY_IN_SEGMENT)
                if found is None and damage.args[1]:
                    return
                position = self._size if found is None else found
                self._lose(int(damage.args[0]), self._latest, position)
                self._latest = position
                end = _FOREVER  # what is missing, or too much, moves the end

    def next_part(self, position: int, names: frozenset[int]) -> int | None:
        """Where an element with one of these names, of 4 bytes, begins at `position` or behind; None if none does."""
        pattern = re.compile(b"|".join(re.escape(name.to_bytes(4, "big")) for name in sorted(names)))
        while position < self._size:
            self._file.seek(position)
            piece = self._file.read(_PIECE)
            for found in pattern.finditer(piece):
                try:
                    self._element(position + found.start(), _FOREVER, names)
                except _DamagedError:
                    continue
                return position + found.start()
            position += max(1, len(piece) - 3)
        return None

    def _lose(self, damage: int, start: int, stop: int) -> None:
        self.damage = damage if self.damage is None else self.damage
        self.spans.append((start, stop))

    def _has_more(self, position: int, end: int) -> bool:
        is_bounded = self._num_seen < MAX_ELEMENTS and len(self.spans) < MAX_SPANS
        return is_bounded and position < min(end, self._size)

    def _check_part(self, position: int, end: int) -> int:
        """Where the element at `position` ends; a second film ends nowhere."""
        name, start, stop = self._element(position, end, _IN_SEGMENT)
        if name == _EBML:
            self.film = position
            return self._size
        if name == _CLUSTER:
            self._latest = start
            return self._check_cluster(start, end if stop is None else stop, is_open=stop is None)
        stop = self._whole(position, start, stop)
        if name == _TRACKS:
            self._read_tracks(start, stop)
        return stop

    def _check_cluster(self, position: int, end: int, *, is_open: bool) -> int:
        """Where the cluster ends; one of unknown length (`is_open`) ends before an element that only a segment has."""
        while self._has_more(position, end):
            name, start, stop = self._element(position, end, _IN_CLUSTER | _ONLY_IN_SEGMENT if is_open else _IN_CLUSTER)
            if name in _ONLY_IN_SEGMENT:
                break
            stop = self._whole(position, start, stop)
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
            self._lose(position, position, position + 1)

    def _read_tracks(self, position: int, end: int) -> None:
        for name, start, stop in self._children(position, end):
            if name == _TRACK_ENTRY:
                for inner, begin, behind in self._children(start, stop):
                    if inner == _TRACK_NUMBER:
                        self._file.seek(begin)
                        self._tracks.add(int.from_bytes(self._file.read(min(behind - begin, 8)), "big"))

    def _children(self, position: int, end: int, known: frozenset[int] | None = None) -> Iterator[tuple[int, int, int]]:
        while self._has_more(position, end):
            name, start, stop = self._element(position, end, known)
            stop = self._whole(position, start, stop)
            yield name, start, stop
            position = stop

    def _whole(self, position: int, start: int, stop: int | None) -> int:
        """`stop`, of an element at `position` that must say where it ends, within the file."""
        if stop is None or stop > self._size:
            raise _DamagedError(position, stop is not None or start >= self._size)
        self._latest = start
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
            raise _DamagedError(position, False)
        return name, start, None if is_unknown else start + length


def _number(file: BinaryIO) -> tuple[int, bool]:
    """An EBML variable-size integer, and whether it means `unknown` (all bits set)."""
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, True
    num_more = 8 - first[0].bit_length()
    value = (first[0] & (0xFF >> (num_more + 1))) << (8 * num_more) | int.from_bytes(file.read(num_more), "big")
    return value, value == (1 << (7 * (num_more + 1))) - 1
