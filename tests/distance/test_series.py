from __future__ import annotations

import numpy as np
import pytest

from foreglow.lab.studies.distance.run import SERIES, over_frames

FRAMES = np.array([3, 4, 5, 7, 8, 9, 20])
RANGES = np.array([100.0, 90.0, np.nan, 60.0, 50.0, 10.0, np.nan])


def test_by_hand() -> None:
    mean, median = (over_frames(FRAMES, RANGES, SERIES[f"{name} of five frames"]) for name in ("mean", "median"))
    # Frame 8 looks back to 4, frame 9 to 5; frame 20 has nothing to look back to.
    np.testing.assert_allclose(mean, [100, 95, 95, 250 / 3, 200 / 3, 40, np.nan])
    np.testing.assert_allclose(median, [100, 95, 95, 90, 60, 50, np.nan])


@pytest.mark.parametrize("name", SERIES)
def test_frames_far_apart_change_nothing(name: str) -> None:
    np.testing.assert_array_equal(over_frames(5 * FRAMES, RANGES, SERIES[name]), RANGES)


def test_an_empty_series() -> None:
    assert over_frames(np.zeros(0, np.int64), np.zeros(0), np.mean).shape == (0,)
