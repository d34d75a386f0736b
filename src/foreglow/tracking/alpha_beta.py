"""Alpha-beta filters over many tracks and channels at once, with time steps of any length.

An alpha-beta filter is the steady state of a Kalman filter for constant velocity. State: a value x and its rate v per
second, in any unit, for each channel. Prediction over dt seconds, and correction by a measurement z:

    x' = x + v dt                                                                                               (1)
    x = x' + alpha (z - x'),   v = v + beta (z - x') / dt                                                       (2)
    beta = alpha^2 / (2 - alpha)                                                                                (3)

Source: Benedict and Bordner, Synthesis of an optimal set of radar track-while-scan smoothing equations, 1962.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats


def steady_betas(alphas: ArrayLike) -> Floats:
    """The beta that belongs to each alpha: the best compromise between following manoeuvres and suppressing noise.

    >>> steady_betas([0.5, 1.0]).round(3).tolist()
    [0.167, 1.0]
    """
    gains = np.asarray(alphas, np.float64)
    return np.asarray(gains**2 / (2.0 - gains))  # (3)


def frames_in(step_s: float, rate_hz: float) -> float:
    """How many frames at `rate_hz` a step counts for, in hundredths: at most one, however long.

    >>> frames_in(1 / 18, 18.0), frames_in(1 / 60, 18.0), frames_in(0.25, 18.0)
    (1.0, 0.3, 1.0)
    """
    return min(max(round(step_s * rate_hz, 2), 0.01), 1.0)


def gain_in(alphas: ArrayLike, num_frames: float) -> Floats:
    """Gains, or weights of moving means, that do in 1 / `num_frames` steps what `alphas` do in one.

    >>> gain_in([0.75, 1.0], 0.5).tolist()
    [0.5, 1.0]
    """
    gains = np.asarray(alphas, np.float64)
    return gains if num_frames == 1.0 else np.asarray(1.0 - (1.0 - gains) ** num_frames)


def predict(values: Floats, rates: Floats, dt_s: float) -> Floats:
    """Values, shape (M, K), after `dt_s` if they change by `rates`, shape (M, K), per second."""
    return values + rates * dt_s  # (1)


def correct(
    predicted: Floats, rates: Floats, measured: Floats, dt_s: Floats, gains: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Values and rates after a measurement.

    A channel without a measurement (NaN) keeps its prediction; a channel without a value so far (NaN) begins with its
    first measurement and the rate 0.

    Args:
        predicted: Shape (M, K), the values at the time of the measurement; NaN where never measured.
        rates: Shape (M, K), per second.
        measured: Shape (M, K); NaN where not measured.
        dt_s: Shape (M, K), positive, since the channel's previous measurement: that is how long a wrong rate has acted.
        gains: Alphas and betas, each of shape (K,).

    >>> gains = (np.array([0.5]), np.array([0.1]))
    >>> values, rates = correct(np.array([[10.0]]), np.array([[0.0]]), np.array([[12.0]]), np.array([[0.5]]), gains)
    >>> values.tolist(), rates.tolist()
    ([[11.0]], [[0.4]])
    """
    alphas, betas = gains
    residuals = measured - predicted
    is_new = np.isnan(predicted)
    residuals[np.isnan(residuals)] = 0.0
    values = np.where(is_new, measured, predicted + alphas * residuals)
    return values, rates + betas * residuals / dt_s  # (2)


def moving_mean(means: Floats, values: Floats, weight: float) -> Floats:
    """Exponential moving means, shape (M,) or (M, K), after new `values` with the given weight.

    NaN in `values` leaves a mean unchanged; a mean that is NaN begins with its value.

    >>> moving_mean(np.array([0.5, 0.5, np.nan]), np.array([1.0, np.nan, 0.7]), 0.25).tolist()
    [0.625, 0.5, 0.7]
    """
    mixed = (1.0 - weight) * means + weight * values
    return np.where(np.isnan(values), means, np.where(np.isnan(means), values, mixed))
