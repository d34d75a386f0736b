"""Looming: an approaching light grows, and its rate of growth relative to its size gives its range.

Units: metres, seconds, pixels. For a light of the size s in the image, on a vehicle that comes nearer at the closing
speed v, the range and its relative standard deviation are

    r = v / g,   g = (ds / dt) / s                                                                              (1)
    (sigma_r / r)^2 = (n sigma_s / (g s))^2 + (sigma_v / v)^2                                                   (2)

v is our own speed plus a typical speed of oncoming vehicles. sigma_s is the noise of a measured size, and n the noise
of an alpha-beta filter's rate for a size with the noise 1, at the frame interval dt:

    n^2 = 2 beta^2 / (alpha (4 - 2 alpha - beta)) / dt^2                                                        (3)

Two independent ranges are fused by their inverse variances:

    r = (r1 / s1^2 + r2 / s2^2) sigma^2,   1 / sigma^2 = 1 / s1^2 + 1 / s2^2                                    (4)

The model breaks where the box does not grow like the object: the glare of a lamp grows more slowly than the lamp, so
that the lamp seems too far; light on the roadside does not come nearer at the vehicle's speed.

Sources: Lee, A theory of visual control of braking based on information about time-to-collision, 1976, for (1);
Blackman, Multiple-target tracking, 1986, variance reduction ratios of the alpha-beta filter, for (3).
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.geometry import Floats

OTHER_SPEED_MPS = 17.0
OTHER_SPEED_SIGMA_MPS = 6.0
"""Speed of an oncoming vehicle on a rural road and its standard deviation: 60 km/h, mostly between 20 and 100 km/h."""

SIZE_SIGMA_PX = 1.5
"""Standard deviation of a box's side from frame to frame, for frames of 1280 columns."""

MIN_GROWTH_PER_S = 0.05
"""Slower growth cannot be told from noise, and gives no range."""


def looming_ranges(
    sizes_px: Floats, rates_px_per_s: Floats, speed_mps: float, rate_gain_per_s: float
) -> tuple[Floats, Floats]:
    """Ranges of lights on oncoming vehicles and standard deviations, both of shape (M,), metres, by (1) and (2).

    NaN and infinity where a light grows too slowly.

    Args:
        sizes_px: Shape (M,), filtered, such as the square roots of the boxes' areas.
        rates_px_per_s: Shape (M,), rates of the sizes.
        speed_mps: Our own speed.
        rate_gain_per_s: n of (3): standard deviation of a rate for one pixel of noise in the sizes.

    >>> ranges_m, _ = looming_ranges(np.array([20.0]), np.array([8.0]), 23.0, 1.0)
    >>> ranges_m.tolist()  # 2.5 s away at a closing speed of 40 m/s
    [100.0]
    """
    growth = rates_px_per_s / np.maximum(sizes_px, 1e-9)
    is_growing = growth > MIN_GROWTH_PER_S
    growth = np.where(is_growing, growth, 1.0)
    closing_mps = max(speed_mps, 0.0) + OTHER_SPEED_MPS
    ranges_m = closing_mps / growth  # (1)
    noise = SIZE_SIGMA_PX * rate_gain_per_s / (growth * np.maximum(sizes_px, 1e-9))
    relative = np.hypot(noise, OTHER_SPEED_SIGMA_MPS / closing_mps)  # (2)
    return np.where(is_growing, ranges_m, np.nan), np.where(is_growing, ranges_m * relative, np.inf)


def fused(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Two independent estimates, each of ranges and standard deviations of shape (M,), as one by (4).

    NaN where both ranges are.

    >>> fused((np.array([60.0]), np.array([10.0])), (np.array([80.0]), np.array([10.0])))[0].tolist()
    [70.0]
    """
    weights = [np.where(np.isnan(ranges_m), 0.0, 1.0 / sigmas_m**2) for ranges_m, sigmas_m in (first, second)]
    total = weights[0] + weights[1]
    # Ranges without a finite sigma have no weight; where both have none, the first stays.
    has_weight = total > 0
    divisor = np.where(has_weight, total, 1.0)
    sums_m = weights[0] * np.nan_to_num(first[0]) + weights[1] * np.nan_to_num(second[0])
    return np.where(has_weight, sums_m / divisor, first[0]), np.where(has_weight, 1.0 / np.sqrt(divisor), first[1])


def rate_noise(alpha: float, beta: float, step_s: float) -> float:
    """Standard deviation of an alpha-beta filter's rate, for measurements with a standard deviation of 1."""
    return math.sqrt(2.0 * beta * beta / (alpha * (4.0 - 2.0 * alpha - beta))) / step_s  # (3)
