"""Named scenarios: each draws a `Scene` of its kind; the scenes of a data set are drawn from all of them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Literal, TypeAlias

from foreglow.config import validated
from foreglow.lab.simulation.scenes import courses
from foreglow.lab.simulation.scenes.assembly import Journey, assembled
from foreglow.lab.simulation.scenes.country import cyclists, following, queue
from foreglow.lab.simulation.scenes.courses import Course, Layout
from foreglow.lab.simulation.scenes.draw import Draw, draw_settlements, draw_weather
from foreglow.lab.simulation.scenes.motorway import motorway
from foreglow.lab.simulation.scenes.planning import AS_IN_PVDN, LONG, Timing, draw_road, planned_scene
from foreglow.lab.simulation.scenes.roadside import draw_surroundings
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoBeam, RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.stream import COUNTRY, drawn_kind, drawn_vehicle, steady
from foreglow.lab.simulation.scenes.surroundings import House, SurroundingsSpec
from foreglow.lab.simulation.scenes.town import town
from foreglow.numbers import checked_whole
from foreglow.types.arrays import check_kind
from foreglow.wording import check_one_of, shortened

SWAPPED = {
    "left": "right",
    "right": "left",
    "parked_left": "parked_right",
    "parked_right": "parked_left",
    "chevron_left": "chevron_right",
    "chevron_right": "chevron_left",
}
"""Words that a mirror exchanges."""


def mirrored(scene: Scene) -> Scene:
    """The mirror image of `scene`, left for right; mirroring it again gives `scene`.

    Road, surroundings, vehicles, aims and calibration change sides, and the low beams of all are mirrored with the
    traffic. Everything else follows from the scene as always: labels, street data, lidar. The pictures on signs and the
    textures are drawn anew, since nothing in reality mirrors them.
    """
    ego = scene.ego.model_copy(
        update={"yaw_aim_deg": _negated(scene.ego.yaw_aim_deg), "traffic": SWAPPED[scene.ego.traffic]}
    )
    return scene.model_copy(
        update={
            "road": _road(scene.road),
            "surroundings": _surroundings(scene.surroundings),
            "vehicles": tuple(_vehicle(vehicle) for vehicle in scene.vehicles),
            "ego": ego,
            "camera": _camera(scene.camera),
        }
    )


def _road(road: RoadSpec) -> RoadSpec:
    return road.model_copy(
        update={
            "traffic": SWAPPED[road.traffic],
            "curvature_per_m": tuple((s_m, _negated(curvature)) for s_m, curvature in road.curvature_per_m),
            "branches": tuple(
                branch.model_copy(update={"angle_deg": _negated(branch.angle_deg)}) for branch in road.branches
            ),
        }
    )


def _surroundings(spec: SurroundingsSpec) -> SurroundingsSpec:
    changed: dict[str, Any] = {"left": spec.right, "right": spec.left}
    for name in (
        "rails",
        "walls",
        "signs",
        "woods",
        "houses",
        "street_lamps",
        "panels",
        "signals",
        "gantries",
        "settlements",
    ):
        changed[name] = tuple(_thing(thing) for thing in getattr(spec, name))
    return spec.model_copy(update=changed)


def _thing(thing: Any) -> Any:
    """Something beside the road; the yaw of a house is to the left, that of a panel towards the road."""
    changed: dict[str, Any] = {"side": SWAPPED[thing.side]}
    kind = getattr(thing, "kind", None)
    if kind in SWAPPED:
        changed["kind"] = SWAPPED[kind]
    if isinstance(thing, House):
        changed["yaw_deg"] = _negated(thing.yaw_deg)
    return thing.model_copy(update=changed)


def _vehicle(vehicle: VehicleSpec) -> VehicleSpec:
    lateral_m = None if vehicle.lateral_m is None else _negated(vehicle.lateral_m)
    return vehicle.model_copy(
        update={
            "lane": SWAPPED.get(vehicle.lane, vehicle.lane),
            "lateral_m": lateral_m,
            "yaw_aim_deg": _negated(vehicle.yaw_aim_deg),
        }
    )


def _camera(camera: CameraSpec) -> CameraSpec:
    k1, k2, p1, p2, k3 = camera.distortion
    centre = None if camera.centre_px is None else (camera.width_px - camera.centre_px[0], camera.centre_px[1])
    x, y, z = camera.mount_m
    return camera.model_copy(
        update={
            "centre_px": centre,
            "distortion": (k1, k2, p1, _negated(p2), k3),
            "mount_m": (x, _negated(y), z),
            "yaw_deg": _negated(camera.yaw_deg),
            "roll_deg": _negated(camera.roll_deg),
        }
    )


def _negated(value: float) -> float:
    """The opposite; 0 stays 0 and does not become -0."""
    return -value if value else value


DURATION_S = 14.0
LENGTH_M = 800.0


def level_road(draw: Draw, name: str, seed: int) -> Scene:
    """One vehicle comes from 600 m until we meet, and we close in on one ahead from 290 m to 40 m; any weather alike.

    The one ahead is never so near that it hides the one that comes.
    """
    weather, wetness = draw_weather(draw, is_even=True)
    journey = Journey(DURATION_S, draw.uniform(10.0, 25.0), draw.uniform(24.0, 26.0))
    course = Course(draw.choice(["open", "forest"]))
    oncoming_mps, ahead_mps = draw.uniform(20.0, 22.0), journey.speed_mps - draw.uniform(17.5, 18.0)
    vehicles = (
        drawn_vehicle(draw, drawn_kind(draw, COUNTRY), steady(journey.start_m + 620.0, -oncoming_mps)),
        drawn_vehicle(draw, drawn_kind(draw, COUNTRY), steady(journey.start_m + 290.0, ahead_mps), lane="own"),
    )
    road = draw_road(draw, course, LENGTH_M, wetness)
    surroundings = draw_surroundings(draw, course.style, LENGTH_M, course.bends)
    return assembled(draw, (name, seed), journey, road, surroundings, vehicles, weather)


Split: TypeAlias = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

MAX_SCENES = 1_000_000
"""Scenes of a data set; a million fill more disks than anybody has, and take a day to be drawn."""

DISTANCE_STREAM = 48
"""Number of the random stream of what is in the distance: all else is drawn as without it."""

DrawScene: TypeAlias = Callable[[Draw, str, int], Scene]
"""Draws a scene with a name and a seed."""


def _planned(draw: Draw, name: str, seed: int, layout: Layout, timing: Timing = AS_IN_PVDN) -> Scene:
    return planned_scene(draw, name, layout, seed, timing)


def _encounter(layout: Layout) -> DrawScene:
    """Scenes with the one encounter that PVDN's drives show, on a road of this layout."""
    return functools.partial(_planned, layout=layout)


