"""TIFF: what it may hold beside pixels that are taken as they are."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.datasets import read_image
from tests.datasets.test_images import GREY_16, SMOOTH, encoded, written


def test_float_tiff(tmp_path: Path) -> None:
    data = encoded(".tif", (GREY_16 / 65535).astype(np.float32))
    assert np.array_equal(read_image(written(tmp_path, "a.tif", data)), GREY_16)


def test_a_tiff_with_a_smaller_copy_of_itself(tmp_path: Path) -> None:
    """The second page of the file says that it is one."""
    cv2.imwritemulti(str(tmp_path / "copy.tif"), [SMOOTH, SMOOTH[:64, :64]])
    data = bytearray((tmp_path / "copy.tif").read_bytes())
    entry = struct.pack("<HHI", 254, 4, 1)
    kind = data.rfind(entry)
    if kind < 0:  # this encoder does not write the tag: another one, which we do not read, becomes it
        second = struct.unpack_from("<I", data, 4)[0]
        second = struct.unpack_from("<I", data, second + 2 + 12 * struct.unpack_from("<H", data, second)[0])[0]
        tags = [second + 2 + 12 * k for k in range(struct.unpack_from("<H", data, second)[0])]
        kind = next(at for at in tags if struct.unpack_from("<H", data, at)[0] in (284, 305, 296, 282))
        data[kind : kind + 8] = entry
    data[kind + 8 : kind + 12] = struct.pack("<I", 1)
    (tmp_path / "copy.tif").write_bytes(data)
    np.testing.assert_array_equal(read_image(tmp_path / "copy.tif"), SMOOTH)


def tiff(pixels: NDArray[Any], extra: int = 0, meaning: int = 2) -> bytes:
    """An uncompressed TIFF whose last channel is of the kind `extra` (ExtraSamples); white is 0 for the `meaning` 0."""
    height, width, channels = pixels.shape
    short, long = 3, 4
    bits = 8 * pixels.itemsize
    entries = [(256, short, width), (257, short, height), (258, short, bits), (259, short, 1), (262, short, meaning)]
    entries += [(273, long, 8), (277, short, channels), (278, short, height), (279, long, pixels.nbytes)]
    entries += [(284, short, 1), (338, short, extra)]
    directory = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    head = b"II*\0" + struct.pack("<I", 8 + pixels.nbytes)
    return head + pixels.tobytes() + struct.pack("<H", len(entries)) + directory + bytes(4)


@pytest.mark.parametrize(
    ("tag", "value", "kind"),
    [
        (258, 4, "a TIFF with values of 4 bits"),
        (259, 50000, "a TIFF that is compressed by Zstandard"),
        (259, 34925, "a TIFF that is compressed by LZMA"),
        (339, 3, "a TIFF with floats of 16 bits"),
    ],
)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_tiff_of_an_unusual_kind_is_named(
    tmp_path: Path, tag: int, value: int, kind: str, channels: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """It may be whole: only its kind is not read here."""
    data = bytearray(tiff(np.full((80, 96, channels), 200, np.uint16), meaning=1 if channels == 1 else 2))
    place = data.index(struct.pack("<HHI", 338 if tag == 339 else tag, 3, 1))
    data[place : place + 12] = struct.pack("<HHII", tag, 3, 1, value)
    with pytest.raises(ValueError, match=rf"expected an image \(.*\), is {kind}, cannot be decoded; convert it first$"):
        read_image(written(tmp_path, "a.tif", bytes(data)))
    assert capfd.readouterr().err == ""


def test_tiff_with_an_opacity_is_refused(tmp_path: Path) -> None:
    """OpenCV would darken what is not opaque; a further channel of another kind is left out."""
    pixels = np.full((80, 96, 4), 200, np.uint8)
    pixels[:, :, 3] = 0
    path = tmp_path / "night.tif"
    path.write_bytes(tiff(pixels, extra=0))
    assert (read_image(path) == 200).all()
    path.write_bytes(tiff(pixels, extra=2))
    with pytest.raises(ValueError, match=r"night\.tif: expected a TIFF without an opacity \(alpha\), got one with"):
        read_image(path)


def test_a_tiff_in_which_white_is_0_is_read_right_or_refused(tmp_path: Path) -> None:
    """OpenCV turns 8 bits round, and takes 16 as they are: a night became a day."""
    path = tmp_path / "night.tif"
    path.write_bytes(tiff(np.full((80, 96, 1), 250, np.uint8), meaning=0))
    assert (read_image(path) == 5).all()
    path.write_bytes(tiff(np.full((80, 96, 1), 65000, np.uint16), meaning=0))
    with pytest.raises(
        ValueError, match=r"night\.tif: expected a TIFF in which 0 is black, got one in which it is white"
    ):
        read_image(path)
    path.write_bytes(tiff(np.full((80, 96, 1), 500, np.uint16), meaning=1))
    assert (read_image(path) == 500).all()
