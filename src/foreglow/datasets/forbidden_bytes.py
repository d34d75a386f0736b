"""Bytes that no unit of H.264 or H.265 has: of overwritten parts, such as zeros, their decoders make pictures.

Three bytes 000000, 000001 or 000002 stand in no unit, so that start codes can be found; encoders put 03 between.
Sources: Rec. ITU-T H.264, section 7.4.1; H.265, section 7.4.2.1; sizes: ISO/IEC 14496-15, sections 5.3.3 and 8.3.3.
"""

from __future__ import annotations

import re

_IN_STREAM = re.compile(rb"\x00{3,}[^\x00\x01]|(?<!\x00)\x00\x00\x02")
"""Zeros are otherwise followed by a start code only."""

_IN_UNIT = re.compile(rb"\x00\x00[\x00\x01\x02]")


def size_bytes_of(codec_name: str, extradata: bytes | None) -> int:
    """Bytes before each unit that say how long it is, as in MP4 and Matroska; 0 where start codes are between units."""
    head = extradata or b""
    place = {"h264": 4, "hevc": 21}.get(codec_name, len(head))
    return (head[place] & 3) + 1 if head[:1] == b"\x01" and len(head) > place + 1 else 0


def has_forbidden_bytes(data: bytes, size_bytes: int) -> bool:
    """Whether a packet has bytes that no unit may have; zeros at the end of a unit do not count."""
    if not size_bytes:
        return _IN_STREAM.search(data) is not None
    position = 0
    while position + size_bytes < len(data):
        start = position + size_bytes
        position = start + int.from_bytes(data[position:start], "big")
        if _IN_UNIT.search(data[start:position].rstrip(b"\0")):
            return True
    return False
