"""The pages of an Ogg file: each has a checksum and a number, by which damage and what is missing are known.

Source: RFC 3533, section 6.
"""

from __future__ import annotations

import zlib
from typing import BinaryIO

CAPTURE = b"OggS"

MAX_PAGES = 4_000_000
"""The pages behind these are not checked."""

_HEAD_BYTES = 27  # before the sizes of the segments
_CHECKSUM = slice(22, 26)
_FIRST, _LAST = 2, 4  # flags: page of a stream
_MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def walk(file: BinaryIO, size: int) -> tuple[int, int | None]:
    """Where the last page ends, beyond `size` if it was cut; and where the first damage is, None if there is none.

    The end of the file counts as damage where a stream has no last page.
    """
    file.seek(0)
    position, open_streams, numbers = 0, set[bytes](), dict[bytes, int]()
    for _ in range(MAX_PAGES):
        if position >= size:
            break
        head = file.read(_HEAD_BYTES)
        sizes = file.read(head[26]) if len(head) == _HEAD_BYTES else b""
        if not head.startswith(CAPTURE[: len(head)]):
            return size, position
        body_bytes = sum(sizes)
        end = position + _HEAD_BYTES + (head[26] if len(head) == _HEAD_BYTES else 0) + body_bytes
        if end > size:
            return end, None
        flags, stream, number = head[5], head[14:18], int.from_bytes(head[18:22], "little")
        page = head + sizes + file.read(body_bytes)
        if checksum(page[:22] + bytes(4) + page[26:]) != int.from_bytes(head[_CHECKSUM], "little"):
            return size, position
        if number != numbers.get(stream, -1) + 1 and not flags & _FIRST:
            return size, position
        numbers[stream] = number
        if flags & _LAST:
            open_streams.discard(stream)
        else:
            open_streams.add(stream)
        position = end
    return size, size if open_streams and position >= size else None


def checksum(data: bytes) -> int:
    """The checksum of a page whose checksum is zeros: as zlib's, but for its order of bits and its beginning."""
    mirrored = zlib.crc32(data.translate(_MIRRORED), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return int(f"{mirrored:032b}"[::-1], 2)
