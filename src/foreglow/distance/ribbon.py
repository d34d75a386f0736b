"""The road ahead as a ribbon: its centre line and cross section at fixed arc lengths, in the vehicle's frame.

Units: metres, radians, curvature 1/m positive to the left, slopes as rise per metre. The vehicle's frame is x forward,
y left, z up. The map gives the centre line P(s) = (X, Y, Z) with the heading psi(s) over the arc length s, in the frame
of a vehicle that stands at its mapped pose: where the localisation puts it on the map. The alignment says that the
vehicle really stands `shift` further along the road, `left` further to the left, and is turned by `yaw` to the left.

The piece of road that begins `shift` further on is moved to the mapped pose, and is then seen from a vehicle that is
moved to the left and turned, with the plane rotation R(angle) to the left:

    P'(s) = R(-yaw) (R(psi(0) - psi(shift)) (P(shift + s) - P(shift)) + P(0) - (0, left))                       (1)

Its heights are tilted so that the slope under the vehicle is that of the mapped pose, over the distance x ahead:

    Z'(s) = Z(shift + s) - Z(shift) + Z(0) - (Z_s(shift) - Z_s(0)) x                                            (2)

Curvature, from the headings a = 5 m before and after:

    kappa(s) = sin(psi(s + a) - psi(s - a)) / (2 a)                                                             (3)

Cross section: the road falls by `banking` for each metre to the left and by `crown` for each metre away from the
centre line. Without measured cross slopes, they are those of usual rural roads:

    banking = clip(4 m kappa, -6 %, 6 %),   crown = max(2 % - |banking|, 0)                                     (4)

The vehicle stands at the offset o from the centre line, on a road that leans and is higher than the centre line by

    lean = -banking - sign(o) crown,   rise = -banking o - crown |o|                                            (5)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import RoadAhead

Array: TypeAlias = Any
"""A NumPy array, or a PyTorch tensor while the model is fitted."""

PLACES_M = 2.0 + np.geomspace(2.5, 420.0, 44)
"""Arc lengths from the rear axle at which the road is sampled; the camera is about 2 m ahead of the axle."""

CELLS_M = np.gradient(PLACES_M)
"""Length of road that each sample stands for."""

CURVATURE_REACH_M = 5.0
"""a in (3): how far before and after a position the headings are taken for its curvature."""

_SAMPLED_M = np.concatenate(
    [PLACES_M, [0.0], PLACES_M - CURVATURE_REACH_M, [0.0], PLACES_M + CURVATURE_REACH_M, [2 * CURVATURE_REACH_M]]
)
"""All arc lengths that a ribbon needs: its samples and the vehicle's own position, then a before them, then a after."""

CROWN = 0.02
BANKING_M = 4.0
MAX_BANKING = 0.06
"""Constants of (4). Design guidelines usually ask for a crown of 2 to 2.5 % and a banking of at most 6 to 8 %; how the
banking grows between them differs much from road to road."""

BEHIND_M = 150.0
"""The centre line is continued straight this far behind its first point, for a vehicle that stands further back than
the map believes."""


class Alignment(NamedTuple):
    """The vehicle's pose on the road, relative to the map's: at s = 0, as `mapped_standing` says.

    Attributes:
        yaw_rad: Heading to the left of the mapped one.
        left_m: Offset to the left of the mapped place.
        shift_m: How far the vehicle is along the road beyond the map's position.
        yaw_sigma_rad: Standard deviation of the yaw.
        left_sigma_m: Standard deviation of the offset.
        shift_sigma_m: Standard deviation of the shift; infinite where nothing is known of it.
    """

    yaw_rad: float
    left_m: float
    shift_m: float
    yaw_sigma_rad: float
    left_sigma_m: float
    shift_sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Ribbon:
    """The road in the vehicle's frame at `PLACES_M`; arrays have shape (S, 1), to be broadcast over kinds of light.

    Attributes:
        x_m: Centre line, forward.
        y_m: Centre line, to the left.
        z_m: Height of the centre line.
        cos: Cosine of the line's heading, 1 along x.
        sin: Sine of the line's heading.
        slope: Rise for each metre along the road.
        banking: Fall for each metre to the left, from one edge to the other.
        crown: Fall for each metre away from the centre line.
        is_known: Whether the map reaches so far.
        half_width_m: From the centre line to either edge.
        lean: Rise of the road under the vehicle for each metre to its left, which is how the vehicle leans.
        rise_m: Height of the road under the vehicle above the centre line.
        curvature_per_m: Curvature beside the vehicle.
        start_cos: Cosine of the line's heading beside the vehicle.
        start_sin: Sine of the line's heading beside the vehicle.
        start_slope: Rise for each metre along the road, under the vehicle.
        shift_sigma_m: Standard deviation of the vehicle's position along the road.
        yaw_sigma_rad: Standard deviation of its heading against the road's.
        left_sigma_m: Standard deviation of its position across the road.
    """

    x_m: Array
    y_m: Array
    z_m: Array
    cos: Array
    sin: Array
    slope: Array
    banking: Array
    crown: Array
    is_known: Array
    half_width_m: float
    lean: float
    rise_m: float
    curvature_per_m: float
    start_cos: float
    start_sin: float
    start_slope: float
    shift_sigma_m: float
    yaw_sigma_rad: float
    left_sigma_m: float


