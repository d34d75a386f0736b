"""Where a hidden oncoming vehicle will come into sight, given the light that it throws ahead.

The light on guard rails, verges and the road runs ahead of its vehicle, which is further along the road in its own
lane. So the range of the farthest light tells where along the road the vehicle may be, as a distribution; seen from our
car, that is a distribution over directions.

Units: metres, radians, seconds; the vehicle's frame, x forward, y left, azimuths to the left. Hidden state: the arc
length s of the vehicle from our rear axle, on the grid `PLACES_M`. Given the range r of the farthest light, 0 if it is
unknown, and a road that reaches to s,

    p(s) ~ exp(-((s - (160 m + 0.35 r)) / 44 m)^2 / 2)   for s >= max(r + 5 m, 10 m),   else 0                  (1)

The vehicle is in the middle of the oncoming lane, left of the centre line C(s) by half a lane, with the unit normal n
to the left and the width w from the centre line to the edge. Traffic keeps to the right:

    P(s) = C(s) + n(s) w / 2                                                                                    (2)
    azimuth(s) = atan2(P_y, P_x),   range(s) = hypot(P_x, P_y)                                                  (3)

A quantile of the azimuth is interpolated between the middles of the weights, in the order of azimuth:

    M_i = p_1 + ... + p_(i-1) + p_i / 2                                                                         (4)

The time until the vehicle is in sight has a fixed mean and spread.

Source: our own; (1) was fitted on simulated drives, see `PLACE_M`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import RoadAhead

PLACES_M = np.arange(10.0, 321.0, 10.0)
"""Arc lengths from our rear axle at which a hidden vehicle may be."""

PLACE_M, PLACE_PER_RANGE, PLACE_SIGMA_M = 160.0, 0.35, 44.0
"""Mean of (1) as a linear function of r, and its standard deviation. Fitted on the 869 frames of 27 validation drives
(`make drives`) in which light was tracked before its vehicle came into sight; vehicles are mostly met at 150 to 290 m
there."""

MIN_LEAD_M = 5.0
"""The vehicle is at least this far beyond the light that it throws."""

TIME_TO_SIGHT_S = 1.2
TIME_TO_SIGHT_SIGMA_S = 0.8
"""Median and spread of the time until the vehicle is in sight; range, speed and age of the light did not predict it any
better."""


class Occurrence(NamedTuple):
    """Where and when a hidden vehicle is expected to come into sight.

    Attributes:
        azimuths_rad: Shape (P,), azimuths of the possible positions on its lane.
        ranges_m: Shape (P,), their ranges from the vehicle's origin.
        weights: Shape (P,), their probabilities, which sum to 1.
        time_s: Time until it is in sight.
        time_sigma_s: Standard deviation of that time.
    """

    azimuths_rad: Floats
    ranges_m: Floats
    weights: Floats
    time_s: float = TIME_TO_SIGHT_S
    time_sigma_s: float = TIME_TO_SIGHT_SIGMA_S

    @property
    def azimuth_rad(self) -> float:
        """Median of the azimuth."""
        return self.quantiles_rad((0.5,))[0]

    def nearest_m(self, share: float) -> float:
        """The range within which at least this share of the probability lies."""
        index = int(self.weights.cumsum().searchsorted(share))
        return float(self.ranges_m[min(index, len(self.ranges_m) - 1)])

    def quantiles_rad(self, shares: tuple[float, ...]) -> tuple[float, ...]:
        """Quantiles of the azimuth: the given shares of the probability lie to the right of them."""
        order = self.azimuths_rad.argsort()
        sums = self.weights[order].cumsum()
        return tuple(np.interp(shares, sums - 0.5 * self.weights[order], self.azimuths_rad[order]).tolist())  # (4)


def occurrence(road: RoadAhead, light_range_m: float) -> Occurrence | None:
    """Where the vehicle may be whose farthest light is at `light_range_m`; None where the map ends before it.

    Args:
        road: The road ahead.
        light_range_m: Range from the camera to the farthest light; NaN where unknown.
    """
    places_m, points_m = _lane(road)
    range_m = 0.0 if math.isnan(light_range_m) else light_range_m
    is_ahead = (places_m <= PLACES_M[-1]) & (places_m >= max(range_m + MIN_LEAD_M, PLACES_M[0]))
    if not is_ahead.any():
        return None
    places_m, (forward, left) = places_m[is_ahead], points_m[:, is_ahead]
    deviations = (places_m - (PLACE_M + PLACE_PER_RANGE * range_m)) / PLACE_SIGMA_M
    weights = np.exp(-0.5 * deviations * deviations)  # (1)
    return Occurrence(np.arctan2(left, forward), np.hypot(left, forward), weights / weights.sum())  # (3)


def _lane(road: RoadAhead) -> tuple[Floats, Floats]:
    """Arc lengths from our position, and the middle of the oncoming lane there, forward and left, shape (2, P)."""
    x, y = road.points_m[:, 0], road.points_m[:, 1]
    dx, dy = np.diff(x), np.diff(y)
    steps_m = np.hypot(dx, dy)
    arcs_m = np.concatenate([[0.0], steps_m.cumsum()])
    nearest = int((x * x + y * y).argmin())
    arcs_m -= arcs_m[nearest]
    wanted = PLACES_M[arcs_m[-1] >= PLACES_M]
    piece = np.minimum(np.maximum(arcs_m.searchsorted(wanted) - 1, 0), len(dx) - 1)
    share = (wanted - arcs_m[piece]) / steps_m[piece]
    half = 0.5 * road.half_width_m / steps_m[piece]
    forward = x[piece] + share * dx[piece] - half * dy[piece]  # (2)
    left = y[piece] + share * dy[piece] + half * dx[piece]
    return wanted, np.stack([forward, left])
