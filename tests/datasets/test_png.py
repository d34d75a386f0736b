"""PNG files: what lies beside their pixels changes nothing, and nobody writes about it."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import read_image
from tests.datasets.test_images import SMOOTH, encoded, written


def chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@pytest.mark.parametrize(
    "aside",
    [
        chunk(b"iCCP", b"name\0\0" + zlib.compress(bytes(200))),
        chunk(b"zTXt", b"name\0\0" + zlib.compress(bytes(1 << 24))),
        chunk(b"gAMA", bytes(4)),
        chunk(b"tEXt", b"name\0text")[:-1] + b"?",
        chunk(b"tRNS", bytes(2))[:-1] + b"?",
    ],
)
def test_what_lies_beside_the_pixels_of_a_png_is_not_for_libpng(
    tmp_path: Path, aside: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    data = encoded(".png", SMOOTH)
    path = written(tmp_path, "a.png", data[:33] + aside + data[33:] + b"behind")
    np.testing.assert_array_equal(read_image(path), SMOOTH)
    assert capfd.readouterr().err == ""


def test_a_png_keeps_how_it_was_held(tmp_path: Path) -> None:
    exif = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x112, 3, 1, 6, 0, 0)
    data = encoded(".png", SMOOTH)
    path = written(tmp_path, "a.png", data[:33] + chunk(b"gAMA", bytes(4)) + chunk(b"eXIf", exif) + data[33:])
    np.testing.assert_array_equal(read_image(path), np.rot90(SMOOTH, -1))
