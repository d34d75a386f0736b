"""The range of a track from the ranges of its detections, and its standard deviation.

Units: metres, seconds. The range errors of a track are mostly the same from frame to frame (pitch, road, calibration).
So standard deviations are combined as if the errors were fully correlated: by their mean, which averaging does not make
smaller. Without a measurement they grow by q = 10 m/s, since the light's motion is unknown.

For the alpha-beta filter, with the standard deviation s of the measured range, after a frame interval dt:

    sigma <- alpha s + (1 - alpha) (sigma + q dt)   measured;   sigma <- sigma + q dt   missed                  (1)

For the mean or median of the last n measured ranges, a time t after the latest of them:

    sigma = (s_1 + ... + s_n) / n + q t                                                                         (2)
"""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats

RANGE_RATE_SIGMA_MPS = 10.0
"""q: how fast a range is assumed to drift off its prediction without a measurement; half of the closing speed of two
cars at a moderate 36 km/h."""


def remembered(history: Floats, values: Floats) -> Floats:
    """`history`, shape (M, H), with `values`, shape (M,), put in front; rows whose value is NaN stay unchanged."""
    shifted = np.concatenate([values[:, None], history[:, :-1]], axis=1)
    return np.where(np.isnan(values)[:, None], history, shifted)


def mean_of(history: Floats) -> Floats:
    """Mean of each row, shape (M,), leaving out NaN; NaN for a row of NaN alone."""
    is_known = ~np.isnan(history)
    num = is_known.sum(axis=1)
    sums = np.where(is_known, history, 0.0).sum(axis=1)
    return np.where(num > 0, sums / np.maximum(num, 1), np.nan)


def median_of(history: Floats) -> Floats:
    """Median of each row, shape (M,), leaving out NaN; NaN for a row of NaN alone.

    >>> median_of(np.array([[3.0, np.nan, 1.0, 2.0, 8.0], [np.nan] * 5])).tolist()
    [2.5, nan]
    """
    ascending = np.sort(history, axis=1)  # NaN last
    num = (~np.isnan(history)).sum(axis=1)
    rows = np.arange(len(history))
    return np.asarray((ascending[rows, np.maximum(num - 1, 0) // 2] + ascending[rows, num // 2]) / 2.0)


def filtered_sigmas(sigmas_m: Floats, measured_m: Floats, dt_s: float, alpha: float) -> Floats:
    """Standard deviations of alpha-beta filtered ranges, shape (M,), after a frame, by (1).

    Args:
        sigmas_m: Before the frame; infinite where unknown.
        measured_m: Standard deviations of the measured ranges; infinite where unknown, NaN where nothing was measured.
        dt_s: Time since the previous frame.
        alpha: Gain of the filter.
    """
    grown_m = sigmas_m + RANGE_RATE_SIGMA_MPS * dt_s
    is_first = np.isinf(grown_m)
    mixed_m = measured_m.copy()
    mixed_m[~is_first] = alpha * measured_m[~is_first] + (1.0 - alpha) * grown_m[~is_first]  # (1)
    return np.where(np.isnan(measured_m), grown_m, mixed_m)
