"""The filter's laws: exact on lines, closed forms of single steps, channels that are missing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.tracking.alpha_beta import correct, moving_mean, predict, steady_betas

ALPHAS = np.array([0.5, 0.3])
GAINS = (ALPHAS, steady_betas(ALPHAS))


def follow(positions: np.ndarray, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and rates after measuring `places`, shape (T, K), at `times_s`, from the first one at rest."""
    values, rates = positions[:1].copy(), np.zeros((1, positions.shape[1]))
    for position, step_s in zip(positions[1:], np.diff(times_s), strict=True):
        predicted = predict(values, rates, step_s)
        values, rates = correct(predicted, rates, position[None], np.full_like(values, step_s), GAINS)
    return values, rates


def test_a_single_step() -> None:
    values, rates = correct(
        np.array([[10.0, 20.0]]), np.array([[4.0, -2.0]]), np.array([[12.0, 18.0]]), np.array([[0.5, 0.25]]), GAINS
    )
    np.testing.assert_allclose(values, [[11.0, 19.4]])
    np.testing.assert_allclose(rates, [[4.0 + GAINS[1][0] / 0.5 * 2.0, -2.0 - GAINS[1][1] / 0.25 * 2.0]])


def test_betas_by_hand() -> None:
    np.testing.assert_allclose(steady_betas([0.5, 0.3, 0.8, 1.0]), [0.25 / 1.5, 0.09 / 1.7, 0.64 / 1.2, 1.0])


def test_prediction_is_a_line() -> None:
    np.testing.assert_allclose(predict(np.array([[1.0, 2.0]]), np.array([[3.0, -4.0]]), 0.5), [[2.5, 0.0]])


@pytest.mark.slow
@given(st.floats(-100, 100), st.floats(-50, 50), st.integers(0, 2**32 - 1))
def test_a_line_is_followed_exactly_in_the_end_whatever_the_steps(start: float, rate: float, seed: int) -> None:
    """Constant velocity leaves no lag; dropped frames and jitter do not matter, since rates are per second."""
    times_s = np.cumsum(np.random.default_rng(seed).choice([0.05, 0.055, 0.06, 0.11], 400))
    values, rates = follow(np.stack([start + rate * times_s, 2 * start - rate * times_s], -1), times_s)
    np.testing.assert_allclose(values[0], [start + rate * times_s[-1], 2 * start - rate * times_s[-1]], atol=1e-3)
    np.testing.assert_allclose(rates[0], [rate, -rate], atol=1e-2)


def test_a_missing_channel_keeps_its_prediction() -> None:
    values, rates = correct(
        np.array([[10.0, 20.0]]), np.array([[4.0, -2.0]]), np.array([[np.nan, 22.0]]), np.ones((1, 2)), GAINS
    )
    assert (values[0, 0], rates[0, 0]) == (10.0, 4.0)
    assert values[0, 1] == pytest.approx(20.6)


def test_a_new_channel_begins_at_its_first_measurement_at_rest() -> None:
    values, rates = correct(
        np.array([[np.nan, np.nan]]), np.zeros((1, 2)), np.array([[7.0, np.nan]]), np.full((1, 2), np.inf), GAINS
    )
    assert values[0, 0] == 7.0
    assert np.isnan(values[0, 1])
    np.testing.assert_array_equal(rates, [[0.0, 0.0]])


def test_no_tracks() -> None:
    none = np.zeros((0, 2))
    values, rates = correct(predict(none, none, 0.1), none, none, none, GAINS)
    assert values.shape == rates.shape == (0, 2)


def test_moving_mean_by_hand() -> None:
    mean = np.array([0.9])
    for score in (0.4, 0.7):
        mean = moving_mean(mean, np.array([score]), 0.33)
    assert mean[0] == pytest.approx((0.9 * 0.67 + 0.4 * 0.33) * 0.67 + 0.7 * 0.33)
