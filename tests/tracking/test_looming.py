from __future__ import annotations

import numpy as np
import pytest

from foreglow.config import TrackerConfig
from foreglow.tracking import make_tracker
from foreglow.tracking.alpha_beta import correct, predict, steady_betas
from foreglow.tracking.looming import fused, looming_ranges, rate_noise
from foreglow.types import Detections, EgoMotion, Frame, Proposals

RATE_HZ = 18.0


def test_the_range_of_what_grows_by_its_closed_form() -> None:
    """A disc of 20 px at 100 m that comes at 40 m/s grows by 8 px a second, at 50 m by 32."""
    ranges_m, sigmas_m = looming_ranges(np.array([20.0, 40.0]), np.array([8.0, 32.0]), 23.0, 1.0)
    assert ranges_m.tolist() == pytest.approx([100.0, 50.0])
    # 1.5 px/s of 8, and 6 m/s of 40.
    assert sigmas_m[0] == pytest.approx(100.0 * np.hypot(1.5 / 8.0, 0.15))
    assert sigmas_m[1] < sigmas_m[0] / 2


@pytest.mark.parametrize("rate", [0.0, -5.0, 0.9, np.nan])
def test_what_does_not_grow_tells_nothing(rate: float) -> None:
    ranges_m, sigmas_m = looming_ranges(np.array([20.0]), np.array([rate]), 23.0, 1.0)
    assert np.isnan(ranges_m[0])
    assert np.isinf(sigmas_m[0])


def test_the_noise_of_a_rate_is_that_of_the_filter() -> None:
    """Against the filter itself, on noise alone."""
    alpha, beta = 0.3, float(steady_betas(0.3))
    noise = np.random.default_rng(0).normal(0.0, 1.0, (4000, 200))
    values, rates = noise[:, :1].copy(), np.zeros((4000, 1))
    step = np.full((4000, 1), 1 / RATE_HZ)
    for column in range(1, 200):
        predicted = predict(values, rates, 1 / RATE_HZ)
        gains = (np.array([alpha]), np.array([beta]))
        values, rates = correct(predicted, rates, noise[:, column : column + 1], step, gains)
    assert rates.std() == pytest.approx(rate_noise(alpha, beta, 1 / RATE_HZ), rel=0.05)


def test_two_estimates_as_one() -> None:
    first = (np.array([60.0, np.nan, 50.0, np.nan, 70.0]), np.array([10.0, np.inf, 5.0, np.inf, np.inf]))
    second = (np.array([90.0, 80.0, np.nan, np.nan, np.nan]), np.array([20.0, 8.0, np.inf, np.inf, np.inf]))
    ranges_m, sigmas_m = fused(first, second)
    np.testing.assert_allclose(ranges_m, [66.0, 80.0, 50.0, np.nan, 70.0])
    np.testing.assert_allclose(sigmas_m, [np.sqrt(80.0), 8.0, 5.0, np.inf, np.inf])


def approach(tracker_config: TrackerConfig, motion: EgoMotion | None) -> float:
    """The range after two seconds of a disc of 2 m that comes at 40 m/s from 130 m; NaN where none is told."""
    tracker = make_tracker(tracker_config)
    image = np.zeros((960, 1280), np.uint8)
    range_m = np.nan
    for number in range(36):
        half_px = 0.5 * 2.0 * 1300.0 / (130.0 - 40.0 * number / RATE_HZ)
        box = np.rint([640 - half_px, 480 - half_px, 640 + half_px, 480 + half_px]).astype(np.int32)
        detections = Detections(Proposals(box[None]), np.array([0.9], np.float32), 0.34)
        tracks = tracker.update(Frame(image, round(number / RATE_HZ * 1e9), motion=motion), detections, None)
        range_m = float(tracks.ranges_m[0])
    return range_m


def test_a_tracker_that_uses_it() -> None:
    motion = EgoMotion(23.0, 0.0)
    true_m = 130.0 - 40.0 * 35 / RATE_HZ
    # Growth speeds up, and its filter is late: the range is too great.
    assert true_m < approach(TrackerConfig(use_looming=True), motion) < 1.6 * true_m
    assert np.isnan(approach(TrackerConfig(use_looming=True), None))
    assert np.isnan(approach(TrackerConfig(), motion))
