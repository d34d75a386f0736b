"""The range of a track, from those of its detections, and how well it is known.

The errors of a track's ranges are mostly the same ones from frame to frame (pitch, road, calibration). So standard
deviations are combined as if they were fully dependent, by their means and not by root sums: no mean makes them
smaller. While nothing is measured they grow, since nobody knows how the light moves on.
"""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats

NUM_RANGES = 5
"""Ranges that `mean` and `median` look back on (paper: series of five frames)."""

RANGE_RATE_SIGMA_MPS = 10.0
"""By how much a range is taken to drift off its prediction, in each second without a measurement: half of the closing
speed of two cars at a moderate 36 km/h."""


def remembered(history: Floats, values: Floats) -> Floats:
    """`history`, shape (M, H), with `values`, shape (M,), in front of it; where those are NaN, as it was."""
    shifted = np.concatenate([values[:, None], history[:, :-1]], axis=1)
    return np.where(np.isnan(values)[:, None], history, shifted)


def mean_of(history: Floats) -> Floats:
    """Shape (M,): the mean of each row without its NaN; NaN where it holds nothing else."""
    is_known = ~np.isnan(history)
    num = is_known.sum(axis=1)
    sums = np.where(is_known, history, 0.0).sum(axis=1)
    return np.where(num > 0, sums / np.maximum(num, 1), np.nan)


def median_of(history: Floats) -> Floats:
    """Shape (M,): the median of each row without its NaN; NaN where it holds nothing else.

    >>> median_of(np.array([[3.0, np.nan, 1.0, 2.0, 8.0], [np.nan] * 5])).tolist()
    [2.5, nan]
    """
    ascending = np.sort(history, axis=1)  # NaN last
    num = (~np.isnan(history)).sum(axis=1)
    rows = np.arange(len(history))
    return np.asarray((ascending[rows, np.maximum(num - 1, 0) // 2] + ascending[rows, num // 2]) / 2.0)


def filtered_sigmas(sigmas_m: Floats, measured_m: Floats, dt_s: float, alpha: float) -> Floats:
    """Standard deviations of alpha-beta filtered ranges, shape (M,), after a frame.

    Args:
        sigmas_m: Before it; infinite where unknown.
        measured_m: Of the measured ranges; infinite where they are unknown, NaN where nothing was measured.
        dt_s: Since the frame before.
        alpha: Gain of the filter.
    """
    grown_m = sigmas_m + RANGE_RATE_SIGMA_MPS * dt_s
    is_first = np.isinf(grown_m)
    mixed_m = measured_m.copy()
    mixed_m[~is_first] = alpha * measured_m[~is_first] + (1.0 - alpha) * grown_m[~is_first]
    return np.where(np.isnan(measured_m), grown_m, mixed_m)
