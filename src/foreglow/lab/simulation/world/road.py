"""A road: its course, from profiles of curvature and elevation to points in the world, and the lines on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial import cKDTree

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.scenes.surroundings import Profile

NARROW_M = 0.15
"""Width of the lines between lanes, and at the edges in towns."""

MOTORWAY_DASH_M, MOTORWAY_PERIOD_M = 6.0, 18.0
TOWN_DASH_M, TOWN_PERIOD_M = 3.0, 9.0
"""Dashes and their periods between the lanes of motorways and town streets. Source: German guidelines RMS-1, 1993."""

BESIDE_MIDDLE_M = 0.12
"""Distance from the centre line to each of the two lines between the directions, where there is no median."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line on either side of the road.

    Attributes:
        offset_m: From the centre line of the road to the middle of the line.
        width_m: Width of the line.
        dash_m: Length of a dash; equal to the period for a solid line.
        period_m: From the begin of a dash to the begin of the next.
    """

    offset_m: float
    width_m: float
    dash_m: float
    period_m: float


def has_several_lanes(road: RoadSpec) -> bool:
    """Whether the road needs `lane_lines`, and not just the centre and edge lines of a two-lane road."""
    return road.num_lanes > 1 or road.median_m > 0


def lane_lines(road: RoadSpec) -> tuple[Line, ...]:
    """The lines on either half of the road, from the middle outwards.

    >>> road = RoadSpec(num_lanes=2, lane_width_m=3.5, median_m=3, shoulders_m=(0.5, 2))
    >>> [line.offset_m for line in lane_lines(road)]
    [1.75, 5.5, 9.25]
    """
    is_motorway = road.median_m > 0
    edge_m = road.edge_line_m if is_motorway else NARROW_M
    dash_m, period_m = (MOTORWAY_DASH_M, MOTORWAY_PERIOD_M) if is_motorway else (TOWN_DASH_M, TOWN_PERIOD_M)
    first_m = road.median_m / 2 + road.shoulders_m[0]
    inner_m = first_m - edge_m / 2 - 0.1 if is_motorway else BESIDE_MIDDLE_M
    last_m = first_m + road.num_lanes * road.lane_width_m
    lines = [Line(inner_m, edge_m if is_motorway else NARROW_M, period_m, period_m)]
    lines += [
        Line(first_m + number * road.lane_width_m, NARROW_M, dash_m, period_m) for number in range(1, road.num_lanes)
    ]
    if road.has_edge_marking:
        beside_m = 0.1 if road.shoulders_m[1] >= edge_m + 0.1 else -edge_m - 0.1
        lines.append(Line(last_m + beside_m + edge_m / 2, edge_m, period_m, period_m))
    return tuple(lines)


STEP_M = 0.25
"""Step of the integration of the heading; the error for a radius of 20 m over 500 m is below a millimetre."""

MAX_SUPERELEVATION = 0.06
CROWN = 0.02
"""Cross slope of either lane away from the centre line, on a straight road."""

RUN_OUT_M = 20.0
"""Length over which a bend becomes straight before and after the road."""

NUM_FOOT_STEPS = 4
STEP_LIMIT_M = 200.0

MOUTH_M = 25.0
"""Length over which a side road levels out from the slope at which it leaves the main road."""


class Road:
    """A centre line with heading, slope and banking, and the carriageway across it.

    It starts at (0, 0), heading along x unless `start` says otherwise, and becomes straight beyond its ends.
    """

    def __init__(self, spec: RoadSpec, start: Pose | None = None, length_m: float | None = None) -> None:
        """Integrates the profiles of `spec`, except its branches."""
        self.spec = spec
        self.length_m = spec.length_m if length_m is None else length_m
        self.half_width_m = spec.half_width_m
        self._start = start or Pose(np.zeros(3), np.eye(3))
        arc_lengths = np.arange(-100.0, self.length_m + 100.0 + STEP_M / 2, STEP_M)
        curvatures = np.interp(arc_lengths, *np.array(spec.curvature_per_m, np.float64).T)
        curvatures *= np.clip(1.0 + np.minimum(arc_lengths, self.length_m - arc_lengths) / RUN_OUT_M, 0.0, 1.0)
        heading = _integral(curvatures, STEP_M)
        zero = int(np.searchsorted(arc_lengths, 0.0))
        heading -= heading[zero]
        x, y = _integral(np.cos(heading), STEP_M), _integral(np.sin(heading), STEP_M)
        self._line = CubicSpline(arc_lengths, np.stack([x - x[zero], y - y[zero], heading], -1))
        self._curvatures = arc_lengths, curvatures

    def curvature_per_m(self, s_m: ArrayLike) -> Floats:
        """Signed curvature at arc lengths of any shape, positive to the left, 1/m."""
        # A spline would oscillate where the profile has steps or kinks.
        return np.asarray(np.interp(np.asarray(s_m, np.float64), *self._curvatures))

    def heading_rad(self, s_m: ArrayLike) -> Floats:
        """Direction of the centre line, radians to the left of the world's x."""
        start = np.arctan2(self._start.rotation[1, 0], self._start.rotation[0, 0])
        return np.asarray(self._line(np.asarray(s_m, np.float64))[..., 2] + start)

    def elevation_m(self, s_m: ArrayLike) -> Floats:
        """Height of the centre line in the world; constant slope beyond the profile's ends."""
        return np.asarray(self._elevation(np.asarray(s_m, np.float64)) + self._start.position_m[2])

    def slope(self, s_m: ArrayLike) -> Floats:
        """Rise per metre along the centre line, no unit."""
        s = np.asarray(s_m, np.float64)
        return np.asarray((self._elevation(s + 0.5) - self._elevation(s - 0.5)) / 1.0)

    def cross_height_m(self, s_m: ArrayLike, t_m: ArrayLike) -> Floats:
        """Height of the carriageway above its centre line at offset t: crown on straights, banking in bends.

        Beyond the edges, it is the height of the edge.
        """
        t = np.clip(np.asarray(t_m, np.float64), -self.half_width_m, self.half_width_m)
        bank = np.clip(
            self.spec.superelevation * 100.0 * self.curvature_per_m(s_m), -MAX_SUPERELEVATION, MAX_SUPERELEVATION
        )
        # The crown disappears as the banking becomes as steep.
        crown = np.maximum(CROWN - np.abs(bank), 0.0)
        return np.asarray(-bank * t - crown * np.abs(t))

    def points(self, s_m: ArrayLike, t_m: ArrayLike = 0.0, height_m: ArrayLike = 0.0) -> Floats:
        """Points in the world, shape (..., 3), at arc length s, offset t, and `height_m` above the carriageway."""
        s, t, height = np.broadcast_arrays(*(np.asarray(values, np.float64) for values in (s_m, t_m, height_m)))
        line = self._line(s)
        x, y = line[..., 0] - np.sin(line[..., 2]) * t, line[..., 1] + np.cos(line[..., 2]) * t
        flat = np.stack([x, y, np.zeros_like(x)], -1) @ self._start.rotation.T
        flat[..., :2] += self._start.position_m[:2]
        flat[..., 2] = self.elevation_m(s) + self.cross_height_m(s, t) + height
        return np.asarray(flat)

    def places_m(self, points_world: ArrayLike) -> tuple[Floats, Floats]:
        """Arc length and offset to the left, each of shape (...), of points of shape (..., 2 or 3).

        The inverse of `points`: by the nearest foot of a perpendicular, ignoring heights.
        """
        points = np.asarray(points_world, np.float64)[..., :2]
        samples, tree = self._samples
        s = samples[tree.query(points)[1]]
        for _ in range(NUM_FOOT_STEPS):
            away = points - self.points(s)[..., :2]
            heading = self.heading_rad(s)
            along = away[..., 0] * np.cos(heading) + away[..., 1] * np.sin(heading)
            t = away[..., 1] * np.cos(heading) - away[..., 0] * np.sin(heading)
            # From the centre of a bend, every point of it is equally near, and the step would be unlimited.
            s = s + np.clip(along / np.maximum(1.0 - self.curvature_per_m(s) * t, 0.1), -STEP_LIMIT_M, STEP_LIMIT_M)
        return s, np.asarray(t)

    def distances_m(self, points_world: ArrayLike) -> Floats:
        """Horizontal distances, shape (...), of points of shape (..., 2 or 3) from the centre line, within 0.2 m."""
        return np.asarray(self._samples[1].query(np.asarray(points_world, np.float64)[..., :2])[0])

    def pose(self, s_m: float, t_m: float, direction: int, wheelbase_m: float) -> Pose:
        """Pose of a vehicle whose rear axle is at s, driving along the road (direction 1) or against it (-1)."""
        rear = self.points(s_m, t_m)
        front = self.points(s_m + direction * wheelbase_m, t_m)
        ahead = front - rear
        left = self.points(s_m, t_m + 0.75 * direction) - self.points(s_m, t_m - 0.75 * direction)
        return Pose(
            rear,
            rotation(
                float(np.arctan2(ahead[1], ahead[0])),
                float(np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))),
                float(np.arctan2(left[2], np.hypot(left[0], left[1]))),
            ),
        )

    @cached_property
    def _samples(self) -> tuple[Floats, cKDTree]:
        arc_lengths = np.arange(-100.0, self.length_m + 100.5)
        return arc_lengths, cKDTree(self.points(arc_lengths)[:, :2])

    @cached_property
    def _elevation(self) -> CubicSpline | PchipInterpolator:
        profile = np.array(self.spec.elevation_m, np.float64)
        if len(profile) == 1:
            return PchipInterpolator([-1e4, 1e4], [profile[0, 1]] * 2)
        slopes = (
            (profile[1, 1] - profile[0, 1]) / (profile[1, 0] - profile[0, 0]),
            (profile[-1, 1] - profile[-2, 1]) / (profile[-1, 0] - profile[-2, 0]),
        )
        ends = [
            [profile[0, 0] - 1e4, profile[0, 1] - 1e4 * slopes[0]],
            *profile,
            [profile[-1, 0] + 1e4, profile[-1, 1] + 1e4 * slopes[1]],
        ]
        # Monotone between the points, so that a crest is exactly as high as specified.
        return PchipInterpolator(*np.array(ends).T)


