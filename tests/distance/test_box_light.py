from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.distance.road_surface import CONTRAST_FLOOR, light_of_boxes
from foreglow.geometry import Floats
from foreglow.types import Boxes, Image

SHARES = (np.arange(9) + 0.5) / 9
RIM = np.array([-0.5, 0.0, 0.5, 1.0, 1.5])
RIM_X = np.concatenate([RIM, RIM, np.full(3, -0.5), np.full(3, 1.5)])
RIM_Y = np.concatenate([np.full(5, -0.5), np.full(5, 1.5), RIM[1:-1], RIM[1:-1]])


def light_by_hand(image: Image, boxes_xyxy_px: Boxes) -> tuple[Floats, Floats]:
    """The same in NumPy, one box after another."""

    def read(x: Floats, y: Floats) -> Floats:
        rows, columns = (
            np.minimum(np.maximum(coordinates, 0.0), size - 0.5).astype(int)
            for coordinates, size in zip((y, x), image.shape, strict=True)
        )
        return np.asarray(image[rows, columns], np.float64)

    pixels, contrasts = [], []
    for x1, y1, x2, y2 in boxes_xyxy_px.astype(np.float64):
        x, y = np.meshgrid(x1 + (x2 - x1) * SHARES, y1 + (y2 - y1) * SHARES)
        dark = np.sort(read(x1 + (x2 - x1) * RIM_X, y1 + (y2 - y1) * RIM_Y))[8]
        above = np.maximum(read(x, y) - dark, 0.0)
        weights = above**2 + 1e-9
        pixels.append([(weights * x).sum() / weights.sum(), (weights * y).sum() / weights.sum()])
        contrasts.append(above.max() * 255.0 / np.iinfo(image.dtype).max + CONTRAST_FLOOR)
    return np.array(pixels).reshape(-1, 2), np.array(contrasts)


@pytest.mark.slow
@settings(derandomize=True, max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 90), st.integers(1, 90), st.sampled_from([np.uint8, np.uint16]))
def test_as_in_numpy_at_every_border(seed: int, width_px: int, height_px: int, kind: type[np.uint8]) -> None:
    random = np.random.default_rng(seed)
    image = random.integers(0, np.iinfo(kind).max, (height_px, width_px), kind, endpoint=True)
    low = random.integers(-40, 100, (12, 2))
    boxes = np.concatenate([low, low + random.integers(1, 60, (12, 2))], axis=1).astype(np.int32)
    for view in (image, image[::-1], image[:, ::-1], image[::2, ::3]):
        pixels, contrasts = light_of_boxes(view, boxes)
        expected_pixels, expected_contrasts = light_by_hand(view, boxes)
        np.testing.assert_allclose(pixels, expected_pixels, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(contrasts, expected_contrasts, rtol=1e-12)


def test_a_lamp_beside_the_middle_and_a_box_without_light() -> None:
    image = np.full((100, 200), 20, np.uint8)
    image[40:44, 60:64] = 220
    pixels, contrasts = light_of_boxes(image, np.array([[50, 30, 77, 57], [120, 30, 140, 40]], np.int32))
    assert pixels[0] == pytest.approx([62.0, 42.0], abs=1.0)
    assert pixels[1] == pytest.approx([130.0, 35.0])
    assert contrasts == pytest.approx([200.0 + CONTRAST_FLOOR, CONTRAST_FLOOR])


def test_no_boxes() -> None:
    pixels, contrasts = light_of_boxes(np.zeros((4, 4), np.uint8), np.zeros((0, 4), np.int32))
    assert pixels.shape == (0, 2)
    assert contrasts.shape == (0,)
