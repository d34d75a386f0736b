"""Averages over the latest ranges, and standard deviations that do not promise too much."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.tracking.track_range import (
    RANGE_RATE_SIGMA_MPS,
    filtered_sigmas,
    mean_of,
    median_of,
    remembered,
)


@given(st.lists(st.floats(1, 500) | st.just(nan), min_size=5, max_size=5))
def test_averages_leave_out_what_is_unknown(row: list[float]) -> None:
    known = [value for value in row if value == value]
    history = np.array([row])
    if known:
        assert mean_of(history)[0] == pytest.approx(np.mean(known))
        assert median_of(history)[0] == pytest.approx(np.median(known))
    else:
        assert np.isnan([mean_of(history)[0], median_of(history)[0]]).all()


def test_newest_comes_first_and_the_oldest_is_forgotten() -> None:
    history = np.full((2, 3), nan)
    for values in ([1.0, nan], [2.0, 20.0], [nan, 30.0], [4.0, 40.0], [5.0, nan]):
        history = remembered(history, np.array(values))
    np.testing.assert_array_equal(history, [[5.0, 4.0, 2.0], [40.0, 30.0, 20.0]])


def test_a_sigma_that_is_always_the_same_does_not_shrink() -> None:
    """The errors of a track are the same ones in each frame: a filter makes none of them smaller."""
    sigmas_m = np.array([inf])
    for _ in range(50):
        sigmas_m = filtered_sigmas(sigmas_m, np.array([8.0]), 1 / 18, 0.8)
        assert sigmas_m[0] >= 8.0
    assert sigmas_m[0] < 8.2


@pytest.mark.parametrize(
    ("before", "measured", "expected"),
    [
        (10.0, 4.0, 0.8 * 4.0 + 0.2 * (10.0 + RANGE_RATE_SIGMA_MPS * 0.5)),
        (10.0, nan, 10.0 + RANGE_RATE_SIGMA_MPS * 0.5),
        (inf, 4.0, 4.0),
        (inf, nan, inf),
        (10.0, inf, inf),
        (inf, inf, inf),
    ],
)
def test_sigma_by_hand(before: float, measured: float, expected: float) -> None:
    assert filtered_sigmas(np.array([before]), np.array([measured]), 0.5, 0.8)[0] == pytest.approx(expected)


def test_a_gain_of_one_forgets() -> None:
    measured = np.array([4.0, inf])
    np.testing.assert_array_equal(filtered_sigmas(np.array([10.0, inf]), measured, 0.5, 1.0), measured)
