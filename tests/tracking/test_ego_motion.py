"""The shift by a turn against the exact projection."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import rotation
from foreglow.tracking.tracker import turn_shift_px
from tests.tracking.made_up import camera

CENTRES_PX = np.array([[640.0, 480.0], [100.0, 200.0], [1200.0, 900.0], [700.0, 40.0]])


@pytest.mark.parametrize("turn_rad", [-0.01, 0.002, 0.01])
def test_shift_is_that_of_distant_points(turn_rad: float) -> None:
    seen = camera()
    turned = seen.project(seen.rays(CENTRES_PX) @ rotation(yaw_rad=turn_rad))
    np.testing.assert_allclose(turn_shift_px(seen, CENTRES_PX, turn_rad), turned - CENTRES_PX, atol=0.1)


def test_a_left_turn_moves_the_image_to_the_right() -> None:
    np.testing.assert_allclose(turn_shift_px(camera(), CENTRES_PX[:1], 0.01), [[14.0, 0.0]])


def test_no_points() -> None:
    assert turn_shift_px(camera(), np.zeros((0, 2)), 0.1).shape == (0, 2)
