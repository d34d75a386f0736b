"""Named scenarios: each draws a `Scene` of its kind; the scenes of a data set are drawn from all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias

from foreglow.config import validated
from foreglow.lab.simulation.scenes import courses
from foreglow.lab.simulation.scenes.country import cyclists, following, queue
from foreglow.lab.simulation.scenes.courses import Layout
from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.level_road import level_road
from foreglow.lab.simulation.scenes.mirror import mirrored
from foreglow.lab.simulation.scenes.motorway import motorway
from foreglow.lab.simulation.scenes.planning import planned_scene
from foreglow.lab.simulation.scenes.scene import EgoBeam, Scene
from foreglow.lab.simulation.scenes.town import town

Split: TypeAlias = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

DrawScene: TypeAlias = Callable[[Draw, str, int], Scene]
"""Draws a scene with a name and a seed."""


def _encounter(layout: Layout) -> DrawScene:
    """Scenes with the one encounter that PVDN's drives show, on a road of this layout."""
    return lambda draw, name, seed: planned_scene(draw, name, layout, seed)


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
    "motorway": motorway,
    "queue": queue,
    "following": following,
    "cyclists": cyclists,
    "town": town,
    "left_motorway": _left(motorway),
    "left_queue": _left(queue),
    "left_town": _left(town),
    "r48": level_road,
}
"""Every scenario by name."""

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
        ValueError: If there is no such scenario; the message lists those that exist.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario: expected one of {', '.join(SCENARIOS)}, got {name!r}")
    return SCENARIOS[name](Draw(seed, 0), name, seed)


def draw_scenes(num_scenes: int, seed: int, split: Split = "train", mixture: str = "pvdn") -> tuple[Scene, ...]:
    """The scenes of a data set; each depends only on the seed, the split, the mixture and its number.

    Raises:
        ValueError: If the number is not positive, or the split or the mixture is unknown.
    """
    if num_scenes < 1:
        raise ValueError(f"scenes: expected at least 1, got {num_scenes}")
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    if mixture not in MIXTURES:
        raise ValueError(f"mixture: expected one of {', '.join(MIXTURES)}, got {mixture!r}")
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


def resized(scene: Scene, width_px: int, height_px: int) -> Scene:
    """`scene` with another image size and the same horizontal field of view."""
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


def with_beam(scene: Scene, beam: EgoBeam) -> Scene:
    """`scene` with another beam of our own vehicle."""
    return scene.model_copy(update={"ego": scene.ego.model_copy(update={"beam": beam})})


def without_traffic(scene: Scene) -> Scene:
    """`scene` without vehicles whose lamps are lit; parked dark cars stay."""
    return scene.model_copy(update={"vehicles": tuple(vehicle for vehicle in scene.vehicles if vehicle.beam == "off")})


def adapted(
    scene: Scene, size_px: tuple[int, int], rate_hz: float, exposure: str, pair_s: float | None = None
) -> Scene:
    """`scene` with another image size (width, height), frame rate, exposure, and time between frames of a pair.

    Raises:
        ValueError: If a value is out of range; the message names the field.
    """
    sized = resized(scene, *size_px).model_dump()
    sized |= {"rate_hz": rate_hz, "pair_s": pair_s}
    sized["sensor"]["exposure"] = exposure
    return validated(Scene, sized, scene.name)
