"""Named scenarios: each draws a `Scene` of its kind; a data set draws its scenes among them.

The course of the road, the land beside it and the speeds are drawn first; then the oncoming car's time table is chosen
so that it comes into sight a few seconds into the drive, as in PVDN's sequences, whose typical one shows three seconds
of empty road, the best part of a second of indirect light and then the car until it passes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from foreglow.config import validated
from foreglow.simulation.scenes.draw import Draw
from foreglow.simulation.scenes.encounter import Corridor, corridor, is_light_in_sight, sight_time_s
from foreglow.simulation.scenes.roadside import Style, draw_surroundings
from foreglow.simulation.scenes.scene import (
    Branch,
    CameraSpec,
    EgoSpec,
    RoadSpec,
    Scene,
    SensorSpec,
    VehicleSpec,
    WeatherSpec,
)
from foreglow.simulation.scenes.surroundings import Profile, SurroundingsSpec
from foreglow.simulation.world.road import Road

Split: TypeAlias = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

Bend: TypeAlias = tuple[float, float, float]
"""From, to, and signed curvature in 1/m."""

SIGHT_S = (3.6, 0.8)
"""Mean and standard deviation of the time into the drive at which the oncoming car comes into sight; of the order of
PVDN's night validation split, whose median is 3.6 s."""

LONGEST_MISS_S, LONGEST_LEAD_S = 1.5, 0.9
"""An encounter in which the car comes into sight at another time than wanted, or its light should lead by more, is
drawn anew; in PVDN light leads by 0.6 to 1.5 s (quartiles)."""

MAX_PLANS = 12

SHORTEST_S, LONGEST_S = 6.5, 9.5
"""Bounds of the time into the drive at which the two meet."""


@dataclass(frozen=True, slots=True)
class Course:
    """How a road runs, and the land beside it."""

    style: Style = "open"
    bends: tuple[Bend, ...] = ()
    elevation_m: Profile = ((0.0, 0.0),)
    branches: tuple[Branch, ...] = ()


Layout: TypeAlias = Callable[[Draw, float], Course]
"""Draws a course around the place, in metres, at which the view should open."""


def curve(draw: Draw, focus_m: float) -> Course:
    """One bend, to either side."""
    style: Style = draw.choice(["open", "forest", "rocky"], [0.5, 0.3, 0.2])
    return Course(style, _winding(draw, _bend(draw, focus_m)), _gentle_hills(draw, focus_m))


def s_bend(draw: Draw, focus_m: float) -> Course:
    """Two bends to opposite sides."""
    first = _bend(draw, focus_m - 30.0)
    start = first[1] + draw.uniform(15.0, 60.0)
    second = (start, start + draw.uniform(60.0, 140.0), float(-np.sign(first[2])) / draw.log_uniform(90.0, 300.0))
    style: Style = draw.choice(["open", "forest", "rocky"], [0.5, 0.3, 0.2])
    return Course(style, (first, *_winding(draw, second)), _gentle_hills(draw, focus_m))


def crest(draw: Draw, focus_m: float) -> Course:
    """A hill that hides the other car."""
    half, height = draw.uniform(90.0, 150.0), draw.uniform(1.8, 4.5)
    profile = ((focus_m - half, 0.0), (focus_m, height), (focus_m + half, draw.uniform(-2.0, 1.0)))
    bends = _winding(draw, _bend(draw, focus_m, gentle=True)) if draw.chance(0.5) else ()
    return Course(draw.choice(["open", "forest"]), bends, profile)


def sag(draw: Draw, focus_m: float) -> Course:
    """A dip between two slopes, often with a bend in it."""
    half, depth = draw.uniform(90.0, 160.0), draw.uniform(3.0, 8.0)
    profile = ((focus_m - half, 0.0), (focus_m, -depth), (focus_m + half, draw.uniform(-1.0, 3.0)))
    bends = (_bend(draw, focus_m),) if draw.chance(0.7) else ()
    return Course(draw.choice(["open", "forest"]), bends, profile)


def straight(draw: Draw, focus_m: float) -> Course:
    """A straight road; the other car is seen from far."""
    return Course(draw.choice(["open", "forest"]), (), _gentle_hills(draw, focus_m))


def junction(draw: Draw, focus_m: float) -> Course:
    """A side road that meets ours, with a car on it."""
    branch = Branch(s_m=round(focus_m, 1), angle_deg=draw.choice([-1, 1]) * draw.uniform(60.0, 115.0))
    bends = (_bend(draw, focus_m + 110.0),) if draw.chance(0.6) else ()
    return Course(draw.choice(["open", "open", "village"]), bends, ((0.0, 0.0),), (branch,))


