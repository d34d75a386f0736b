"""Where a hidden oncoming vehicle will come into sight: where the line of sight along the road begins.

Bends and crests hide a vehicle until the straight line from us to it is free. The course of the road tells how far the
line leaves the carriageway, and how high it is above the road. How far the land beside the road is open is unknown.
So for each place on the oncoming lane there is a probability that it is in view, and a vehicle that comes nearer
appears at the first place that is.

Units: metres, radians, seconds; the vehicle's frame, x forward, y left, azimuths to the left. Hidden state: the arc
length s from us to the vehicle when it comes into sight, on the grid `PLACES_M`. Seen by us after `AHEAD_S`, further
along the road with our offset from its centre line C, as the vehicle is in the middle of the oncoming lane, to the left
of C by half the width w from there to the edge, with the unit normal n to the left; traffic keeps to the right:

    E = C(e) - n(e) (n(0) C(0)),   e = v `AHEAD_S`,   P(s) = C(e + s) + n(e + s) w / 2                            (1)

The line from E to P(s) leaves the carriageway by at most b(s), and it is at least h(s) above the road:

    b(s) = max_j |(P - E) x (C_j - E)| / |P - E| - w,   h(s) = min_j (line above C_j),   E and P between them       (2)
    q(s) = Phi(ln(B / b) / sigma_b) Phi(h / sigma_h) Phi((D - s) / sigma_D)                                       (3)

with the open width B beside the road, `OPEN_M`, and the range D from which lamps are noticed, `FAR_M`. Coming from
afar, a vehicle is in view at s or before with the probability Q(s), so that

    Q(s) = max over s' >= s of q(s'),   p(s) ~ Q(s) - Q(s + ds) + epsilon   for s >= s_min,   else 0              (4)

By now the vehicle is beyond the light that it throws, which is at the range r or farther. At its speed u it then is at

    s_min = r + `MIN_LEAD_M` - (v + u) `AHEAD_S`,   at least 10 m                                                 (5)
    azimuth(s), range(s) of P(s) - E, less what the road turns from 0 to e                                        (6)

A quantile of the azimuth is interpolated between the middles of the weights, in the order of azimuth:

    M_i = p_1 + ... + p_(i-1) + p_i / 2                                                                           (7)

The time until the vehicle is in sight has a fixed mean and spread. What stands on the road or close beside it, such as
a house at a corner, is unknown to a map, and so are vehicles on side roads.

Source: our own; decision 10 has the drives on which the constants were chosen.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.numbers import checked_number, checked_share
from foreglow.types import RoadAhead
from foreglow.types.arrays import check_kind
from foreglow.types.frame import MAX_SPEED_MPS

PLACES_M = np.arange(10.0, 321.0, 10.0)
"""Arc lengths from us at which a hidden vehicle may come into sight."""

STEP_M, EVERY = 5.0, 2
"""Between the points C_j of the centre line; every second one is one of these places."""

AHEAD_S = 0.6
"""When it comes into sight: chosen for the beam, which acts on the next second as a whole."""

OPEN_M, OPEN_LOG_SIGMA = 4.0, 0.6
"""Open width beside the carriageway up to woods, banks, walls or houses: median, and spread of its logarithm."""

EYE_M, LAMP_M, CREST_SIGMA_M = 1.3, 0.75, 0.2
"""Heights of the camera and of a headlamp's upper edge above the road, and spread of the map's height there."""

FAR_M, FAR_SIGMA_M = 260.0, 60.0
"""Range at which a lamp is noticed on an open, straight road, and its spread."""

OTHER_MPS = 20.0
"""Speed of a hidden vehicle."""

MIN_LEAD_M = 5.0
"""The vehicle is at least this far beyond the light that it throws."""

EPSILON = 1e-3
"""Weight of any place at all: maps err."""

TIME_TO_SIGHT_S = 1.2
TIME_TO_SIGHT_SIGMA_S = 0.8
"""Median and spread of the time until the vehicle is in sight; range, speed and age of the light did not predict it any
better."""


class Occurrence(NamedTuple):
    """Where and when a hidden vehicle is expected to come into sight.

    Attributes:
        azimuths_rad: Shape (P,), azimuths of the possible positions on its lane, in our frame at that time.
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
        """The range within which at least this share, 0 to 1, of the probability lies.

        Raises:
            ValueError: If it is no share.
        """
        share = checked_share("share", share)
        index = int(self.weights.cumsum().searchsorted(share))
        return float(self.ranges_m[min(index, len(self.ranges_m) - 1)])

    def quantiles_rad(self, shares: tuple[float, ...]) -> tuple[float, ...]:
        """Quantiles of the azimuth: the given shares of the probability lie to the right of them."""
        order = self.azimuths_rad.argsort()
        sums = self.weights[order].cumsum()
        return tuple(np.interp(shares, sums - 0.5 * self.weights[order], self.azimuths_rad[order]).tolist())  # (7)


