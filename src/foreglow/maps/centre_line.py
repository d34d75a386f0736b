"""A road of a map, and the road ahead of a vehicle on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from foreglow.geometry import Floats, Pose
from foreglow.numbers import checked_floats, checked_number
from foreglow.types import RoadAhead
from foreglow.types.arrays import check_kind

MAX_OFFSET_M = 20.0
"""We do not drive on a road whose centre line is horizontally further away than this."""

MAX_HEIGHT_OFFSET_M = 5.0
"""Nor on a road that is further above or below us: at a bridge the two roads are about this far apart."""

MIN_ALONG = 0.5
"""Nor on a road across our way: cosine of the largest angle between our heading and the road's, 60 degrees."""

STEP_M = 1.0

MAX_LINE_M = 100_000.0
"""The longest road of a map: a longer one has a number or a node that is wrong."""

MAX_POINTS = 2_000_000
"""Points of a map, one a metre, which take 40 bytes each: 2,000 km of road."""

MAX_WIDTH_M = 200.0
"""The widest carriageway of a map: a square, or the booths of a toll road."""

MAX_COORDINATE_M = 1e8
"""The largest x and y of a map in metres; projections of the earth have up to 2e7."""

MAX_HEIGHT_M = 10_000.0
"""The largest height of a road, above or below zero."""

MAX_STEP_M = 5.0
"""Points that follow each other differ in height by at most their distance and this: a missing height may be written as
0 or -9999."""

_AXLES_M = 1.4
"""Half the distance between the axles, between which the slope under the vehicle is measured."""


@dataclass(frozen=True, slots=True)
class Foot:
    """The point of a road that is nearest to a vehicle.

    Attributes:
        distance_m: Horizontal distance of the vehicle from it.
        way_m: Along the centre line from its first point.
        is_against: Whether the vehicle drives towards the first point.
    """

    distance_m: float
    way_m: float
    is_against: bool