def village(draw: Draw, focus_m: float) -> Course:
    """A street with houses, lamps and parked cars."""
    return Course("village", (_bend(draw, focus_m),) if draw.chance(0.8) else (), _gentle_hills(draw, focus_m))


def forest(draw: Draw, focus_m: float) -> Course:
    """A winding road through a wood."""
    return Course("forest", _winding(draw, _bend(draw, focus_m)), _gentle_hills(draw, focus_m))


SCENARIOS: dict[str, tuple[Layout, float]] = {
    "curve": (curve, 0.30),
    "s_bend": (s_bend, 0.16),
    "crest": (crest, 0.14),
    "sag": (sag, 0.06),
    "straight": (straight, 0.06),
    "junction": (junction, 0.05),
    "village": (village, 0.06),
    "forest": (forest, 0.17),
}
"""Every scenario by name, with its share of a data set. Roads that hide the other car come first: they are what
provident detection is about."""


def scenario(name: str, seed: int = 0) -> Scene:
    """A scene of the scenario called `name`.

    Raises:
        ValueError: If there is no such scenario; the message lists those that exist.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario: expected one of {', '.join(SCENARIOS)}, got {name!r}")
    return _scene(Draw(seed, 0), name, seed)


def draw_scenes(num_scenes: int, seed: int, split: Split = "train") -> tuple[Scene, ...]:
    """The scenes of a data set; each depends on the seed, the split and its number alone.

    Raises:
        ValueError: If the number is not positive or the split is unknown.
    """
    if num_scenes < 1:
        raise ValueError(f"scenes: expected at least 1, got {num_scenes}")
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    names, weights = list(SCENARIOS), [share for _, share in SCENARIOS.values()]
    scenes = []
    for number in range(num_scenes):
        draw = Draw(seed, 1 + SPLITS.index(split), number)
        scenes.append(_scene(draw, draw.choice(names, weights), draw.integer(0, 2**31)))
    return tuple(scenes)


def resized(scene: Scene, width_px: int, height_px: int) -> Scene:
    """`scene` seen by the same camera with an image of another size: the horizontal field of view stays."""
    camera = scene.camera
    if (camera.width_px, camera.height_px) == (width_px, height_px):
        return scene
    factor = width_px / camera.width_px
    centre = None
    if camera.centre_px is not None:
        centre = (camera.centre_px[0] * factor, camera.centre_px[1] * height_px / camera.height_px)
    sized = camera.model_copy(
        update={
            "width_px": width_px,
            "height_px": height_px,
            "focal_px": camera.focal_px * factor,
            "centre_px": centre,
        }
    )
    return scene.model_copy(update={"camera": sized})


def adapted(scene: Scene, size_px: tuple[int, int], rate_hz: float, exposure: str) -> Scene:
    """`scene` with images of another size (width, height), another frame rate and another exposure.

    Raises:
        ValueError: If one is out of range; the message names the field.
    """
    sized = resized(scene, *size_px).model_dump()
    sized["rate_hz"] = rate_hz
    sized["sensor"]["exposure"] = exposure
    return validated(Scene, sized, scene.name)


@dataclass(frozen=True, slots=True)
class _Plan:
    """Where and when the two meet.

    Attributes:
        course: How the road runs.
        road: The road.
        surroundings: What stands beside it.
        ego: Our time table.
        other: The oncoming car's.
        meeting_s: When they meet.
        miss_s: How far the time at which the other car comes into sight is from the wanted one.
        lead_s: By how much light that it throws should be seen before the car.
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
        """Whether it is much like a drive of PVDN."""
        return self.miss_s <= LONGEST_MISS_S and self.lead_s <= LONGEST_LEAD_S


def _scene(draw: Draw, name: str, seed: int) -> Scene:
    """Draws everything of one scene; the encounter is drawn anew while it is unlike those of PVDN."""
    weather, wetness = _weather(draw)
    plans: list[_Plan] = []
    while len(plans) < MAX_PLANS and not (plans and plans[-1].is_good):
        plans.append(_plan(draw, SCENARIOS[name][0], wetness))
    plan = plans[-1] if plans[-1].is_good else min(plans, key=lambda one: one.miss_s + one.lead_s)
    duration_s = plan.meeting_s + draw.uniform(-0.3, 1.2)
    return Scene(
        name=name,
        seed=seed,
        duration_s=round(min(max(duration_s, 6.0), LONGEST_S + 1.5), 2),
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
        camera=_camera(draw),
        sensor=_sensor(draw),
    )


