"""Drawing a scene: an encounter with time and place, and everything around it.

The course of the road, the land beside it and the speeds are drawn first. The oncoming car's time table is then chosen
so that the car comes into sight a few seconds into the drive, as in PVDN: a typical sequence shows three seconds of
empty road, almost a second of indirect light, and then the car until it passes.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.courses import Course, Layout
from foreglow.lab.simulation.scenes.draw import Draw, draw_camera, draw_sensor, draw_weather
from foreglow.lab.simulation.scenes.roadside import draw_surroundings
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, Scene, VehicleSpec
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
    return next(are_in_sight(road, np.array([ego_s_m]), np.array([other_s_m]), free))


def are_in_sight(road: Road, ego_s_m: Floats, other_s_m: Floats, free: Corridor) -> Iterator[bool]:
    """`is_in_sight` for one pair of positions after the other."""
    lane = road.half_width_m / 2
    eyes, lamps = road.points(ego_s_m, -lane, EYE_M), road.points(other_s_m, lane, LAMP_M)
    for ego, other, eye, lamp in zip(ego_s_m.tolist(), other_s_m.tolist(), eyes, lamps, strict=True):
        yield other <= ego + 1.0 or _is_free(road, (ego, other), eye, lamp, free)


def are_lights_in_sight(road: Road, ego_s_m: Floats, other_s_m: Floats, free: Corridor) -> Iterator[bool]:
    """Whether a surface straight ahead of an oncoming car, lit by it, is in sight, for one pair after the other."""
    lane = road.half_width_m / 2
    eyes = road.points(ego_s_m, -lane, EYE_M)
    lamps, behind = road.points(other_s_m, lane, LAMP_M), road.points(other_s_m + 1.0, lane, LAMP_M)
    pairs = zip(ego_s_m.tolist(), other_s_m.tolist(), eyes, lamps, lamps - behind, strict=True)
    for ego, other, eye, lamp, ahead in pairs:
        yield other <= ego + 1.0 or any(
            _is_free(road, (ego, other), eye, lamp + ahead_m * ahead, free) for ahead_m in LIT_AHEAD_M
        )


def sight_time_s(
    road: Road, free: Corridor, ego: Profile, other: Profile, are_seen: Callable[..., Iterator[bool]] = are_in_sight
) -> float:
    """Time before the meeting, in s, during which the two see each other without a break; 0 if only at the meeting.

    Args:
        road: The road.
        free: The open space along it.
        ego: Two points (time, arc length) of our time table, at constant speed.
        other: The same for the oncoming car.
        are_seen: Whether the car, or its light, is in sight, for pairs of positions.
    """
    ego_speed, other_speed = (_speed(profile) for profile in (ego, other))
    meeting = (other[0][1] - ego[0][1]) / (ego_speed - other_speed)
    seen = np.cumsum(np.full(max(math.ceil(meeting / TIME_STEP_S) + 1, 1), TIME_STEP_S))  # as long as each is seen
    before = np.concatenate([[0.0], seen[:-1]])
    times = (meeting - before - TIME_STEP_S)[before < meeting]
    found = are_seen(road, ego[0][1] + ego_speed * times, other[0][1] + other_speed * times, free)
    num = sum(1 for _ in itertools.takewhile(bool, found))
    return min(float(seen[num - 1]), meeting) if num else min(0.0, meeting)


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


class Timing(NamedTuple):
    """When things happen in a drive.

    Attributes:
        sight_s: Mean and standard deviation of the time at which the oncoming car comes into sight; by default similar
            to PVDN's night validation split, whose median is 3.6 s.
        meeting_s: Bounds of the time of the meeting.
        after_s: Bounds of the time from there to the end of the drive.
        least_s: Shortest drive.
    """

    sight_s: tuple[float, float] = (3.6, 0.8)
    meeting_s: tuple[float, float] = (6.5, 9.5)
    after_s: tuple[float, float] = (-0.3, 1.2)
    least_s: float = 6.0


AS_IN_PVDN = Timing()

LONG = Timing(sight_s=(8.0, 1.0), meeting_s=(11.0, 16.0), after_s=(5.0, 6.0), least_s=20.0)
"""Drives with time before the meeting and after it, for closed loops."""

LONGEST_MISS_S, LONGEST_LEAD_S = 1.5, 0.9
"""An encounter is drawn again if the car comes into sight at a time that is further from the wanted one, or if its
light precedes it by more; in PVDN, light precedes the car by 0.6 to 1.5 s (quartiles)."""

MAX_PLANS = 12


@dataclass(frozen=True, slots=True)
class Plan:
    """An encounter.

    Attributes:
        course: Course of the road.
        road: The road.
        surroundings: What stands beside it.
        ego: Our time table.
        other: The oncoming car's time table.
        meeting_s: Time of the meeting.
        miss_s: Difference between the time at which the other car comes into sight and the wanted time.
        lead_s: Time by which the car's light should be seen before the car.
    """

    course: Course
    road: RoadSpec
    surroundings: SurroundingsSpec
    ego: Profile
    other: Profile
    meeting_s: float
    miss_s: float
    lead_s: float

    @property
    def is_good(self) -> bool:
        """Whether it resembles a drive of PVDN."""
        return self.miss_s <= LONGEST_MISS_S and self.lead_s <= LONGEST_LEAD_S


def planned_scene(draw: Draw, name: str, layout: Layout, seed: int, timing: Timing = AS_IN_PVDN) -> Scene:
    """Draws everything in a scene; the encounter is drawn again until it resembles those of PVDN."""
    weather, wetness = draw_weather(draw)
    plans: list[Plan] = []
    while len(plans) < MAX_PLANS and not (plans and plans[-1].is_good):
        plans.append(plan_encounter(draw, layout, wetness, timing))
    plan = plans[-1] if plans[-1].is_good else min(plans, key=lambda plan: plan.miss_s + plan.lead_s)
    duration_s = plan.meeting_s + draw.uniform(*timing.after_s)
    return Scene(
        name=name,
        seed=seed,
        duration_s=round(max(duration_s, timing.least_s), 2),
        road=plan.road,
        surroundings=plan.surroundings,
        vehicles=_vehicles(draw, plan.course, plan.other, plan.ego),
        ego=EgoSpec(
            timetable=plan.ego,
            brightness=draw.log_uniform(0.5, 1.25),
            yaw_aim_deg=draw.normal(0.0, 0.4),
            pitch_aim_deg=draw.normal(-0.1, 0.3),
            body_motion=draw.log_uniform(0.5, 2.0),
        ),
        weather=weather,
        camera=draw_camera(draw),
        sensor=draw_sensor(draw),
    )


def plan_encounter(draw: Draw, layout: Layout, wetness: float, timing: Timing = AS_IN_PVDN) -> Plan:
    """Draws a road with its roadside, and times the encounter."""
    sight_s = draw.normal(*timing.sight_s)
    start_m = draw.uniform(10.0, 25.0)
    cruising_mps = draw.uniform(15.0, 25.0)
    focus_m = start_m + cruising_mps * sight_s + draw.uniform(50.0, 170.0)
    course = layout(draw, focus_m)
    ego_mps = _speed_mps(draw, course, cruising_mps)
    other_mps = _speed_mps(draw, course, draw.uniform(15.0, 27.0))
    length_m = float(round(start_m + (ego_mps + other_mps) * timing.meeting_s[1] + 60.0))
    spec = draw_road(draw, course, length_m, wetness)
    surroundings = draw_surroundings(draw, course.style, length_m, course.bends)
    ego = ((0.0, start_m), (10.0, round(start_m + 10.0 * ego_mps, 2)))
    road, free = Road(spec), corridor(surroundings, spec.lane_width_m)
    other, meeting_s = _encounter(road, free, ego, other_mps, sight_s, timing)
    seen_s = sight_time_s(road, free, ego, other)
    light_s = sight_time_s(road, free, ego, other, are_lights_in_sight)
    miss_s = abs(meeting_s - seen_s - sight_s)
    return Plan(course, spec, surroundings, ego, other, meeting_s, miss_s, light_s - seen_s)


def _encounter(
    road: Road, free: Corridor, ego: Profile, other_mps: float, sight_s: float, timing: Timing
) -> tuple[Profile, float]:
    """The time table with which the oncoming car comes into sight closest to `sight_s`, and the time of the meeting."""
    ego_mps = (ego[1][1] - ego[0][1]) / (ego[1][0] - ego[0][0])
    best: tuple[float, Profile, float] | None = None
    for meeting_s in np.arange(max(sight_s + 2.0, timing.meeting_s[0]), timing.meeting_s[1] + 0.01, 0.5):
        meeting_m = ego[0][1] + ego_mps * meeting_s
        begin_m = round(float(meeting_m + other_mps * meeting_s), 2)
        other = ((0.0, begin_m), (10.0, round(begin_m - 10.0 * other_mps, 2)))
        miss_s = abs(meeting_s - sight_time_s(road, free, ego, other) - sight_s)
        if best is None or miss_s < best[0]:
            best = (miss_s, other, float(meeting_s))
    assert best is not None
    return best[1], best[2]


def _vehicles(draw: Draw, course: Course, other: Profile, ego: Profile) -> tuple[VehicleSpec, ...]:
    """The oncoming car and other vehicles; one drive in eight has none at all."""
    if draw.chance(0.12):
        return ()
    vehicles = [draw_vehicle(draw, timetable=other)]
    behind_m = 0.0
    while draw.chance(0.12):  # several in a row
        behind_m += draw.uniform(12.0, 45.0)
        vehicles.append(draw_vehicle(draw, timetable=shifted(other, behind_m)))
    if draw.chance(0.07):
        vehicles.append(draw_vehicle(draw, lane="own", timetable=shifted(ego, draw.uniform(25.0, 120.0))))
    if course.style == "village":
        vehicles += [
            draw_vehicle(
                draw,
                lane=draw.choice(["parked_left", "parked_right"]),
                is_towards=draw.chance(0.5),
                beam="off",
                timetable=((0.0, draw.uniform(25.0, other[0][1] - 20.0)),),
            )
            for _ in range(draw.integer(1, 4))
        ]
    if course.branches:
        far = min(draw.uniform(60.0, 110.0), course.branches[0].length_m - 5.0)
        vehicles.append(
            draw_vehicle(draw, lane="branch", timetable=((0.0, far), (draw.uniform(4.0, 7.0), 9.0), (12.0, 8.5)))
        )
    return tuple(vehicles)


def draw_vehicle(
    draw: Draw,
    *,
    timetable: Profile,
    lane: Literal["oncoming", "own", "parked_left", "parked_right", "branch"] = "oncoming",
    is_towards: bool = True,
    beam: Literal["low", "off"] = "low",
) -> VehicleSpec:
    """A vehicle of any kind, with lamps as people leave them."""
    return VehicleSpec(
        kind=draw.choice(["car", "van", "lorry", "motorcycle"], [0.78, 0.1, 0.08, 0.04]),
        lane=lane,
        is_towards=is_towards,
        timetable=timetable,
        beam="high" if beam == "low" and draw.chance(0.15) else beam,
        brightness=draw.log_uniform(0.6, 1.8),
        yaw_aim_deg=draw.normal(0.0, 0.5),
        pitch_aim_deg=draw.normal(0.0, 0.4),
        is_light=draw.chance(0.5),
    )


def draw_road(draw: Draw, course: Course, length_m: float, wetness: float) -> RoadSpec:
    """A two-lane road of this course: its markings, its wear, and clothoids at its bends."""
    points = [(0.0, 0.0)]
    for start, end, bend in course.bends:
        transition = min(draw.uniform(15.0, 45.0), (end - start) / 2.5)
        for s_m, value in (
            (start, 0.0),
            (start + transition, bend),
            (end - transition, bend),
            (end, 0.0),
        ):
            if s_m > points[-1][0] + 0.5:
                points.append((round(s_m, 1), float(f"{value:.5g}")))
    return RoadSpec(
        length_m=length_m,
        lane_width_m=draw.uniform(2.9, 3.6),
        curvature_per_m=tuple(points),
        elevation_m=course.elevation_m,
        centre_marking=draw.choice(["dashed", "solid", "none"], [0.6, 0.2, 0.2]),
        has_edge_marking=draw.chance(0.8 if course.style != "village" else 0.2),
        wear=draw.uniform(0.0, 0.8),
        wetness=wetness,
        branches=course.branches,
    )


def _speed_mps(draw: Draw, course: Course, cruising_mps: float) -> float:
    """A speed that is lower in a village and in bends: at most 3.5 m/s^2 of lateral acceleration."""
    if course.style == "village":
        return draw.uniform(9.0, 15.0)
    tightest = max((abs(bend) for _, _, bend in course.bends), default=0.0)
    return round(min(cruising_mps, float(np.sqrt(3.5 / tightest)) if tightest else cruising_mps), 2)


def shifted(timetable: Profile, by_m: float) -> Profile:
    """The time table of a vehicle that drives `by_m` further along the road."""
    return tuple((time, round(s_m + by_m, 2)) for time, s_m in timetable)