def occurrence(road: RoadAhead, light_range_m: float, speed_mps: float = 0.0) -> Occurrence | None:
    """Where the vehicle may be whose farthest light is at `light_range_m` or beyond; None where the map ends before it.

    Args:
        road: The road ahead.
        light_range_m: Least range of the farthest light; NaN where unknown.
        speed_mps: Ours; 0 where unknown. More than any car drives counts as the greatest: there is low beam then.

    Raises:
        ValueError: If the road is none, the range is no number, or the speed is none or NaN.
    """
    check_kind("road", road, RoadAhead)
    light_range_m, speed_mps = checked_number("light_range_m", light_range_m), checked_number("speed_mps", speed_mps)
    if math.isnan(speed_mps):
        raise ValueError("speed_mps: expected a number, 0 where it is unknown, got nan")
    ahead_m = min(max(speed_mps, 0.0), MAX_SPEED_MPS) * AHEAD_S
    places_m, azimuths, ranges_m, in_view = _views(road, ahead_m)
    lead_m = light_range_m + MIN_LEAD_M - ahead_m - OTHER_MPS * AHEAD_S  # (5)
    is_beyond = places_m >= (-math.inf if math.isnan(lead_m) else lead_m)
    if not is_beyond.any():
        return None
    weights = (in_view[:-1] - in_view[1:] + EPSILON)[is_beyond]  # (4)
    return Occurrence(azimuths[is_beyond], ranges_m[is_beyond], weights / weights.sum())


@lru_cache(maxsize=1)
def _views(road: RoadAhead, ahead_m: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Arc lengths s, azimuths and ranges of P(s), and Q(s) with a 0 at its end: the same for all vehicles."""
    centre_m, normals = _line(road, ahead_m)
    places_m = PLACES_M[: (len(centre_m) - 2) // EVERY]
    targets = 1 + EVERY * np.arange(1, len(places_m) + 1)
    eye_m = centre_m[1, :2] - normals[1] * (normals[0] @ centre_m[0, :2])
    lanes_m = centre_m[targets, :2] + 0.5 * road.half_width_m * normals[targets]  # (1)
    beside_m, above_m = _clearances(centre_m[1:], targets - 1, eye_m, lanes_m)
    in_view = (
        _normal(np.log(OPEN_M / np.maximum(beside_m - road.half_width_m, 1e-3)) / OPEN_LOG_SIGMA)
        * _normal(above_m / CREST_SIGMA_M)
        * _normal((FAR_M - places_m) / FAR_SIGMA_M)
    )  # (3)
    in_view = np.append(np.maximum.accumulate(in_view[::-1])[::-1], 0.0)
    forward, left = (lanes_m - eye_m).T
    (nx, ny), (nx_now, ny_now) = normals[1], normals[0]
    turned_rad = math.atan2(nx_now * ny - ny_now * nx, nx_now * nx + ny_now * ny)
    return places_m, np.arctan2(left, forward) - turned_rad, np.hypot(left, forward), in_view  # (6)


def _line(road: RoadAhead, ahead_m: float) -> tuple[Floats, Floats]:
    """Points of the centre line, shape (N, 3), and its normals to the left, shape (N, 2): here, then from E on."""
    x, y, _ = road.points_m.T
    arcs_m = np.concatenate([[0.0], np.hypot(np.diff(x), np.diff(y)).cumsum()])
    arcs_m -= arcs_m[int((x * x + y * y).argmin())]
    wanted_m = np.append(0.0, np.arange(ahead_m, min(arcs_m[-1], ahead_m + PLACES_M[-1]) + 1e-6, STEP_M))
    wanted_m = wanted_m + np.array([[-1.0], [0.0], [1.0]])
    points_m = np.stack([np.interp(wanted_m, arcs_m, axis_m) for axis_m in road.points_m.T], axis=-1)
    forward, left = (points_m[2] - points_m[0])[:, :2].T
    return points_m[1], np.stack([-left, forward], axis=1) / np.hypot(forward, left)[:, None]


def _clearances(centre_m: Floats, targets: NDArray[np.int64], eye_m: Floats, lanes_m: Floats) -> tuple[Floats, Floats]:
    """b(s) + w and h(s) of (2), each of shape (P,): how far the lines from E to P(s) leave the centre line."""
    (ux, uy), (dx, dy) = (lanes_m - eye_m).T[:, :, None], (centre_m[:, :2] - eye_m).T
    lengths_m = np.hypot(ux, uy)
    shares = (ux * dx + uy * dy) / lengths_m**2
    eye_z, lamp_z = centre_m[0, 2] + EYE_M, centre_m[targets, 2, None] + LAMP_M
    is_between = np.arange(len(centre_m)) <= targets[:, None]
    beside_m = np.where(is_between, np.abs(ux * dy - uy * dx) / lengths_m, 0.0)
    above_m = np.where(is_between, eye_z + shares * (lamp_z - eye_z) - centre_m[:, 2], LAMP_M)
    return beside_m.max(axis=1), above_m.min(axis=1)


def _normal(values: Floats) -> Floats:
    """Phi, the standard normal distribution function."""
    return 0.5 * np.array([math.erfc(value) for value in (-math.sqrt(0.5) * values).tolist()])
