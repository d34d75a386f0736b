"""Fixed lights, and the screens that shine by themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from foreglow.geometry import Pose
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh
from foreglow.lab.simulation.world.primitives import polygon


@dataclass(frozen=True, slots=True, eq=False)
class FixedLight:
    """A fixed light, not that of a vehicle.

    Attributes:
        pose: world_from_lamp; a street lamp's x points down, others' out of their face.
        kind: What it is; a screen is a billboard or a shop window, whose face is a surface of the world.
        intensity_cd: Intensity on its axis; how it falls to the side follows from the kind.
        size_m: Width (along its y) and height (along its z) of its face.
        reach_m: Distance from the camera up to which what it lights matters in the image.
    """

    pose: Pose
    kind: Literal["street_lamp", "window", "screen", "signal"]
    intensity_cd: float
    size_m: tuple[float, float]
    reach_m: float = 120.0


def screen(size_m: tuple[float, float], screen_cd_m2: float, *, picture: float) -> Mesh:
    """A rectangle that faces along x and shines by itself; `picture`, 0..1, is how much its luminance varies."""
    y, z = size_m[0] / 2, size_m[1] / 2
    corners = np.array([[0.0, -y, -z], [0.0, y, -z], [0.0, y, z], [0.0, -y, z]])
    mesh = polygon(corners, material_number("screen"))
    shine = np.broadcast_to(np.array([screen_cd_m2, picture], np.float32), mesh.coordinates_m.shape)
    return replace(mesh, coordinates_m=shine)


def screen_light(pose: Pose, size_m: tuple[float, float], screen_cd_m2: float) -> FixedLight:
    """The light of a screen at `pose`, world_from_screen, as that of a point slightly in front of its middle."""
    out = Pose(pose.to_outer([0.3, 0.0, 0.0]), pose.rotation)
    return FixedLight(out, "screen", screen_cd_m2 * size_m[0] * size_m[1], size_m)