def _with_settlements(draw_scene: DrawScene) -> DrawScene:
    """The same scenes with places in the distance, from a random stream of their own."""

    def draw_both(draw: Draw, name: str, seed: int) -> Scene:
        scene = draw_scene(draw, name, seed)
        settlements, glow_cd_m2 = draw_settlements(Draw(seed, DISTANCE_STREAM), scene.road.length_m)
        known = scene.surroundings.settlements
        surroundings = scene.surroundings.model_copy(update={"settlements": known + settlements})
        weather = scene.weather.model_copy(update={"glow_cd_m2": glow_cd_m2})
        return scene.model_copy(update={"surroundings": surroundings, "weather": weather})

    return draw_both


def _left(draw_scene: DrawScene) -> DrawScene:
    """The same scenes where traffic keeps to the left."""
    return lambda draw, name, seed: mirrored(draw_scene(draw, name, seed))


SCENARIOS: dict[str, DrawScene] = {
    "curve": _encounter(courses.curve),
    "s_bend": _encounter(courses.s_bend),
    "crest": _encounter(courses.crest),
    "sag": _encounter(courses.sag),
    "straight": _encounter(courses.straight),
    "junction": _encounter(courses.junction),
    "village": _encounter(courses.village),
    "forest": _encounter(courses.forest),
    "motorway": _with_settlements(motorway),
    "queue": _with_settlements(queue),
    "following": _with_settlements(following),
    "cyclists": _with_settlements(cyclists),
    "town": _with_settlements(town),
    "left_motorway": _left(_with_settlements(motorway)),
    "left_queue": _left(_with_settlements(queue)),
    "left_town": _left(_with_settlements(town)),
    "r48": level_road,
}
"""Every scenario by name."""

LONG_DRIVES: dict[str, DrawScene] = {
    **{
        layout.__name__: functools.partial(_planned, layout=layout, timing=LONG)
        for layout in (courses.curve, courses.crest, courses.forest, courses.village, courses.s_bend)
    },
    "town": functools.partial(town, lasts_s=(LONG.least_s, LONG.least_s + 2.0)),
}
"""Scenarios of drives that go on before and after they meet somebody, for closed loops."""

MIXTURES: dict[str, dict[str, float]] = {
    "pvdn": {
        "curve": 0.30,
        "s_bend": 0.16,
        "crest": 0.14,
        "sag": 0.06,
        "straight": 0.06,
        "junction": 0.05,
        "village": 0.06,
        "forest": 0.17,
    },
    "standard": {
        "curve": 0.11,
        "s_bend": 0.06,
        "crest": 0.05,
        "sag": 0.03,
        "straight": 0.03,
        "junction": 0.03,
        "village": 0.03,
        "forest": 0.06,
        "motorway": 0.15,
        "queue": 0.12,
        "following": 0.07,
        "cyclists": 0.05,
        "town": 0.14,
        "left_motorway": 0.02,
        "left_queue": 0.02,
        "left_town": 0.03,
    },
    "r48": {"r48": 1.0},
}
"""What data sets are drawn from: scenarios with their shares. In `pvdn`, most are roads that hide the other car, since
these are what provident detection is about; `standard` has as much of other traffic and of lit streets. `r48` is the
straight level road of UN R48."""

