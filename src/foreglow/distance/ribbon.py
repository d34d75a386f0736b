"""The road ahead as a ribbon: places along it, with what a point on it, beside it or above it needs to be found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import RoadAhead

Array: TypeAlias = Any
"""A NumPy array, or a tensor of PyTorch while the model is fitted."""

PLACES_M = 2.0 + np.geomspace(2.5, 420.0, 44)
"""Arc lengths from our rear axle at which the road is looked at; a camera sits about 2 m ahead of that."""

CELLS_M = np.gradient(PLACES_M)
"""How much of the road each place stands for."""

CURVATURE_REACH_M = 5.0
"""A curvature is taken over so much road to either side."""

_LOOKS_M = np.concatenate(
    [PLACES_M, [0.0], PLACES_M - CURVATURE_REACH_M, [0.0], PLACES_M + CURVATURE_REACH_M, [2 * CURVATURE_REACH_M]]
)
"""Where the line is looked at for a ribbon: at all places and under us, then a little before these, and after."""

CROWN = 0.02
BANKING_M = 4.0
MAX_BANKING = 0.06
"""Where the map has no cross slopes: a rural road falls by 2 % to either side, and leans into a bend of radius r by
4 m / r, at most by 6 %; the crown gives way to the banking as that becomes as steep. 2 to 2.5 % and 6 to 8 % are usual
in guidelines for the design of roads; the banking between them differs much from road to road."""

BEHIND_M = 150.0
"""The line goes on straight for so long behind its first point, for a place that is less far than the map believes."""


class Alignment(NamedTuple):
    """How we stand on the road, against what the map believes: in the middle of the lane, along it, at its beginning.

    Attributes:
        yaw_rad: How far we head to the left of the road's direction.
        left_m: How far we stand to the left of the believed place.
        shift_m: How far we are along the road beyond the believed place.
        yaw_sigma_rad: Standard deviation of the yaw.
        left_sigma_m: Of the offset.
        shift_sigma_m: Of the shift; infinite where nothing is known of it.
    """

    yaw_rad: float
    left_m: float
    shift_m: float
    yaw_sigma_rad: float
    left_sigma_m: float
    shift_sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Ribbon:
    """The road in our frame at `PLACES_M`; all arrays have shape (S, 1), so that kinds of light go beside.

    Attributes:
        x_m: Of the centre line, forward.
        y_m: To the left.
        z_m: Up, before the cross slopes.
        cos: Of the line's direction, 0 along x.
        sin: Of the same.
        slope: Rise for each metre along.
        banking: Fall for each metre to the left, from one edge to the other.
        crown: Fall for each metre away from the centre line.
        is_known: Whether the map reaches so far.
        half_width_m: From the centre line to either edge.
        lean: Rise of the road under us for each metre to our left: our own lean.
        rise_m: Height of the road under us against its centre line.
        curvature_per_m: Under us, to the left.
        start_cos: Of the line's direction beside us.
        start_sin: Of the same.
        start_slope: Rise for each metre along, under us.
        shift_sigma_m: How far we may be from the place that we take for ours, along the road.
        yaw_sigma_rad: Of our heading against the road's.
        left_sigma_m: Of our place across the road.
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
    """The ribbon of `road` in our frame, when we stand on it as `alignment` says."""
    line, shift_m = _Line(road), alignment.shift_m
    at = line.at(np.append(_LOOKS_M + shift_m, 0.0))
    num = len(PLACES_M) + 1
    curvatures = _curvatures(at[num : 2 * num], at[2 * num : 3 * num])
    bankings, crowns = _cross_slopes(curvatures, at[:num, 6], line.has_cross_slopes)
    curvature, under_banking, under_crown = float(curvatures[-1]), float(bankings[-1]), float(crowns[-1])
    here, start, believed = at[: num - 1], at[num - 1].tolist(), at[-1].tolist()
    # The line as it lies before us: turned and moved so that its place under us takes that of the believed one, ...
    turn_cos = start[3] * believed[3] + start[4] * believed[4]
    turn_sin = start[3] * believed[4] - start[4] * believed[3]
    ahead_x, ahead_y = here[:, 0] - start[0], here[:, 1] - start[1]
    x = turn_cos * ahead_x - turn_sin * ahead_y + believed[0]
    y = turn_sin * ahead_x + turn_cos * ahead_y + (believed[1] - alignment.left_m)
    z = here[:, 2] + (believed[2] - start[2]) - (start[5] - believed[5]) * x
    # ... and turned against our yaw.
    cos, sin = math.cos(alignment.yaw_rad), math.sin(alignment.yaw_rad)
    x, y = cos * x + sin * y, cos * y - sin * x
    turn_cos, turn_sin = turn_cos * cos + turn_sin * sin, turn_sin * cos - turn_cos * sin
    offset_m = -(believed[1] * believed[3] - believed[0] * believed[4]) + alignment.left_m
    return Ribbon(
        x_m=x[:, None],
        y_m=y[:, None],
        z_m=z[:, None],
        cos=(turn_cos * here[:, 3] - turn_sin * here[:, 4])[:, None],
        sin=(turn_sin * here[:, 3] + turn_cos * here[:, 4])[:, None],
        slope=(here[:, 5] - start[5] + believed[5])[:, None],
        banking=bankings[:-1, None],
        crown=crowns[:-1, None],
        is_known=(PLACES_M + shift_m <= line.length_m)[:, None],
        half_width_m=road.half_width_m,
        lean=-under_banking - float(np.sign(offset_m)) * under_crown,
        rise_m=-under_banking * offset_m - under_crown * abs(offset_m),
        curvature_per_m=curvature,
        start_cos=turn_cos * start[3] - turn_sin * start[4],
        start_sin=turn_sin * start[3] + turn_cos * start[4],
        start_slope=believed[5],
        shift_sigma_m=alignment.shift_sigma_m,
        yaw_sigma_rad=alignment.yaw_sigma_rad,
        left_sigma_m=alignment.left_sigma_m,
    )


