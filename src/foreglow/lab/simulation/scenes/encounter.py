"""Estimates of when two vehicles come into sight of each other, for planning; the renderer decides what is seen."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.surroundings import Profile, SurroundingsSpec
from foreglow.lab.simulation.world.road import Road

EYE_M, LAMP_M = 1.25, 0.65
"""Heights of the camera and of the other car's lamps above the road."""

BLOCKING_HEIGHT_M = 1.2
"""A bank or a wall of at least this height hides a car behind it."""

LIT_AHEAD_M = (20.0, 50.0, 90.0, 130.0)
"""Distances ahead of a car at which its low beam lights a rail or a bank well enough to be noticed."""

SHARES = np.linspace(0.02, 0.98, 32)[:, None]
"""Where a line of sight is looked at, as shares of its length."""
CENTRE_STEP_M = 3.0
TIME_STEP_S = 0.2


@dataclass(frozen=True, slots=True)
class Corridor:
    """Width of the open space to the left and to the right of the centre line, metres."""

    left_m: float
    right_m: float


def corridor(surroundings: SurroundingsSpec, half_width_m: float) -> Corridor:
    """The open space along the road, up to the nearest bank, wall or wood on either side."""
    limits = {"left": 60.0, "right": 60.0}
    for side, verge in (("left", surroundings.left), ("right", surroundings.right)):
        if verge.bank_m >= BLOCKING_HEIGHT_M:
            limits[side] = verge.bank_offset_m + 3.0
    for wall in surroundings.walls:
        if wall.height_m >= BLOCKING_HEIGHT_M:
            limits[wall.side] = min(limits[wall.side], wall.offset_m)
    for woods in surroundings.woods:
        if woods.depth_m > 5.0:
            limits[woods.side] = min(limits[woods.side], woods.offset_m + (1.0 if woods.has_undergrowth else 6.0))
    return Corridor(half_width_m + limits["left"], half_width_m + limits["right"])


def is_in_sight(road: Road, ego_s_m: float, other_s_m: float, free: Corridor) -> bool:
    """Whether an oncoming car at `other_s_m` can be seen from our position at `ego_s_m`."""
    if other_s_m <= ego_s_m + 1.0:
        return True
    lane = road.half_width_m / 2
    eye, lamp = road.points([ego_s_m, other_s_m], [-lane, lane], [EYE_M, LAMP_M])
    return _is_free(road, (ego_s_m, other_s_m), eye, lamp, free)


def is_light_in_sight(road: Road, ego_s_m: float, other_s_m: float, free: Corridor) -> bool:
    """Whether a surface straight ahead of an oncoming car at `other_s_m`, lit by it, can be seen from `ego_s_m`."""
    if other_s_m <= ego_s_m + 1.0:
        return True
    lane = road.half_width_m / 2
    eye, lamp, behind = road.points([ego_s_m, other_s_m, other_s_m + 1.0], [-lane, lane, lane], [EYE_M, LAMP_M, LAMP_M])
    for ahead_m in LIT_AHEAD_M:
        if _is_free(road, (ego_s_m, other_s_m), eye, lamp + ahead_m * (lamp - behind), free):
            return True
    return False


def sight_time_s(
    road: Road, free: Corridor, ego: Profile, other: Profile, is_seen: Callable[..., bool] = is_in_sight
) -> float:
    """Time before the meeting, in s, during which the two see each other without a break; 0 if only at the meeting.

    Args:
        road: The road.
        free: The open space along it.
        ego: Two points (time, arc length) of our time table, at constant speed.
        other: The same for the oncoming car.
        is_seen: Whether the car, or its light, is in sight.
    """
    ego_speed, other_speed = (_speed(profile) for profile in (ego, other))
    meeting = (other[0][1] - ego[0][1]) / (ego_speed - other_speed)
    seen = 0.0
    while seen < meeting:
        time = meeting - seen - TIME_STEP_S
        if not is_seen(road, ego[0][1] + ego_speed * time, other[0][1] + other_speed * time, free):
            break
        seen += TIME_STEP_S
    return min(seen, meeting)


def _is_free(road: Road, between_m: tuple[float, float], eye: Floats, target: Floats, free: Corridor) -> bool:
    """Whether the line from `eye` to `target` stays above the road and within the corridor along it."""
    line = eye + SHARES * (target - eye)
    arc_lengths, points, headings = _centre_line(road)
    part = slice(*np.searchsorted(arc_lengths, (between_m[0] - CENTRE_STEP_M, between_m[1] + CENTRE_STEP_M)))
    centre = points[part]
    squares = (line[:, None, 0] - centre[:, 0]) ** 2 + (line[:, None, 1] - centre[:, 1]) ** 2
    nearest = squares.argmin(axis=1)
    heading = headings[part][nearest]
    away = line[:, :2] - centre[nearest, :2]
    t = -np.sin(heading) * away[:, 0] + np.cos(heading) * away[:, 1]
    is_free = (t < free.left_m) & (t > -free.right_m) & (line[:, 2] > centre[nearest, 2] + 0.05)
    return bool(is_free.all())


@functools.lru_cache(maxsize=2)
def _centre_line(road: Road) -> tuple[Floats, Floats, Floats]:
    """Arc lengths every few metres, also beyond the road's ends, with points and headings."""
    arc_lengths = np.arange(-100.0, road.length_m + 100.0, CENTRE_STEP_M)
    return arc_lengths, road.points(arc_lengths), road.heading_rad(arc_lengths)


def _speed(timetable: Profile) -> float:
    (first_s, first_m), (last_s, last_m) = timetable[0], timetable[-1]
    return (last_m - first_m) / (last_s - first_s)
