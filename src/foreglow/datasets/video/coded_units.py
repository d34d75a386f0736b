"""The units of packets of H.264 and H.265, and bytes that no unit has.

Of overwritten parts, such as zeros, the decoders make pictures. But the three bytes 000000, 000001 or 000002 stand in
no unit, so that start codes can be found: encoders put 03 between.
Sources: Rec. ITU-T H.264, section 7.4.1; H.265, section 7.4.2.1; sizes: ISO/IEC 14496-15, sections 5.3.3 and 8.3.3.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

_START = b"\0\0\1"

_IN_STREAM = re.compile(rb"\x00{3,}[^\x00\x01]|(?<!\x00)\x00\x00\x02")
"""Zeros are otherwise followed by a start code only."""

_IN_UNIT = re.compile(rb"\x00\x00[\x00\x01\x02]")


def size_bytes_of(codec_name: str, extradata: bytes | None) -> int:
    """Bytes before each unit that say how long it is, as in MP4 and Matroska; 0 where start codes are between units."""
    head = extradata or b""
    place = {"h264": 4, "hevc": 21}.get(codec_name, len(head))
    return (head[place] & 3) + 1 if head[:1] == b"\x01" and len(head) > place + 1 else 0


def units_of(data: bytes, size_bytes: int) -> Iterator[bytes]:
    """The units of a packet, one after another, which may be empty in damaged data."""
    if size_bytes:
        start = 0
        while start + size_bytes < len(data):
            begin = start + size_bytes
            start = begin + int.from_bytes(data[start:begin], "big")
            yield data[begin:start]
        return
    begin = data.find(_START)
    while begin >= 0:
        end = data.find(_START, begin + 3)
        yield data[begin + 3 : end if end >= 0 else len(data)]
        begin = end


def has_forbidden_bytes(data: bytes, size_bytes: int) -> bool:
    """Whether a packet has bytes that no unit may have; zeros at the end of a unit do not count."""
    if not size_bytes:
        return _IN_STREAM.search(data) is not None
    return any(_IN_UNIT.search(unit.rstrip(b"\0")) for unit in units_of(data, size_bytes))