def ribbon(road: RoadAhead, alignment: Alignment) -> Ribbon:
    """The ribbon of `road` in the frame of a vehicle that stands on it as `alignment` says."""
    line, shift_m = _Line(road), alignment.shift_m
    samples = line.at(np.append(_SAMPLED_M + shift_m, 0.0))
    num = len(PLACES_M) + 1
    curvatures = _curvatures(samples[num : 2 * num], samples[2 * num : 3 * num])
    bankings, crowns = _cross_slopes(curvatures, samples[:num, 6], line.has_cross_slopes)
    curvature, under_banking, under_crown = float(curvatures[-1]), float(bankings[-1]), float(crowns[-1])
    ahead, start, mapped = samples[: num - 1], samples[num - 1].tolist(), samples[-1].tolist()
    # R(psi(0) - psi(shift)) of (1)
    turn_cos = start[3] * mapped[3] + start[4] * mapped[4]
    turn_sin = start[3] * mapped[4] - start[4] * mapped[3]
    from_start_x, from_start_y = ahead[:, 0] - start[0], ahead[:, 1] - start[1]
    x = turn_cos * from_start_x - turn_sin * from_start_y + mapped[0]
    y = turn_sin * from_start_x + turn_cos * from_start_y + (mapped[1] - alignment.left_m)
    z = ahead[:, 2] + (mapped[2] - start[2]) - (start[5] - mapped[5]) * x  # (2)
    # R(-yaw) of (1)
    cos, sin = math.cos(alignment.yaw_rad), math.sin(alignment.yaw_rad)
    x, y = cos * x + sin * y, cos * y - sin * x
    turn_cos, turn_sin = turn_cos * cos + turn_sin * sin, turn_sin * cos - turn_cos * sin
    offset_m = -(mapped[1] * mapped[3] - mapped[0] * mapped[4]) + alignment.left_m
    return Ribbon(
        x_m=x[:, None],
        y_m=y[:, None],
        z_m=z[:, None],
        cos=(turn_cos * ahead[:, 3] - turn_sin * ahead[:, 4])[:, None],
        sin=(turn_sin * ahead[:, 3] + turn_cos * ahead[:, 4])[:, None],
        slope=(ahead[:, 5] - start[5] + mapped[5])[:, None],
        banking=bankings[:-1, None],
        crown=crowns[:-1, None],
        is_known=(PLACES_M + shift_m <= line.length_m)[:, None],
        half_width_m=road.half_width_m,
        lean=-under_banking - float(np.sign(offset_m)) * under_crown,  # (5)
        rise_m=-under_banking * offset_m - under_crown * abs(offset_m),
        curvature_per_m=curvature,
        start_cos=turn_cos * start[3] - turn_sin * start[4],
        start_sin=turn_sin * start[3] + turn_cos * start[4],
        start_slope=mapped[5],
        shift_sigma_m=alignment.shift_sigma_m,
        yaw_sigma_rad=alignment.yaw_sigma_rad,
        left_sigma_m=alignment.left_sigma_m,
    )


def mapped_curvatures(road: RoadAhead, arc_lengths_m: Floats) -> Floats:
    """Curvatures of the centre line at arc lengths from its beginning, shape (M,), to the left, 1/m."""
    line, middles_m = _Line(road), np.maximum(arc_lengths_m, CURVATURE_REACH_M)
    return _curvatures(line.at(middles_m - CURVATURE_REACH_M), line.at(middles_m + CURVATURE_REACH_M))


