"""The C++ crops: geometry of the data set path, and grey levels equal to those of OpenCV."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from foreglow import _native
from tests.shared_data import shared_file

SIZE_PX = 64


def crop(image: Any, box: tuple[int, int, int, int], support: int = 2, size_px: int = SIZE_PX) -> NDArray[Any]:
    crops, _ = _native.extract_crops(image, np.array([box], np.int32), support, size_px)
    assert crops.shape == (1, 1, size_px, size_px)
    assert crops.dtype == np.float32
    result: NDArray[np.float32] = crops[0, 0]
    return result


def expected_crop(image: Any, region: tuple[int, int, int, int], size_px: int = SIZE_PX) -> NDArray[Any]:
    left, top, right, bottom = region
    part: Any = np.ascontiguousarray(image[top:bottom, left:right])
    levels = cv2.resize(part, (size_px, size_px), interpolation=cv2.INTER_LINEAR).astype(np.float64)
    span = levels.max() - levels.min()
    return (levels - levels.min()) / span if span else np.zeros_like(levels)


@pytest.mark.parametrize("name", ["optimised", "baseline"])
def test_golden_crops(name: str) -> None:
    boxes = json.loads(shared_file(f"reference/golden/{name}_proposals.json").read_text())["proposals"]
    with np.load(shared_file(f"reference/golden/{name}_stages.npz")) as stages:
        expected = stages["crops_dataset"]
    image: Any = cv2.imread(str(shared_file("data/pvdn_frame_047433.png")), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    crops, _ = _native.extract_crops(image, np.array(boxes, np.int32), 2, SIZE_PX)
    np.testing.assert_allclose(crops[:, 0], expected, rtol=0, atol=1e-6)


@pytest.mark.slow
@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 400), st.integers(1, 400)),
    corner=st.tuples(st.integers(-30, 399), st.integers(-30, 399)),
    box_size=st.tuples(st.integers(1, 120), st.integers(1, 120)) | st.just((32, 32)),
    support=st.integers(1, 3),
    size_px=st.sampled_from([1, 7, 33, 64, 96]),
    dtype=st.sampled_from([np.uint8, np.uint16]),
)
def test_equals_opencv(
    seed: int,
    shape: tuple[int, int],
    corner: tuple[int, int],
    box_size: tuple[int, int],
    support: int,
    size_px: int,
    dtype: type[np.uint8] | type[np.uint16],
) -> None:
    """8 bit: the very grey levels. 16 bit: each level within one of OpenCV's, so a stretched value within two."""
    image: Any = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    (x, y), (width, height) = corner, box_size
    centre_x, centre_y = x + width // 2, y + height // 2
    left, right = max(centre_x - support * width, 0), min(centre_x + support * width, shape[1])
    top, bottom = max(centre_y - support * height, 0), min(centre_y + support * height, shape[0])
    result = crop(image, (x, y, x + width, y + height), support, size_px)
    if left >= right or top >= bottom:
        assert not result.any()
        return
    expected = expected_crop(image, (left, top, right, bottom), size_px)
    if dtype is np.uint8:
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-6)
    else:
        part = image[top:bottom, left:right]
        levels = cv2.resize(np.ascontiguousarray(part), (size_px, size_px), interpolation=cv2.INTER_LINEAR)
        span = max(float(np.ptp(levels)), 1.0)
        np.testing.assert_allclose(result, expected, rtol=0, atol=2.01 / max(span - 2, 0.5))


def test_flat_crop_is_zero() -> None:
    assert not crop(np.full((50, 50), 200, np.uint8), (10, 10, 20, 20)).any()


def test_box_outside_is_zero() -> None:
    image = np.random.default_rng(1).integers(0, 256, (50, 50)).astype(np.uint8)
    assert not crop(image, (500, 500, 510, 510)).any()
    assert not crop(image, (-60, 0, -50, 10)).any()


def test_strides_do_not_matter() -> None:
    image = np.random.default_rng(2).integers(0, 256, (80, 90)).astype(np.uint8)
    for view in (image[::-1], image[::2], image[3:70, 5:60]):
        boxes = (4, 5, 19, 17)
        np.testing.assert_array_equal(crop(view, boxes), crop(np.ascontiguousarray(view), boxes))


def test_crops_span_zero_to_one_and_keep_order() -> None:
    image = np.random.default_rng(3).integers(0, 256, (200, 300)).astype(np.uint8)
    boxes = np.array([[10, 10, 30, 25], [250, 150, 299, 199], [100, 20, 101, 21]], np.int32)
    crops, _ = _native.extract_crops(image, boxes, 2, SIZE_PX)
    assert (crops.min(axis=(1, 2, 3)) == 0).all()
    assert (crops.max(axis=(1, 2, 3)) == 1).all()
    for box, channels in zip(boxes, crops, strict=True):
        np.testing.assert_array_equal(crop(image, tuple(box)), channels[0])


def test_no_boxes() -> None:
    crops, levels = _native.extract_crops(np.zeros((9, 9), np.uint8), np.zeros((0, 4), np.int32), 2, 8)
    assert crops.shape == (0, 1, 8, 8)
    assert levels.shape == (0, 2)
