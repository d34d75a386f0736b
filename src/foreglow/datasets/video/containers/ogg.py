"""The pages of an Ogg file: each has a checksum and a number, by which damage and what is missing are known.

Source: RFC 3533, section 6.
"""

from __future__ import annotations

import zlib
from typing import BinaryIO

CAPTURE = b"OggS"

MAX_PAGES = 4_000_000
"""The pages behind these are not checked."""

MAX_PLACES = 100_000
"""Nor is what comes behind so much damage."""

_HEAD_BYTES = 27  # before the sizes of the segments
_PIECE = 1 << 20  # bytes
_FIRST, _LAST = 2, 4  # flags: page of a stream
_MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def walk(file: BinaryIO, size: int) -> tuple[int, list[int]]:
    """Where the last page ends, beyond `size` if it was cut; and where damage begins, in order.

    The end of the file counts as damage where a stream has no last page.
    """
    position, places, open_streams, numbers = 0, list[int](), set[bytes](), dict[bytes, int]()
    for _ in range(MAX_PAGES):
        if position >= size or len(places) >= MAX_PLACES:
            break
        file.seek(position)
        head = file.read(_HEAD_BYTES)
        is_whole = len(head) == _HEAD_BYTES
        sizes = file.read(head[26]) if is_whole else b""
        end = position + (_HEAD_BYTES + head[26] + sum(sizes) if is_whole else _HEAD_BYTES)
        if head.startswith(CAPTURE[: len(head)]) and end > size:
            return end, places
        page = head + sizes + file.read(sum(sizes))
        is_right = head.startswith(CAPTURE) and checksum(page[:22] + bytes(4) + page[26:]) == _number(head[22:26])
        if not is_right:
            places.append(position)
            position = _next_page(file, position + 1, size)
            continue
        flags, stream, number = head[5], head[14:18], _number(head[18:22])
        if number != numbers.get(stream, -1) + 1 and not flags & _FIRST:
            places.append(position)
        numbers[stream] = number
        if flags & _LAST:
            open_streams.discard(stream)
        else:
            open_streams.add(stream)
        position = end
    if open_streams and position >= size:
        places.append(size)
    return size, places


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _next_page(file: BinaryIO, position: int, size: int) -> int:
    """Where a page begins from there on; the size of the file if none does."""
    while position < size:
        file.seek(position)
        piece = file.read(_PIECE)
        found = piece.find(CAPTURE)
        if found >= 0:
            return position + found
        position += max(1, len(piece) - len(CAPTURE) + 1)
    return size


def checksum(data: bytes) -> int:
    """The checksum of a page whose checksum is zeros: as zlib's, but for its order of bits and its beginning."""
    mirrored = zlib.crc32(data.translate(_MIRRORED), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return int(f"{mirrored:032b}"[::-1], 2)