def _plan(draw: Draw, layout: Layout, wetness: float) -> _Plan:
    """Draws a road with its roadside, and times the encounter."""
    sight_s = draw.normal(*SIGHT_S)
    start_m = draw.uniform(10.0, 25.0)
    cruising_mps = draw.uniform(15.0, 25.0)
    focus_m = start_m + cruising_mps * sight_s + draw.uniform(50.0, 170.0)
    course = layout(draw, focus_m)
    ego_mps = _speed_mps(draw, course, cruising_mps)
    other_mps = _speed_mps(draw, course, draw.uniform(15.0, 27.0))
    length_m = float(round(start_m + (ego_mps + other_mps) * LONGEST_S + 60.0))
    spec = _road(draw, course, length_m, wetness)
    surroundings = draw_surroundings(draw, course.style, length_m, course.bends)
    ego = ((0.0, start_m), (10.0, round(start_m + 10.0 * ego_mps, 2)))
    road, free = Road(spec), corridor(surroundings, spec.lane_width_m)
    other, meeting_s = _encounter(road, free, ego, other_mps, sight_s)
    seen_s = sight_time_s(road, free, ego, other)
    light_s = sight_time_s(road, free, ego, other, is_light_in_sight)
    miss_s = abs(meeting_s - seen_s - sight_s)
    return _Plan(course, spec, surroundings, ego, other, meeting_s, miss_s, light_s - seen_s)


def _encounter(road: Road, free: Corridor, ego: Profile, other_mps: float, sight_s: float) -> tuple[Profile, float]:
    """The oncoming car's time table, with which it comes into sight nearest to `sight_s`, and the time of meeting."""
    ego_mps = (ego[1][1] - ego[0][1]) / (ego[1][0] - ego[0][0])
    best: tuple[float, Profile, float] | None = None
    for meeting_s in np.arange(max(sight_s + 2.0, SHORTEST_S), LONGEST_S + 0.01, 0.5):
        meeting_m = ego[0][1] + ego_mps * meeting_s
        begin_m = round(float(meeting_m + other_mps * meeting_s), 2)
        other = ((0.0, begin_m), (10.0, round(begin_m - 10.0 * other_mps, 2)))
        miss_s = abs(meeting_s - sight_time_s(road, free, ego, other) - sight_s)
        if best is None or miss_s < best[0]:
            best = (miss_s, other, float(meeting_s))
    assert best is not None
    return best[1], best[2]


