"""Where a vehicle will appear whose light is all that is seen of it.

Light on rails, verges and the road runs ahead of its vehicle: the vehicle itself is further along the road, on its
lane. So the range of the farthest light says where on the road the vehicle may be, as a distribution; seen from our
car, that is one over directions, and in the image one over columns.
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
"""Mean of the vehicle's place over the range of its farthest light, and the standard deviation about it. Fitted on the
869 frames of 27 validation drives (`make drives`) in which light was followed before its vehicle came into sight;
what is simulated is mostly met at 150 to 290 m."""

MIN_LEAD_M = 5.0
"""The vehicle is at least so far beyond what its lamps light."""

TIME_TO_SIGHT_S = 1.2
TIME_TO_SIGHT_SIGMA_S = 0.8
"""Median and spread of the time that is left; neither range, speed nor age of the light told it any better."""


class Occurrence(NamedTuple):
    """Where and when a hidden vehicle is expected to come into sight.

    Attributes:
        azimuths_rad: Shape (P,), of the places on its lane, to the left in the vehicle's frame.
        ranges_m: Shape (P,), of the places.
        weights: Shape (P,), their probabilities, which sum to 1.
        time_s: Until it is in sight.
        time_sigma_s: Standard deviation of that.
    """

    azimuths_rad: Floats
    ranges_m: Floats
    weights: Floats
    time_s: float = TIME_TO_SIGHT_S
    time_sigma_s: float = TIME_TO_SIGHT_SIGMA_S

    @property
    def azimuth_rad(self) -> float:
        """Median of the direction."""
        return self.quantiles_rad((0.5,))[0]

    def nearest_m(self, share: float) -> float:
        """The range within which so much of the probability lies, at least."""
        place = int(self.weights.cumsum().searchsorted(share))
        return float(self.ranges_m[min(place, len(self.ranges_m) - 1)])

    def quantiles_rad(self, shares: tuple[float, ...]) -> tuple[float, ...]:
        """Directions to the right of which so much of the probability lies; linear in between."""
        order = self.azimuths_rad.argsort()
        sums = self.weights[order].cumsum()
        return tuple(np.interp(shares, sums - 0.5 * self.weights[order], self.azimuths_rad[order]).tolist())


def occurrence(road: RoadAhead, light_range_m: float) -> Occurrence | None:
    """Where the vehicle may be whose farthest light is at `light_range_m`; None where the road ends before it.

    Traffic keeps to the right: the vehicle is in the middle of the left half of the carriageway.

    Args:
        road: The road ahead.
        light_range_m: From the camera to the farthest light; NaN where unknown.
    """
    places_m, points_m = _lane(road)
    range_m = 0.0 if math.isnan(light_range_m) else light_range_m
    is_ahead = (places_m <= PLACES_M[-1]) & (places_m >= max(range_m + MIN_LEAD_M, PLACES_M[0]))
    if not is_ahead.any():
        return None
    places_m, (forward, left) = places_m[is_ahead], points_m[:, is_ahead]
    offs = (places_m - (PLACE_M + PLACE_PER_RANGE * range_m)) / PLACE_SIGMA_M
    weights = np.exp(-0.5 * offs * offs)
    return Occurrence(np.arctan2(left, forward), np.hypot(left, forward), weights / weights.sum())


def _lane(road: RoadAhead) -> tuple[Floats, Floats]:
    """Arc lengths from beside us, and points forward and left, shape (2, P), of the oncoming lane's middle."""
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
    forward = x[piece] + share * dx[piece] - half * dy[piece]
    left = y[piece] + share * dy[piece] + half * dx[piece]
    return wanted, np.stack([forward, left])