BALANCED: frozenset[str] = frozenset({"standard"})
"""Mixtures in which every second drive has no vehicle with its lamps on, and half of either kind have all of our matrix
beam on."""


def scenario(name: str, seed: int = 0) -> Scene:
    """A scene of the scenario called `name`.

    Raises:
        ValueError: If there is no such scenario, and then the message lists those that exist, or the seed is no whole
            number of at least 0.
    """
    check_one_of(name, SCENARIOS, "scenario")
    return SCENARIOS[name](Draw(seed, 0), name, seed)


def draw_scenes(num_scenes: int, seed: int, split: Split = "train", mixture: str = "pvdn") -> tuple[Scene, ...]:
    """The scenes of a data set; each depends only on the seed, the split, the mixture and its number.

    Raises:
        ValueError: If the number is none from 1 to `MAX_SCENES`, the seed no whole number of at least 0, or the split
            or the mixture is unknown.
    """
    checked_whole("scenes", num_scenes, 1, MAX_SCENES)
    check_one_of(split, SPLITS, "split")
    check_one_of(mixture, MIXTURES, "mixture")
    names, weights = list(MIXTURES[mixture]), list(MIXTURES[mixture].values())
    scenes = []
    for number in range(num_scenes):
        draw = Draw(seed, 1 + SPLITS.index(split), number)
        name = draw.choice(names, weights)
        scene = SCENARIOS[name](draw, name, draw.integer(0, 2**31))
        if mixture in BALANCED:
            scene = without_traffic(scene) if number % 2 else scene
            scene = with_beam(scene, "matrix") if number // 2 % 2 else scene
        scenes.append(scene)
    return tuple(scenes)


def long_drives(num: int, seed: int, split: Split) -> tuple[Scene, ...]:
    """Drives by every kind of road of `LONG_DRIVES` in turn, at least 20 s long, each with somebody to meet.

    Raises:
        ValueError: If the number is none from 1 to `MAX_SCENES`, the seed no whole number of at least 0, or there is no
            such split.
    """
    checked_whole("scenes", num, 1, MAX_SCENES)
    check_one_of(split, SPLITS, "split")
    drives: list[Scene] = []
    number = 0
    while len(drives) < num:
        draw = Draw(seed, 1 + SPLITS.index(split), number)
        name = list(LONG_DRIVES)[len(drives) % len(LONG_DRIVES)]
        scene = LONG_DRIVES[name](draw, name, draw.integer(0, 2**31))
        number += 1
        if scene.vehicles != without_traffic(scene).vehicles:
            drives.append(scene)
    return tuple(drives)


def resized(scene: Scene, width_px: int, height_px: int) -> Scene:
    """`scene` with another image size and the same horizontal field of view.

    Raises:
        ValueError: If no scene's camera has such a size, or the scene is none.
    """
    check_kind("scene", scene, Scene)
    checked_whole("camera.width_px", width_px, 1)
    checked_whole("camera.height_px", height_px, 1)
    camera = scene.camera
    if (camera.width_px, camera.height_px) == (width_px, height_px):
        return scene
    factor = width_px / camera.width_px
    centre = None
    if camera.centre_px is not None:
        centre = (camera.centre_px[0] * factor, camera.centre_px[1] * height_px / camera.height_px)
    size = {"width_px": width_px, "height_px": height_px}
    try:
        sized = camera.model_copy(update={**size, "focal_px": camera.focal_px * factor, "centre_px": centre})
    except ValueError as error:
        raise ValueError(f"camera.{error}") from None
    return scene.model_copy(update={"camera": sized})


def with_beam(scene: Scene, beam: EgoBeam) -> Scene:
    """`scene` with another beam of our own vehicle; unless that is `low`, our low beam is no longer changed.

    Raises:
        ValueError: If there is no such beam, or the scene is none.
    """
    check_kind("scene", scene, Scene)
    check_one_of(beam, EgoBeam, "beam")
    return scene.model_copy(update={"ego": scene.ego.with_beam(beam)})


def without_traffic(scene: Scene) -> Scene:
    """`scene` without vehicles whose lamps are lit; parked dark cars stay.

    Raises:
        ValueError: If the scene is none.
    """
    check_kind("scene", scene, Scene)
    return scene.model_copy(update={"vehicles": tuple(vehicle for vehicle in scene.vehicles if vehicle.beam == "off")})


def adapted(
    scene: Scene, size_px: tuple[int, int], rate_hz: float, exposure: str, pair_s: float | None = None
) -> Scene:
    """`scene` with another image size (width, height), frame rate, exposure, and time between frames of a pair.

    Raises:
        ValueError: If a value is out of range; the message names the field.
    """
    if not isinstance(size_px, tuple | list) or len(size_px) != 2:
        raise ValueError(f"size_px: expected a width and a height, got {shortened(size_px)}")
    sized = resized(scene, *size_px).model_dump()
    sized |= {"rate_hz": rate_hz, "pair_s": pair_s}
    sized["sensor"]["exposure"] = exposure
    return validated(Scene, sized, scene.name)