def _vehicles(draw: Draw, course: Course, other: Profile, ego: Profile) -> tuple[VehicleSpec, ...]:
    """The oncoming car and whoever else is there; one drive in eight has nobody."""
    if draw.chance(0.12):
        return ()
    vehicles = [_vehicle(draw, timetable=other)]
    behind_m = 0.0
    while draw.chance(0.12):  # several in a row
        behind_m += draw.uniform(12.0, 45.0)
        vehicles.append(_vehicle(draw, timetable=_shifted(other, behind_m)))
    if draw.chance(0.07):
        vehicles.append(_vehicle(draw, lane="own", timetable=_shifted(ego, draw.uniform(25.0, 120.0))))
    if course.style == "village":
        vehicles += [
            _vehicle(
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
            _vehicle(draw, lane="branch", timetable=((0.0, far), (draw.uniform(4.0, 7.0), 9.0), (12.0, 8.5)))
        )
    return tuple(vehicles)


def _vehicle(
    draw: Draw,
    *,
    timetable: Profile,
    lane: Literal["oncoming", "own", "parked_left", "parked_right", "branch"] = "oncoming",
    is_towards: bool = True,
    beam: Literal["low", "off"] = "low",
) -> VehicleSpec:
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


def _road(draw: Draw, course: Course, length_m: float, wetness: float) -> RoadSpec:
    points = [(0.0, 0.0)]
    for start, end, bend in course.bends:
        transition = min(draw.uniform(15.0, 45.0), (end - start) / 2.5)
        for place, value in (
            (start, 0.0),
            (start + transition, bend),
            (end - transition, bend),
            (end, 0.0),
        ):
            if place > points[-1][0] + 0.5:
                points.append((round(place, 1), float(f"{value:.5g}")))
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


def _bend(draw: Draw, focus_m: float, *, gentle: bool = False) -> Bend:
    radius_m = draw.log_uniform(300.0, 900.0) if gentle else draw.log_uniform(110.0, 500.0)
    length_m = min(draw.uniform(80.0, 220.0), 1.7 * radius_m)
    start = max(focus_m - length_m * draw.uniform(0.25, 0.6), 5.0)
    sign = -1 if draw.chance(0.7) else 1  # in PVDN more cars appear to the right than to the left
    return (round(start, 1), round(start + length_m, 1), sign / radius_m)


def _winding(draw: Draw, first: Bend) -> tuple[Bend, ...]:
    """`first` and what follows: where roads wind, the light of a car is hidden until the last bend."""
    bends = [first]
    while len(bends) < 4 and draw.chance(0.8):
        start = bends[-1][1] + draw.uniform(10.0, 50.0)
        sign = float(np.sign(bends[-1][2])) * (-1 if draw.chance(0.7) else 1)
        bend = (start, start + draw.uniform(50.0, 140.0), sign / draw.log_uniform(100.0, 350.0))
        bends.append((round(bend[0], 1), round(bend[1], 1), bend[2]))
    return tuple(bends)


def _gentle_hills(draw: Draw, focus_m: float) -> Profile:
    if draw.chance(0.4):
        return ((0.0, 0.0),)
    places = (0.0, focus_m * 0.6, focus_m * 1.3, focus_m * 2.2)
    return tuple((round(place, 1), draw.uniform(-2.0, 2.0) if place else 0.0) for place in places)


def _speed_mps(draw: Draw, course: Course, cruising_mps: float) -> float:
    """Slower in a village and in bends: at most 3.5 m/s^2 to the side."""
    if course.style == "village":
        return draw.uniform(9.0, 15.0)
    tightest = max((abs(bend) for _, _, bend in course.bends), default=0.0)
    return round(min(cruising_mps, float(np.sqrt(3.5 / tightest)) if tightest else cruising_mps), 2)


def _shifted(timetable: Profile, by_m: float) -> Profile:
    return tuple((time, round(place + by_m, 2)) for time, place in timetable)


def _weather(draw: Draw) -> tuple[WeatherSpec, float]:
    """The weather, and how wet the road is."""
    kind = draw.choice(["dry", "wet", "rain", "snow", "mist"], [0.55, 0.2, 0.1, 0.08, 0.07])
    haze = {
        "dry": (5e-5, 3e-4),
        "wet": (1e-4, 6e-4),
        "rain": (2e-4, 1e-3),
        "snow": (4e-4, 1.5e-3),
        "mist": (1e-3, 4e-3),
    }
    weather = WeatherSpec(
        scattering_per_m=draw.log_uniform(*haze[kind]),
        rain_mm_h=draw.log_uniform(0.5, 8.0) if kind == "rain" else 0.0,
        snow_mm_h=draw.log_uniform(0.3, 3.0) if kind == "snow" else 0.0,
        sky_cd_m2=draw.log_uniform(1e-4, 5e-3),
    )
    wetness = {"dry": 0.0, "wet": draw.uniform(0.3, 1.0), "rain": draw.uniform(0.6, 1.0)}
    return weather, wetness.get(kind, draw.uniform(0.0, 0.4))


def _camera(draw: Draw) -> CameraSpec:
    return CameraSpec(
        focal_px=draw.normal(1312.0, 50.0),
        centre_px=(draw.normal(640.0, 6.0), draw.normal(480.0, 6.0)),
        distortion=(
            draw.normal(-0.05, 0.02),
            draw.normal(0.02, 0.01),
            draw.normal(0.0, 3e-4),
            draw.normal(0.0, 3e-4),
            0.0,
        ),
        mount_m=(draw.uniform(1.7, 2.1), draw.normal(0.0, 0.05), draw.uniform(1.2, 1.45)),
        pitch_deg=draw.normal(-0.7, 0.4),
        yaw_deg=draw.normal(0.0, 0.3),
        roll_deg=draw.normal(0.0, 0.2),
    )


def _sensor(draw: Draw) -> SensorSpec:
    """Around the figures of the one lossless real frame."""
    return SensorSpec(
        grey_per_cd_m2=draw.log_uniform(38.0, 66.0),
        night_gain=draw.log_uniform(6.0, 11.0),
        black_level=draw.normal(7.6, 0.8),
        knee=draw.normal(38.0, 3.0),
        log_slope=draw.normal(14.0, 1.5),
        read_noise=draw.normal(1.35, 0.15),
        shot_noise=draw.log_uniform(0.038, 0.066),
        column_noise=draw.log_uniform(0.7, 1.3),
        core_px=draw.normal(0.8, 0.08),
        middle_share=draw.uniform(0.18, 0.32),
        middle_px=draw.log_uniform(0.5, 1.2),
        tail_share=draw.log_uniform(8e-3, 2.2e-2),
    )
