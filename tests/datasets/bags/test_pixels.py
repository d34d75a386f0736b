"""Every encoding becomes the grey image that it means."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.datasets import to_grey
from foreglow.datasets.bags.pixels import ENCODINGS, Pixels, grey_image

HEIGHT, WIDTH = 66, 70
ORDERS = {"mono": (0,), "rgb": (0, 1, 2), "bgr": (2, 1, 0), "rgba": (0, 1, 2, 3), "bgra": (2, 1, 0, 3)}
BAYER = ("rggb", "bggr", "gbrg", "grbg")


def pixels_of(values: NDArray[Any], encoding: str, *, padding: int = 0, is_big: bool = False) -> Pixels:
    """The message of an array of shape (height, width, channels), with so many bytes behind each row."""
    ordered = values.astype(values.dtype.newbyteorder(">" if is_big else "<"))
    rows = ordered.reshape(len(values), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return Pixels(values.shape[0], values.shape[1], encoding, is_big, rows.shape[1], memoryview(rows.tobytes()))


def colours(dtype: type, channels: int) -> NDArray[Any]:
    return np.random.default_rng(3).integers(0, np.iinfo(dtype).max, (HEIGHT, WIDTH, channels), dtype, endpoint=True)


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("is_big", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("name", ORDERS)
def test_grey_and_colour(name: str, dtype: type, is_big: bool, padding: int) -> None:
    values = colours(dtype, len(ORDERS[name]))
    message = pixels_of(
        values[:, :, ORDERS[name]], f"{name}{8 * np.dtype(dtype).itemsize}", padding=padding, is_big=is_big
    )
    image = grey_image(message)
    assert image.dtype == dtype
    np.testing.assert_array_equal(image, to_grey(values))


@pytest.mark.parametrize(("name", "dtype"), [("8UC1", np.uint8), ("16UC1", np.uint16)])
def test_names_of_opencv(name: str, dtype: type) -> None:
    values = colours(dtype, 1)
    np.testing.assert_array_equal(grey_image(pixels_of(values, name)), values[:, :, 0])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_big", [False, True])
@pytest.mark.parametrize("pattern", BAYER)
def test_mosaics(pattern: str, is_big: bool, dtype: type) -> None:
    """Of one colour everywhere: inside, the grey of that colour."""
    scale = int(np.iinfo(dtype).max) // 255
    colour = {"r": 200 * scale, "g": 90 * scale, "b": 20 * scale}
    tile: NDArray[Any] = np.array([colour[name] for name in pattern], dtype).reshape(2, 2)
    mosaic = np.tile(tile, (HEIGHT // 2, WIDTH // 2))[:, :, None]
    image = grey_image(pixels_of(mosaic, f"bayer_{pattern}{8 * np.dtype(dtype).itemsize}", is_big=is_big))
    expected = int(to_grey(np.array([[list(colour.values())]], dtype))[0, 0])
    assert image.dtype == dtype
    assert np.abs(image[2:-2, 2:-2].astype(int) - expected).max() <= scale


def test_an_image_is_an_array_of_its_own() -> None:
    """A frame that is kept must not keep the chunk that it came from."""
    image = grey_image(pixels_of(colours(np.uint8, 1), "mono8"))
    assert image.base is None or image.base.nbytes == image.nbytes
    assert not isinstance(image.base, memoryview)


GOOD = pixels_of(colours(np.uint8, 1), "mono8")


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (replace(GOOD, encoding="yuv422"), "encoding: expected one of 8UC1, 16UC1, mono8"),
        (replace(GOOD, encoding="rgb8"), "step: expected at least 210 bytes for 70 px of rgb8, got 70"),
        (replace(GOOD, step=69), "step: expected at least 70 bytes"),
        (replace(GOOD, step=71), "data: expected 4686 bytes by height and step, got 4620"),
        (replace(GOOD, height_px=67), "data: expected 4690 bytes"),
        (replace(GOOD, data=GOOD.data[:-1]), "data: expected 4620 bytes by height and step, got 4619"),
        (replace(GOOD, height_px=63), "image size: expected 64 to 8192 px a side, got 70x63 px"),
        (replace(GOOD, width_px=0), "image size"),
        (replace(GOOD, height_px=2**32 - 1, width_px=2**32 - 1, step=2**32 - 1), "image size"),
    ],
)
def test_what_cannot_be(broken: Pixels, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        grey_image(broken)


def test_every_encoding_has_a_test() -> None:
    tested = {f"{name}{bits}" for name in (*ORDERS, *(f"bayer_{each}" for each in BAYER)) for bits in (8, 16)}
    assert set(ENCODINGS) == tested | {"8UC1", "16UC1"}
