from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.distance.lamp_pairs import twin_columns_px
from foreglow.types import Image

BOX = (10, 20, 60, 50)
LAMPS = ((28.3, 30.0, 2.0, 200.0), (40.1, 30.0, 2.0, 200.0))
"""Column, row, size in pixels and brightness of each light."""


def lit(*lights: tuple[float, float, float, float], scale: int = 1, kind: type = np.uint8) -> Image:
    """A dark image of 80 x 100 pixels with these lights."""
    rows, columns = np.mgrid[:80, :100] + 0.5
    image = np.full((80, 100), 8.0)
    for x, y, size, grey in lights:
        image += grey * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2.0 * size**2))
    shown: Image = (scale * np.minimum(image, 255.0)).astype(kind)
    return shown


def twins(image: Image, box: tuple[int, int, int, int] = BOX) -> NDArray[np.float64]:
    return np.asarray(twin_columns_px(image, np.array([box], np.int32))[0])


def test_two_lamps_of_one_box_are_where_they_are() -> None:
    np.testing.assert_allclose(twins(lit(*LAMPS)), [28.3, 40.1], atol=0.1)
    np.testing.assert_allclose(twins(lit(*LAMPS, scale=257, kind=np.uint16)), [28.3, 40.1], atol=0.1)


def test_near_each_other_they_are_told_apart_as_long_as_it_is_darker_in_between() -> None:
    apart, together = (lit((30.0, 30.0, 2.0, 200.0), (30.0 + gap, 30.0, 2.0, 200.0)) for gap in (7.0, 4.0))
    assert np.diff(twins(apart)) == pytest.approx(7.0, abs=0.4)
    assert np.isnan(twins(together)).all()


def test_their_light_on_the_road_below_them_changes_nothing() -> None:
    below = [(x, y + 10.0, 2.0, 160.0) for x, y, _, _ in LAMPS]
    np.testing.assert_allclose(twins(lit(*LAMPS, *below)), [28.3, 40.1], atol=0.15)


@pytest.mark.parametrize(
    "others",
    [
        pytest.param([], id="one light"),
        pytest.param([LAMPS[1], (52.0, 30.0, 2.0, 200.0)], id="three lights"),
        pytest.param([(40.1, 30.0, 2.0, 100.0)], id="half as bright"),
        pytest.param([(40.1, 34.0, 2.0, 200.0)], id="lower"),
        pytest.param([(44.0, 30.0, 6.0, 200.0)], id="three times as wide"),
    ],
)
def test_other_lights_are_no_twins(others: list[tuple[float, float, float, float]]) -> None:
    assert np.isnan(twins(lit(LAMPS[0], *others))).all()


def test_noise_has_no_twins() -> None:
    random = np.random.default_rng(0)
    images = [random.integers(0, 12, (80, 100)).astype(np.uint8) for _ in range(50)]
    assert all(np.isnan(twins(image)).all() for image in images)


@pytest.mark.parametrize("box", [(26, 20, 30, 50), (0, 20, 300, 50), (10, 20, 10, 50), (200, 200, 260, 260)])
def test_a_box_of_another_size_has_none(box: tuple[int, int, int, int]) -> None:
    wide = np.zeros((80, 400), np.uint8)
    wide[:, :100] = lit(*LAMPS)
    assert np.isnan(twins(wide, box)).all()


def test_a_box_ends_where_the_image_ends() -> None:
    np.testing.assert_array_equal(twins(lit(*LAMPS), (-50, -9, 200, 999)), twins(lit(*LAMPS), (0, 0, 100, 80)))


def test_views_of_an_image_are_read_as_they_are() -> None:
    image = lit(*LAMPS)
    wide = np.zeros((80, 200), np.uint8)
    wide[:, ::2] = image
    np.testing.assert_array_equal(twins(wide[:, ::2]), twins(image))
    np.testing.assert_allclose(twins(image[:, ::-1], (40, 20, 90, 50)), [100 - 40.1, 100 - 28.3], atol=0.1)


def test_no_boxes_have_none() -> None:
    assert twin_columns_px(lit(*LAMPS), np.zeros((0, 4), np.int32)).shape == (0, 2)
