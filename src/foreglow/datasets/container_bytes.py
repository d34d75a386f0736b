"""Checks that a video file is as long as its container says: demuxers end silently where a file was cut."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

_MATROSKA_SEGMENT = 0x18538067
_MAX_BOXES = 100_000  # a file with more top-level boxes is not checked to its end


def missing_bytes(path: Path) -> int:
    """Number of bytes missing at the end of `path`, by the sizes in an MP4/MOV, Matroska/WebM or AVI container.

    0 for a complete file, and for a container that states no size (MPEG-TS, live Matroska, raw streams).
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            return max(0, _mp4_end(file, size) - size)
        if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
            return max(0, 8 + int.from_bytes(head[4:8], "little") - size)
        if head[:4] == b"\x1a\x45\xdf\xa3":
            return max(0, _matroska_end(file, size) - size)
    return 0


def _mp4_end(file: BinaryIO, size: int) -> int:
    """End of the last top-level box. Source: ISO/IEC 14496-12, section 4.2."""
    position = 0
    for _ in range(_MAX_BOXES):
        if position >= size:
            break
        file.seek(position)
        header = file.read(16)
        if len(header) < 8:
            return position + 8
        length = int.from_bytes(header[:4], "big")
        if length == 1:
            length = int.from_bytes(header[8:16], "big")
        if length < 8:  # 0: to the end of the file; else not a box
            break
        position += length
    return position


def _matroska_end(file: BinaryIO, size: int) -> int:
    """End of the segment, or `size` if its length is unknown. Source: RFC 8794, sections 4 to 6."""
    file.seek(4)
    length, _ = _vint(file)
    file.seek(length, 1)
    if int.from_bytes(file.read(4), "big") != _MATROSKA_SEGMENT:
        return size
    length, is_unknown = _vint(file)
    return size if is_unknown else file.tell() + length


def _vint(file: BinaryIO) -> tuple[int, bool]:
    """An EBML variable-size integer, and whether it means `unknown` (all bits set)."""
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, True
    num_more = 8 - first[0].bit_length()
    value = (first[0] & (0xFF >> (num_more + 1))) << (8 * num_more) | int.from_bytes(file.read(num_more), "big")
    return value, value == (1 << (7 * (num_more + 1))) - 1
