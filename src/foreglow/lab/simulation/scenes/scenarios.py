"""Named scenarios: each draws a `Scene` of its kind; the scenes of a data set are drawn from all of them."""

from __future__ import annotations

from typing import Literal, TypeAlias

from foreglow.config import validated
from foreglow.lab.simulation.scenes import courses
from foreglow.lab.simulation.scenes.courses import Layout
from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.planning import planned_scene
from foreglow.lab.simulation.scenes.scene import EgoBeam, Scene

Split: TypeAlias = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

SCENARIOS: dict[str, tuple[Layout, float]] = {
    "curve": (courses.curve, 0.30),
    "s_bend": (courses.s_bend, 0.16),
    "crest": (courses.crest, 0.14),
    "sag": (courses.sag, 0.06),
    "straight": (courses.straight, 0.06),
    "junction": (courses.junction, 0.05),
    "village": (courses.village, 0.06),
    "forest": (courses.forest, 0.17),
}
"""Every scenario by name, with its share of a data set. Most are roads that hide the other car, since these are what
provident detection is about."""


def scenario(name: str, seed: int = 0) -> Scene:
    """A scene of the scenario called `name`.

    Raises:
        ValueError: If there is no such scenario; the message lists those that exist.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario: expected one of {', '.join(SCENARIOS)}, got {name!r}")
    return planned_scene(Draw(seed, 0), name, SCENARIOS[name][0], seed)


def draw_scenes(num_scenes: int, seed: int, split: Split = "train") -> tuple[Scene, ...]:
    """The scenes of a data set; each depends only on the seed, the split and its number.

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
        name = draw.choice(names, weights)
        scenes.append(planned_scene(draw, name, SCENARIOS[name][0], draw.integer(0, 2**31)))
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


def adapted(scene: Scene, size_px: tuple[int, int], rate_hz: float, exposure: str) -> Scene:
    """`scene` with another image size (width, height), frame rate and exposure.

    Raises:
        ValueError: If a value is out of range; the message names the field.
    """
    sized = resized(scene, *size_px).model_dump()
    sized["rate_hz"] = rate_hz
    sized["sensor"]["exposure"] = exposure
    return validated(Scene, sized, scene.name)
