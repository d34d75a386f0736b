"""Looming: what comes nearer grows, and how fast it grows for its size says when it is here."""

from __future__ import annotations

import math

import numpy as np

from foreglow.geometry import Floats

OTHER_SPEED_MPS = 17.0
OTHER_SPEED_SIGMA_MPS = 6.0
"""Of an oncoming vehicle on a rural road: 60 km/h, between 20 and 100."""

SIZE_SIGMA_PX = 1.5
"""Of a box's side from frame to frame, for frames 1280 columns wide."""

MIN_GROWTH_PER_S = 0.05
"""Slower growth than this each second is none that can be told from noise: nothing is known then."""


def looming_ranges(
    sizes_px: Floats, rates_px_per_s: Floats, speed_mps: float, rate_gain_per_s: float
) -> tuple[Floats, Floats]:
    """Ranges of lights on oncoming vehicles by their growth, and standard deviations, both of shape (M,), metres.

    A thing of size s that comes nearer at the speed v is r = v s / (ds/dt) away. NaN and infinity where it grows
    too slowly. It breaks where a box is not as large as the thing in it: the glare of a lamp grows more slowly than the
    lamp, so that it seems too far, and light on the roadside does not come nearer at the vehicle's speed.

    Args:
        sizes_px: Shape (M,), filtered, such as the roots of the boxes' areas.
        rates_px_per_s: Shape (M,), their rates.
        speed_mps: Ours.
        rate_gain_per_s: Standard deviation of a rate for one pixel of noise in the sizes, as `rate_noise` tells.

    Source: Lee, A theory of visual control of braking based on information about time-to-collision, 1976.

    >>> ranges_m, _ = looming_ranges(np.array([20.0]), np.array([8.0]), 23.0, 1.0)
    >>> ranges_m.tolist()  # 2.5 s from here at 40 m/s
    [100.0]
    """
    growth = rates_px_per_s / np.maximum(sizes_px, 1e-9)
    is_growing = growth > MIN_GROWTH_PER_S
    growth = np.where(is_growing, growth, 1.0)
    closing_mps = max(speed_mps, 0.0) + OTHER_SPEED_MPS
    ranges_m = closing_mps / growth
    noise = SIZE_SIGMA_PX * rate_gain_per_s / (growth * np.maximum(sizes_px, 1e-9))
    relative = np.hypot(noise, OTHER_SPEED_SIGMA_MPS / closing_mps)
    return np.where(is_growing, ranges_m, np.nan), np.where(is_growing, ranges_m * relative, np.inf)


def fused(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Ranges and standard deviations of two independent estimates as one, both of shape (M,); NaN where both are.

    >>> fused((np.array([60.0]), np.array([10.0])), (np.array([80.0]), np.array([10.0])))[0].tolist()
    [70.0]
    """
    weights = [np.where(np.isnan(ranges_m), 0.0, 1.0 / sigmas_m**2) for ranges_m, sigmas_m in (one, other)]
    total = weights[0] + weights[1]
    # Ranges without a finite sigma have no weight: alone they stay what they are.
    has_weight = total > 0
    divisor = np.where(has_weight, total, 1.0)
    sums_m = weights[0] * np.nan_to_num(one[0]) + weights[1] * np.nan_to_num(other[0])
    return np.where(has_weight, sums_m / divisor, one[0]), np.where(has_weight, 1.0 / np.sqrt(divisor), one[1])


def rate_noise(alpha: float, beta: float, step_s: float) -> float:
    """Standard deviation of an alpha-beta filter's rate, for measurements with a standard deviation of 1.

    Source: Blackman, Multiple-target tracking, 1986, variance reduction ratios of the alpha-beta filter.
    """
    return math.sqrt(2.0 * beta * beta / (alpha * (4.0 - 2.0 * alpha - beta))) / step_s