@dataclass(frozen=True, eq=False)
class CentreLine:
    """The centre line of a carriageway, straight between its points; it can be driven in either direction.

    Attributes:
        points_m: Shape (N, 3), N >= 2, in the map's frame: x east, y north, z up, metres, without neighbours
            at the same horizontal position.
        half_width_m: From the centre line to either edge.
        cross_slopes: Shape (N,), rise for each metre to the left as the points run; an empty array becomes zeros.

    Raises:
        ValueError: If a shape is wrong, a number is not finite, or two neighbours are the same.
    """

    points_m: Floats
    half_width_m: float
    cross_slopes: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        points = checked_floats("CentreLine.points_m", self.points_m)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise ValueError(f"CentreLine.points_m: expected shape (N, 3) with N >= 2, got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("CentreLine.points_m: expected finite numbers, got NaN or infinity")
        if not np.diff(points[:, :2], axis=0).any(axis=1).all():
            raise ValueError("CentreLine.points_m: expected neighbours that differ horizontally")
        half_width_m = checked_number("CentreLine.half_width_m", self.half_width_m)
        if not 0.0 < half_width_m < math.inf:
            raise ValueError(f"CentreLine.half_width_m: expected a positive number, got {half_width_m}")
        slopes = (
            checked_floats("CentreLine.cross_slopes", self.cross_slopes)
            if np.size(self.cross_slopes)
            else np.zeros(len(points))
        )
        if slopes.shape != (len(points),) or not np.isfinite(slopes).all():
            raise ValueError(f"CentreLine.cross_slopes: expected {len(points)} finite numbers, got {slopes.shape}")
        object.__setattr__(self, "points_m", points)
        object.__setattr__(self, "half_width_m", half_width_m)
        object.__setattr__(self, "cross_slopes", slopes)

    @cached_property
    def ways_m(self) -> Floats:
        """Horizontal distance of each point from the first along the line, shape (N,)."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points_m[:, :2], axis=0), axis=1))])

    @property
    def length_m(self) -> float:
        """Horizontal length."""
        return float(self.ways_m[-1])

    def reversed(self) -> CentreLine:
        """The same road in the other direction."""
        return CentreLine(self.points_m[::-1], self.half_width_m, -self.cross_slopes[::-1])

    def at(self, ways_m: Floats) -> Floats:
        """Points, shape (..., 3), at distances along the line, shape (...); beyond an end, that end."""
        return np.stack([np.interp(ways_m, self.ways_m, values) for values in self.points_m.T], -1)

    def foot(self, pose: Pose, *, knows_height: bool = True, knows_heading: bool = True) -> Foot | None:
        """The nearest point of the road to a vehicle that drives on it; None if it does not.

        Args:
            pose: map_from_vehicle.
            knows_height: Whether the heights of pose and map can be compared.
            knows_heading: Whether a road across our way is none of ours.

        Raises:
            ValueError: If the pose is none.
        """
        check_kind("pose", pose, Pose)
        starts, steps = self.points_m[:-1], np.diff(self.points_m, axis=0)
        lengths_m = np.linalg.norm(steps[:, :2], axis=1)
        shares = ((pose.position_m - starts)[:, :2] * steps[:, :2]).sum(-1) / lengths_m**2
        shares = np.clip(shares, 0.0, 1.0)
        away = starts + shares[:, None] * steps - pose.position_m
        distances_m = np.hypot(away[:, 0], away[:, 1])
        forward = pose.rotation[:2, 0]
        along = steps[:, :2] @ forward / (lengths_m * max(float(np.hypot(*forward)), 1e-12))
        is_ours = distances_m <= MAX_OFFSET_M
        if knows_heading:
            is_ours &= np.abs(along) >= MIN_ALONG
        if knows_height:
            is_ours &= np.abs(away[:, 2]) <= MAX_HEIGHT_OFFSET_M
        if not is_ours.any():
            return None
        nearest = int(np.argmin(np.where(is_ours, distances_m, np.inf)))
        way_m = self.ways_m[nearest] + shares[nearest] * lengths_m[nearest]
        return Foot(float(distances_m[nearest]), float(way_m), bool(along[nearest] < 0))

    def ahead(
        self, pose: Pose, length_m: float = 400.0, error_bound_m: float = math.inf, *, is_on_road: bool = False
    ) -> RoadAhead | None:
        """The road ahead of a vehicle, from the point beside it on, a point each metre, in the vehicle's frame.

        None if the road is not near, runs across our way, or ends here.

        Args:
            pose: map_from_vehicle.
            length_m: Length; the road may end earlier.
            error_bound_m: Largest error of the position along the road; infinite where unknown.
            is_on_road: Whether to put the vehicle on the road: height, pitch and roll come from the map, not from
                `pose`. For poses or maps without heights.

        Raises:
            ValueError: If the pose is none, the length is not positive, or the bound is negative or NaN.
        """
        length_m, error_bound_m = checked_ahead(length_m, error_bound_m)
        foot = self.foot(pose, knows_height=not is_on_road)
        if foot is None:
            return None
        line, way_m = (self.reversed(), self.length_m - foot.way_m) if foot.is_against else (self, foot.way_m)
        ways_m = np.arange(way_m, min(way_m + length_m, line.length_m) + 1e-9, STEP_M)
        if len(ways_m) < 2:
            return None
        stands = line.standing(pose, way_m) if is_on_road else pose
        slopes = np.interp(ways_m, line.ways_m, line.cross_slopes)
        return RoadAhead(stands.to_body(line.at(ways_m)), self.half_width_m, slopes, error_bound_m)

    def standing(self, pose: Pose, way_m: float) -> Pose:
        """`pose` with the height, pitch and roll of a vehicle on the road, beside the point at `way_m`."""
        behind, beside, before = self.at(np.array([way_m - _AXLES_M, way_m, way_m + _AXLES_M]))
        step = before - behind
        along = step[:2] / np.hypot(step[0], step[1])
        cross_slope = float(np.interp(way_m, self.ways_m, self.cross_slopes))
        # Rise for each metre east and north of the plane that touches the road here.
        gradient = step[2] / np.hypot(step[0], step[1]) * along + cross_slope * np.array([-along[1], along[0]])
        position_m = pose.position_m.copy()
        position_m[2] = beside[2] + gradient @ (position_m - beside)[:2]
        heading = pose.rotation[:2, 0] / np.hypot(*pose.rotation[:2, 0])
        forward = np.array([*heading, gradient @ heading])
        forward /= np.linalg.norm(forward)
        up = np.array([*-gradient, 1.0]) / np.sqrt(1.0 + gradient @ gradient)
        return Pose(position_m, np.stack([forward, np.cross(up, forward), up], -1))


def checked_ahead(length_m: object, error_bound_m: object) -> tuple[float, float]:
    """How far to look ahead, and the largest error of the position there, as plain numbers.

    Raises:
        ValueError: If the length is not positive, or the bound is negative or NaN.
    """
    length, bound = checked_number("length_m", length_m), checked_number("error_bound_m", error_bound_m)
    if not length > 0.0:
        raise ValueError(f"length_m: expected a positive number, got {length}")
    if not bound >= 0.0:
        raise ValueError(f"error_bound_m: expected a number of at least 0, got {bound}")
    return length, bound


class PointCount:
    """Counts the points of a map's lines, before they are made."""

    def __init__(self) -> None:
        self._num = 0

    def add(self, length_m: float, origin: str, num_given: int = 0) -> None:
        """Adds a line with a point each metre, or of `num_given` points if those are more.

        Raises:
            ValueError: If it is longer than `MAX_LINE_M`, or the map has more than `MAX_POINTS`; the message begins
                with `origin`.
        """
        check_length(length_m, origin)
        self._num += max(num_given, 2 + math.ceil(length_m / STEP_M))
        if self._num > MAX_POINTS:
            raise ValueError(f"{origin}: expected a map of at most {MAX_POINTS} points, one a metre, got more")


def check_length(length_m: float, origin: str) -> None:
    """Passes the length of a road.

    Raises:
        ValueError: If it is longer than `MAX_LINE_M`, or NaN; the message begins with `origin`.
    """
    if not length_m <= MAX_LINE_M:
        raise ValueError(f"{origin}: length: expected at most {MAX_LINE_M:g} m, got {length_m:g}")


def check_width(width_m: float, origin: str, most_m: float = MAX_WIDTH_M) -> None:
    """Passes the width of a carriageway.

    Raises:
        ValueError: If it is not positive, above `most_m`, or NaN; the message begins with `origin`.
    """
    if not 0 < width_m <= most_m:
        raise ValueError(f"{origin}: expected a width above 0 and up to {most_m:g} m, got {width_m:g}")


def check_points(points_m: Floats, origin: str) -> None:
    """Passes points, shape (N, 2) or (N, 3).

    Raises:
        ValueError: If one lies beyond any map, or is NaN; the message begins with `origin`.
    """
    sizes_m = np.abs(points_m)
    if not (sizes_m[:, :2] <= MAX_COORDINATE_M).all():
        worst_m = float(sizes_m[:, :2].max())
        raise ValueError(f"{origin}: x, y: expected up to {MAX_COORDINATE_M:g} m from the origin, got {worst_m:g}")
    if not (sizes_m[:, 2:] <= MAX_HEIGHT_M).all():
        worst_m = float(sizes_m[:, 2:].max())
        raise ValueError(f"{origin}: height: expected up to {MAX_HEIGHT_M:g} m above or below zero, got {worst_m:g}")


def check_steps(points_m: Floats, origin: str, names: Sequence[str] = ()) -> None:
    """Passes points of a line along a road, shape (N, 3), that follow each other.

    Args:
        points_m: The points; heights may be NaN.
        origin: Begins the message.
        names: What the points are called in the message; by default they are numbered.

    Raises:
        ValueError: If a height differs from the next as on no road.
    """
    steps_m = np.abs(np.diff(points_m, axis=0))
    is_steep = steps_m[:, 2] > np.hypot(steps_m[:, 0], steps_m[:, 1]) + MAX_STEP_M  # never for NaN
    if is_steep.any():
        first = int(is_steep.argmax())
        before, after = (names or range(len(points_m)))[first : first + 2]
        raise ValueError(
            f"{origin}: expected heights that differ by at most {MAX_STEP_M:g} m and the distance of the points, got "
            f"{points_m[first, 2]:g} m and {points_m[first + 1, 2]:g} m of points {before} and {after}"
        )


def without_repeats(points_m: Floats) -> Floats:
    """`points_m` without points that are horizontally within a millimetre of the point before."""
    steps_m = np.linalg.norm(np.diff(points_m[:, :2], axis=0), axis=1)
    return np.asarray(points_m[np.concatenate([[True], steps_m > 1e-3])])
