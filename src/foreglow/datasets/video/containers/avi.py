"""Whether the chunks of an AVI file lie one behind the other, and whether a second film begins behind the first.

FFmpeg looks for the next chunk where it finds none, and gives the frames behind it the times of those that are missing;
it reads a second film as if the first went on.
Source: Microsoft, AVI RIFF file reference; OpenDML AVI file format extensions.
"""

from __future__ import annotations

import re
from typing import BinaryIO

MAX_CHUNKS = 4_000_000
"""Of a file with more chunks, which is two days of 25 frames a second, the rest is not checked."""

MAX_SPANS = 100_000
"""Nor is what comes behind so much damage."""

_FRAMES = re.compile(rb"\d\d[a-z][a-z]")
_NAMES = re.compile(rb".?(?:\d\d[a-z][a-z]|ix\d\d|idx1|JUNK|LIST|RIFF)", re.DOTALL)
"""Of what may come next, perhaps behind the byte that fills an odd length."""

_LISTS = (b"movi", b"rec ")
_PIECE = 1 << 20  # bytes


def is_avi(head: bytes) -> bool:
    """Whether a file with these first 12 bytes is an AVI."""
    return head[:4] == b"RIFF" and head[8:12] == b"AVI "


def end_of(head: bytes) -> int:
    """Where the file with these first 12 bytes ends, at the least."""
    return 8 + int.from_bytes(head[4:8], "little")


def walk(file: BinaryIO, size: int) -> tuple[list[tuple[int, int]], int | None]:
    """Where a file of `size` bytes holds damage, and where a second film begins, up to which it is looked for.

    Damage is half-open intervals of bytes in order, each up to the next chunk.

    A recorder that was killed leaves sizes of 0, and the last chunk without its end, as a cut does; a chunk without
    data is a frame that was left out.
    """
    return _Chunks(file, size).walk()


class _Chunks:
    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        file.seek(0)
        self._is_short = end_of(file.read(12)) > size
        self._names: set[bytes] = set()  # of frames and sound
        self._is_padded = False  # whether a chunk of odd length was filled

    def walk(self) -> tuple[list[tuple[int, int]], int | None]:
        spans: list[tuple[int, int]] = []
        position, end = 0, self._size
        for _ in range(MAX_CHUNKS):
            if position + 8 > self._size or len(spans) >= MAX_SPANS:
                break
            self._file.seek(position)
            header = self._file.read(12)
            name, stop = header[:4], position + 8 + int.from_bytes(header[4:8], "little")
            if name == b"RIFF":
                if position and header[8:] == b"AVI ":
                    return spans, position
                end = stop if position + 8 < stop <= self._size else self._size
            elif position >= end:
                break
            if name == b"RIFF" or header[8:12] in _LISTS:
                position += 12
                continue
            is_name = all(0x20 <= each < 0x7F for each in name)
            behind = self._behind(position, stop) if is_name and stop <= self._size else None
            if behind is None:
                found = self._next(position + 1)
                if is_name and found is None:  # it just lacks its end
                    break
                spans.append((position, self._size if found is None else found))
                position = spans[-1][1]
                continue
            if _FRAMES.fullmatch(name):
                self._names.add(name)
            position = behind
        return spans, None

    def _behind(self, start: int, stop: int) -> int | None:
        """Where the next chunk begins behind that from `start` to `stop`; None if this one lacks a byte.

        Some recorders leave out the byte that fills an odd length; none fills some only.
        """
        if (stop - start) % 2 == 0:
            return stop
        self._file.seek(stop)
        if not _FRAMES.match(self._file.read(4)):
            self._is_padded = True
            return stop + 1
        return None if self._is_padded and self._is_short else stop

    def _next(self, position: int) -> int | None:
        """Where a chunk begins at `position` or behind, with another one behind it; None if none does."""
        names = [re.escape(name) for name in sorted(self._names)] or [rb"\d\d(?:dc|db|wb)"]
        pattern = re.compile(b"|".join([*names, b"idx1", b"RIFF"]))
        while position < self._size:
            self._file.seek(position)
            piece = self._file.read(_PIECE)
            for found in pattern.finditer(piece):
                if self._is_chunk(position + found.start()):
                    return position + found.start()
            position += max(1, len(piece) - 3)
        return None

    def _is_chunk(self, position: int) -> bool:
        self._file.seek(position)
        header = self._file.read(12)
        if header.startswith(b"RIFF"):
            return header[8:] in (b"AVI ", b"AVIX")
        stop = position + 8 + int.from_bytes(header[4:8], "little")
        self._file.seek(stop)
        return stop == self._size or (stop < self._size and _NAMES.match(self._file.read(5)) is not None)