def mapped_curvatures(road: RoadAhead, places_m: Floats) -> Floats:
    """Curvatures of the centre line at arc lengths from its beginning, shape (M,), to the left, 1/m."""
    line, middles_m = _Line(road), np.maximum(places_m, CURVATURE_REACH_M)
    return _curvatures(line.at(middles_m - CURVATURE_REACH_M), line.at(middles_m + CURVATURE_REACH_M))


def mapped_course(road: RoadAhead, places_m: Floats) -> tuple[Floats, Floats]:
    """How far the centre line has turned away to the left, and how high it is, at arc lengths from its beginning."""
    at = _Line(road).at(np.concatenate([[0.0], places_m]))
    away = at[1:, :2] - at[0, :2]
    return at[0, 3] * away[:, 1] - at[0, 4] * away[:, 0], at[1:, 2]


class _Line:
    """The centre line as a function of arc length, from `BEHIND_M` before its first point to its last."""

    def __init__(self, road: RoadAhead) -> None:
        points_m = road.points_m
        steps_m = points_m[1:] - points_m[:-1]
        lengths_m = np.sqrt(np.einsum("ij,ij->i", steps_m, steps_m))
        directions = np.empty((len(points_m), 3))
        directions[1:-1] = points_m[2:] - points_m[:-2]
        # At the ends, of the parabola through the last three points.
        directions[0], directions[-1] = steps_m[0], steps_m[-1]
        if len(points_m) > 2:
            directions[0] += 0.5 * (steps_m[0] - steps_m[1] * (lengths_m[0] / lengths_m[1]))
            directions[-1] += 0.5 * (steps_m[-1] - steps_m[-2] * (lengths_m[-1] / lengths_m[-2]))
        directions /= np.maximum(np.sqrt(directions[:, 0] ** 2 + directions[:, 1] ** 2), 1e-9)[:, None]
        self._places_m = np.empty(len(points_m) + 1)
        self._places_m[:2] = -BEHIND_M, 0.0
        lengths_m.cumsum(out=self._places_m[2:])
        self._columns = np.empty((len(points_m) + 1, 7))
        self._columns[1:, :3], self._columns[1:, 3:6] = points_m, directions
        self._columns[1:, 6] = road.cross_slopes
        self._columns[0] = self._columns[1]
        self._columns[0, :3] -= BEHIND_M * directions[0]
        self.length_m = float(self._places_m[-1])
        self.has_cross_slopes = bool(road.cross_slopes.any())

    def at(self, places_m: Floats) -> Floats:
        """Shape (M, 7): x, y, z, cosine and sine of the direction, slope and cross slope."""
        after = np.minimum(np.maximum(self._places_m.searchsorted(places_m), 1), len(self._places_m) - 1)
        begin, end = self._places_m[after - 1], self._places_m[after]
        share = np.minimum(np.maximum((places_m - begin) / (end - begin), 0.0), 1.0)[:, None]
        low, high = self._columns.take(after - 1, axis=0), self._columns.take(after, axis=0)
        return np.asarray(low + (high - low) * share)


def _curvatures(before: Floats, after: Floats) -> Floats:
    """From directions that are twice `CURVATURE_REACH_M` apart, to the left, 1/m."""
    return np.asarray((before[:, 3] * after[:, 4] - before[:, 4] * after[:, 3]) / (2 * CURVATURE_REACH_M))


def _cross_slopes(curvatures: Floats, cross_slopes: Floats, has_slopes: bool) -> tuple[Floats, Floats]:
    """Banking and crown: as the map has them, or as roads usually are."""
    if has_slopes:
        return -cross_slopes, np.zeros_like(cross_slopes)
    banking = np.minimum(np.maximum(BANKING_M * curvatures, -MAX_BANKING), MAX_BANKING)
    return banking, np.maximum(CROWN - np.abs(banking), 0.0)
