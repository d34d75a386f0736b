"""Where an MPEG program stream (MPG, VOB) ends, and whether its packs and packets lie one behind the other up to there.

FFmpeg looks for the next start code where it finds none, and leaves out packets whose header makes no sense: it says
neither. Source: ISO/IEC 11172-1 (MPEG-1), section 2.4; ISO/IEC 13818-1 (MPEG-2), sections 2.4.3.6 and 2.5.
"""

from __future__ import annotations

from typing import BinaryIO

PACK = b"\0\0\1\xba"
"""How a pack begins, and so a program stream."""

_START = b"\0\0\1"
_PACK, _END, _LEAST = 0xBA, 0xB9, 0xB9  # start codes below are of a video's data
_HEADER_BYTES = 64  # of a packet that are looked at: up to 16 bytes of stuffing stand before an MPEG-1 packet's times
_VIDEO = range(0xE0, 0xF0)
_NO_HEADER = frozenset({0xBB, 0xBC, 0xBE, 0xBF, 0xF0, 0xF1, 0xF2, 0xF8, 0xFF})
"""System header, map, padding, private data and control messages: packets without times."""

_SECTORS = (2048, 2324)
"""Bytes of a sector of a DVD and of a Video CD, which recorders may fill with zeros behind the last packet."""

_PIECE = 1 << 20  # bytes

MAX_PACKETS = 4_000_000
"""Of a file with more packs and packets, the rest is not checked."""


def walk(file: BinaryIO, size: int) -> tuple[int, int | None]:
    """End of the last packet, and the first byte at which a pack or packet does not begin as it must.

    A file that begins with zeros lost its first pack; one that begins otherwise, in a packet, is not looked at.
    """
    file.seek(0)
    head = file.read(4)
    if head != PACK:
        return size, None if any(head) else 0
    position, has_ended = 0, False
    for _ in range(MAX_PACKETS):
        if position >= size:
            break
        file.seek(position)
        header = file.read(_HEADER_BYTES)
        if not header.startswith(_START[: len(header)]) or (len(header) > 3 and header[3] < _LEAST):
            stop = _zeros_end(file, position, size)
            if stop == size and (has_ended or 0 < size - position < max(_SECTORS)):
                break
            if not _is_fill(position, stop) or stop == size:
                return position, position
            position = stop
            continue
        length = _length(header)
        if length is None:
            return position, position
        if not length:  # a video of unknown length, which the standard does not allow
            return size, None
        has_ended = header[3:4] == bytes([_END])
        position += length
    return position, None


def _length(header: bytes) -> int | None:
    """Bytes of the pack header or packet that begins with `header`; 0 if it does not say, None if it makes no sense.

    At the end of a file, `header` may be short: then it is at least as much longer as is needed to say.
    """
    if len(header) < 4:
        return 4
    if header[3] == _END:
        return 4
    if len(header) < 6:
        return 6
    if header[3] == _PACK:
        if header[4] >> 6 == 0b01:
            return 14 + (header[13] & 7 if len(header) > 13 else 0)
        return 12 if header[4] >> 4 == 0b0010 else None
    length = int.from_bytes(header[4:6], "big")
    if not length and header[3] in _VIDEO:
        return 0 if header[6:7] and header[6] >> 6 == 0b10 else None
    has_times = length and header[3] not in _NO_HEADER and len(header) >= 6 + min(length, _HEADER_BYTES - 6)
    return 6 + length if not has_times or _is_times(header[6 : 6 + length]) else None


def _is_times(data: bytes) -> bool:
    """Whether a packet's data begins with times as in MPEG-2, or as in MPEG-1, or says that there are none."""
    if data[0] >> 6 == 0b10:
        if len(data) < 3:
            return False
        num_bytes = (0, 0, 5, 10)[data[1] >> 6]
        return num_bytes <= data[2] <= len(data) - 3 and _are_marked(data[3 : 3 + num_bytes])
    data = data.lstrip(b"\xff")
    if data and data[0] >> 6 == 0b01:  # size of the decoder's buffer
        data = data[2:]
    if not data:
        return True  # nothing but stuffing
    kind = data[0] >> 4
    return data[0] == 0x0F or (kind in (2, 3) and _are_marked(data[: 5 * (kind - 1)]))


def _are_marked(times: bytes) -> bool:
    """Whether the bits are 1 that are 1 in all times, of 5 bytes each."""
    return all(times[index] & 1 for index in range(len(times)) if index % 5 in (0, 2, 4))


def _zeros_end(file: BinaryIO, position: int, size: int) -> int:
    """Where zeros from `position` on end: at the start code behind them, at another byte, or at the end of the file."""
    file.seek(position)
    while data := file.read(_PIECE):
        rest = data.lstrip(b"\0")
        if rest:
            found = file.tell() - len(rest)
            return max(position, found - 2) if rest[0] == 1 else found
    return size


def _is_fill(position: int, stop: int) -> bool:
    """Whether zeros from `position` to `stop` may be the rest of a sector; a sector of nothing else lost its pack."""
    ends = [sector for sector in _SECTORS if stop % sector == 0]
    return any(position % sector and stop - position < sector for sector in ends)
