from __future__ import annotations

import numpy as np
import pytest

from foreglow.distance.lamp_pairs import pair_spacings_rad

SIZES = np.full((4, 2), 0.006)
CONTRASTS = np.full(4, 200.0)


def test_two_like_lamps_are_a_pair_and_others_are_not() -> None:
    # 1.3 m apart at 50 m; one far below, one beside but far away.
    centres = np.array([[0.013, 0.0], [-0.013, 0.0005], [0.0, -0.05], [0.4, 0.0]])
    spacings = pair_spacings_rad(centres, SIZES, CONTRASTS)
    assert spacings[:2] == pytest.approx(0.026)
    assert 1.3 / spacings[0] == pytest.approx(50.0)
    assert np.isnan(spacings[2:]).all()


@pytest.mark.parametrize(
    ("sizes", "contrasts"),
    [([[0.006, 0.006], [0.015, 0.006]], [200.0, 200.0]), ([[0.006, 0.006]] * 2, [200.0, 100.0])],
)
def test_lights_of_other_size_or_brightness_are_no_pair(sizes: list[list[float]], contrasts: list[float]) -> None:
    centres = np.array([[0.02, 0.0], [-0.02, 0.0]])
    assert np.isnan(pair_spacings_rad(centres, np.array(sizes), np.array(contrasts))).all()


def test_the_nearer_of_two_partners_is_taken_and_the_third_stays_alone() -> None:
    centres = np.array([[0.02, 0.0], [0.0, 0.0], [-0.05, 0.0]])
    spacings = pair_spacings_rad(centres, SIZES[:3], CONTRASTS[:3])
    assert spacings[:2] == pytest.approx(0.02)
    assert np.isnan(spacings[2])


def test_light_on_light_is_one_light() -> None:
    centres = np.zeros((2, 2))
    assert np.isnan(pair_spacings_rad(centres, SIZES[:2], CONTRASTS[:2])).all()


@pytest.mark.parametrize("count", [0, 1])
def test_few_boxes_have_no_partner(count: int) -> None:
    assert np.isnan(pair_spacings_rad(np.zeros((count, 2)), SIZES[:count], CONTRASTS[:count])).all()