def mapped_course(road: RoadAhead, arc_lengths_m: Floats) -> tuple[Floats, Floats]:
    """How far the centre line has left its first tangent to the left, and its height, at the given arc lengths."""
    samples = _Line(road).at(np.concatenate([[0.0], arc_lengths_m]))
    from_start = samples[1:, :2] - samples[0, :2]
    return samples[0, 3] * from_start[:, 1] - samples[0, 4] * from_start[:, 0], samples[1:, 2]


def mapped_standing(road: RoadAhead) -> tuple[float, float]:
    """How the vehicle stands by the map: its heading to the left of the road's, and its offset to the left of its lane.

    Of the two lanes, its own is the one whose middle is nearer. Both are 0 where the map only says where on the road it
    is, and those of its pose where it has one.
    """
    x, y, _, cos, sin, *_ = _Line(road).at(np.zeros(1))[0].tolist()
    left_m = x * sin - y * cos  # of the centre line
    return -math.atan2(sin, cos), left_m - math.copysign(0.5 * road.half_width_m, left_m)


class _Line:
    """The centre line as a function of arc length, from `BEHIND_M` before its first point to its last."""

    def __init__(self, road: RoadAhead) -> None:
        points_m = road.points_m
        steps_m = points_m[1:] - points_m[:-1]
        lengths_m = np.sqrt(np.einsum("ij,ij->i", steps_m, steps_m))
        directions = np.empty((len(points_m), 3))
        directions[1:-1] = points_m[2:] - points_m[:-2]
        # At the ends, the direction of the parabola through the last three points.
        directions[0], directions[-1] = steps_m[0], steps_m[-1]
        if len(points_m) > 2:
            directions[0] += 0.5 * (steps_m[0] - steps_m[1] * (lengths_m[0] / lengths_m[1]))
            directions[-1] += 0.5 * (steps_m[-1] - steps_m[-2] * (lengths_m[-1] / lengths_m[-2]))
        directions /= np.maximum(np.sqrt(directions[:, 0] ** 2 + directions[:, 1] ** 2), 1e-9)[:, None]
        self._arc_lengths_m = np.empty(len(points_m) + 1)
        self._arc_lengths_m[:2] = -BEHIND_M, 0.0
        lengths_m.cumsum(out=self._arc_lengths_m[2:])
        self._columns = np.empty((len(points_m) + 1, 7))
        self._columns[1:, :3], self._columns[1:, 3:6] = points_m, directions
        self._columns[1:, 6] = road.cross_slopes
        self._columns[0] = self._columns[1]
        self._columns[0, :3] -= BEHIND_M * directions[0]
        self.length_m = float(self._arc_lengths_m[-1])
        self.has_cross_slopes = bool(road.cross_slopes.any())

    def at(self, arc_lengths_m: Floats) -> Floats:
        """Shape (M, 7): x, y, z, cosine and sine of the heading, slope and cross slope; linear between points."""
        known_m = self._arc_lengths_m
        after = np.minimum(np.maximum(known_m.searchsorted(arc_lengths_m), 1), len(known_m) - 1)
        begin, end = known_m[after - 1], known_m[after]
        share = np.minimum(np.maximum((arc_lengths_m - begin) / (end - begin), 0.0), 1.0)[:, None]
        low, high = self._columns.take(after - 1, axis=0), self._columns.take(after, axis=0)
        return np.asarray(low + (high - low) * share)


def _curvatures(before: Floats, after: Floats) -> Floats:
    """Curvatures to the left, 1/m, from samples that are twice `CURVATURE_REACH_M` apart."""
    return np.asarray((before[:, 3] * after[:, 4] - before[:, 4] * after[:, 3]) / (2 * CURVATURE_REACH_M))  # (3)


def _cross_slopes(curvatures: Floats, cross_slopes: Floats, has_slopes: bool) -> tuple[Floats, Floats]:
    """Banking and crown: the map's where it has cross slopes, otherwise those of usual roads."""
    if has_slopes:
        return -cross_slopes, np.zeros_like(cross_slopes)
    banking = np.minimum(np.maximum(BANKING_M * curvatures, -MAX_BANKING), MAX_BANKING)  # (4)
    return banking, np.maximum(CROWN - np.abs(banking), 0.0)
