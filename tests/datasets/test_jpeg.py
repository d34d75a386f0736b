"""JPEG files: whole ones of every kind are read, and damage that their decoder would pass over is noticed."""

from __future__ import annotations

import contextlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import read_image
from foreglow.datasets.image_bytes import MAX_SCANS, check_scans
from tests.bombs import many_scans
from tests.datasets.test_images import SMOOTH, encoded, written


def test_a_progressive_jpeg_with_a_thumbnail_is_followed(tmp_path: Path) -> None:
    data = encoded(".jpg", SMOOTH, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2)
    thumbnail = encoded(".jpg", SMOOTH[:64, :64])
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    whole = data[:2] + segment + data[2:]
    assert read_image(written(tmp_path, "a.jpg", whole)).shape == SMOOTH.shape
    assert read_image(written(tmp_path, "a.jpg", whole + b"trailing")).shape == SMOOTH.shape
    with pytest.raises(ValueError, match="truncated JPEG, expected the end-of-image marker"):
        read_image(written(tmp_path, "a.jpg", whole[:-100]))


def test_the_scans_of_a_jpeg_are_counted_up_to_its_end(tmp_path: Path) -> None:
    num = encoded(".jpg", SMOOTH, cv2.IMWRITE_JPEG_PROGRESSIVE, 1).count(b"\xff\xda")
    check_scans(many_scans(MAX_SCANS - num, 64))
    for data in (many_scans(MAX_SCANS - num + 1, 64), many_scans(200, 64)[:-2]):
        hidden = data.replace(b"\xff\xda", b"\xff\xfe\0\4\xff\xd9\xff\xff\xda")  # an end in a comment, fill bytes
        for jpeg in (data, hidden):
            with pytest.raises(ValueError, match="a JPEG of at most 100 scans, got more"):
                read_image(written(tmp_path, "a.jpg", jpeg))
    read_image(written(tmp_path, "a.jpg", encoded(".jpg", SMOOTH) + 200 * b"\xff\xda"))  # of a film behind the picture


@pytest.mark.parametrize("kind", ["zeros", "gap", "restart", "fill", "sizes"])
@pytest.mark.parametrize("options", [(), (cv2.IMWRITE_JPEG_RST_INTERVAL, 4), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)])
def test_damage_in_the_data_of_a_jpeg_is_noticed(tmp_path: Path, kind: str, options: tuple[int, ...]) -> None:
    image = np.random.default_rng(5).integers(0, 255, (40, 60), np.uint8)
    whole = encoded(".jpg", cv2.resize(image, (480, 320)), cv2.IMWRITE_JPEG_QUALITY, 90, *options)
    read_image(written(tmp_path, "a.jpg", whole))
    start = whole.index(b"\xff\xda") + 20
    num_refused = 0
    for position in np.linspace(start, start + (len(whole) - start) // 2, 20).astype(int):
        data = bytearray(whole)
        if kind == "zeros":
            data[position : position + 40] = bytes(40)
        elif kind == "gap":
            del data[position : position + 100]
        elif kind == "restart":
            data[position : position + 2] = b"\xff\xd3"
        elif kind == "fill":
            data[position : position + 2] = b"\xff\xff"
        else:  # the rest of another image
            data[position:] = encoded(".jpg", cv2.resize(image.T, (480, 320)), *options)[position:]
        path = written(tmp_path, "a.jpg", bytes(data))
        with contextlib.suppress(ValueError):
            read_image(path)
            continue
        with pytest.raises(ValueError, match=r"a\.jpg: damaged JPEG") as caught:
            read_image(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
        num_refused += 1
    assert num_refused >= 19, num_refused


def test_cameras_may_fill_the_end_of_a_jpeg(tmp_path: Path) -> None:
    data = encoded(".jpg", SMOOTH)
    for count, is_damage in ((1, False), (4, False), (10, True), (100, True)):
        path = written(tmp_path, "a.jpg", data[:-2] + bytes(count) + data[-2:])
        if is_damage:
            with pytest.raises(ValueError, match=r"damaged JPEG: \d+ extraneous bytes before marker 0xd9"):
                read_image(path)
        else:
            np.testing.assert_array_equal(read_image(path), read_image(written(tmp_path, "b.jpg", data)))


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_every_kind_of_jpeg_is_read(tmp_path: Path, mode: str) -> None:
    pillow = pytest.importorskip("PIL.Image")
    for options in ({}, {"progressive": True}, {"subsampling": 0}, {"quality": 1}, {"quality": 100, "optimize": True}):
        pillow.fromarray(SMOOTH).convert(mode).save(tmp_path / "a.jpg", **options)
        assert read_image(tmp_path / "a.jpg").shape == SMOOTH.shape
