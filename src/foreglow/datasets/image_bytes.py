"""Checks that an encoded image is complete, and reads its size, before decoding: decoders are too tolerant.

OpenCV returns a partly grey picture for a truncated JPEG (and, before version 5, PNG), and allocates whatever
size a header claims. Other formats are not checked here: OpenCV refuses them when they are cut short.
"""

from __future__ import annotations

import zlib

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8\xff"

_JPEG_END = b"\xff\xd9"
_JPEG_SCAN = 0xDA
# Start of frame, ITU-T T.81 table B.1: 0xC0..0xCF without the tables DHT (C4), JPG (C8) and DAC (CC).
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Markers without a length: TEM, RST0..RST7.
_JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD8)})


def png_size_px(data: bytes) -> tuple[int, int]:
    """Height and width of the PNG in `data`, whose critical chunks are all there and undamaged.

    Raises:
        ValueError: If the file is cut short, or the checksum of a critical chunk is wrong; the message does
            not say where, so that the caller can add it.
    """
    size_px: tuple[int, int] | None = None
    position = len(PNG_SIGNATURE)
    while True:
        # A chunk: length (4 bytes), type (4), data, checksum of type and data (4). PNG specification, section 5.3.
        length = int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        end = position + 12 + length
        if len(data) < end:
            raise ValueError(f"truncated PNG, expected the chunk IEND, ends at byte {len(data)}")
        is_critical = kind[:1].isupper()
        if is_critical and zlib.crc32(data[position + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise ValueError(f"damaged PNG, wrong checksum of chunk {kind.decode('latin-1')!a} at byte {position}")
        if kind == b"IHDR" and length >= 8:
            width = int.from_bytes(data[position + 8 : position + 12], "big")
            size_px = int.from_bytes(data[position + 12 : position + 16], "big"), width
        if kind == b"IEND":
            break
        position = end
    if size_px is None:
        raise ValueError("damaged PNG, expected the chunk IHDR")
    return size_px


def jpeg_size_px(data: bytes) -> tuple[int, int]:
    """Height and width of the JPEG in `data`, which has its end marker.

    Raises:
        ValueError: If the file is cut short or its segments are malformed; the message does not say where.
    """
    size_px: tuple[int, int] | None = None
    position = 2
    while True:
        if position + 4 > len(data):
            raise ValueError(f"truncated JPEG, expected a segment, ends at byte {len(data)}")
        if data[position] != 0xFF:
            raise ValueError(f"damaged JPEG, expected a marker at byte {position}")
        marker = data[position + 1]
        if marker == 0xFF:  # fill byte
            position += 1
            continue
        if marker in _JPEG_BARE:
            position += 2
            continue
        if marker in _JPEG_FRAMES:
            height = int.from_bytes(data[position + 5 : position + 7], "big")
            size_px = height, int.from_bytes(data[position + 7 : position + 9], "big")
        if marker == _JPEG_SCAN:
            break
        position += 2 + max(2, int.from_bytes(data[position + 2 : position + 4], "big"))
    # Within the coded data every 0xFF is followed by 0x00 or a restart marker, so the end marker is unmistakable.
    if data.rfind(_JPEG_END, position) < 0:
        raise ValueError("truncated JPEG, expected the end-of-image marker")
    if size_px is None:
        raise ValueError("damaged JPEG, expected a start-of-frame segment before the scan")
    return size_px