def branch_road(main: Road, number: int) -> Road:
    """The side road `number` of the main road, with s = 0 where the centre lines meet.

    It leaves in the plane of the main carriageway and then becomes level.
    """
    branch = main.spec.branches[number]
    angle = np.radians(branch.angle_deg)
    # Where it crosses the main road's edge; a side road parallel to the main road never would.
    mouth = main.half_width_m / max(abs(float(np.sin(angle))), 0.2)
    edge = main.points(branch.s_m + mouth * np.cos(angle), np.sign(np.sin(angle)) * main.half_width_m)
    start = Pose(main.points(branch.s_m), rotation(float(main.heading_rad(branch.s_m) + angle)))
    rise = float(edge[2] - start.position_m[2])
    level = rise + 0.5 * float(np.clip(rise / mouth, -0.08, 0.08)) * MOUTH_M
    profile = ((0.0, 0.0), (mouth, rise), (mouth + MOUTH_M, level), (mouth + 2 * MOUTH_M, level))
    spec = main.spec.model_copy(
        update={
            "curvature_per_m": ((0.0, 0.0),),
            "elevation_m": profile,
            "branches": (),
            "num_lanes": 1,
            "median": "none",
            "median_m": 0.0,
            "shoulders_m": (0.0, 0.0),
            "centre_marking": "none",
            "has_edge_marking": False,
        }
    )
    return Road(spec, start, branch.length_m)


def interpolated(profile: Profile, times_s: ArrayLike) -> tuple[Floats, Floats]:
    """Arc length in m and speed in m/s at `times_s`, from a time table; constant speed beyond its ends."""
    times = np.asarray(times_s, np.float64)
    table = np.array(profile, np.float64)
    if len(table) == 1:
        return np.full(times.shape, table[0, 1]), np.zeros(times.shape)
    curve = PchipInterpolator(table[:, 0], table[:, 1])
    rate = curve.derivative()
    inside = np.clip(times, table[0, 0], table[-1, 0])
    speeds = rate(inside)
    return np.asarray(curve(inside) + speeds * (times - inside)), np.asarray(speeds)


def _integral(values: Floats, step: float) -> Floats:
    """Running integral by the trapezoidal rule, 0 at the first value."""
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) * (step / 2))])
