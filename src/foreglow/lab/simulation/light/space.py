"""The world, lamps, camera and air of one frame, as the kernels need them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Pose
from foreglow.lab.simulation.light.lights import Lights
from foreglow.lab.simulation.light.llvm import dr, mi
from foreglow.lab.simulation.light.raycast import Number, Solids
from foreglow.lab.simulation.scenes.scene import WeatherSpec


@dataclass
class Space:
    """A frame's world, lamps and camera.

    Attributes:
        world: The triangles.
        lights: The lamps.
        origin: Position of the camera in the world, metres.
        rotation: Rotation of world_from_camera.
        darkest_cd_m2: Light below this is left out.
    """

    world: Solids
    lights: Lights
    origin: Number
    rotation: Number
    darkest_cd_m2: Number


@dataclass
class Air:
    """The air's properties, as parameters of the kernels.

    Attributes:
        scattering_per_m: Scattering coefficient.
        asymmetry: Henyey-Greenstein's parameter.
        sky_cd_m2: Luminance of the sky.
    """

    scattering_per_m: Number
    asymmetry: Number
    sky_cd_m2: Number


def space_of(world: Solids, lights: Lights, world_from_camera: Pose, darkest_cd_m2: float) -> Space:
    """The space of one frame."""
    axes = [[_parameter(value) for value in row] for row in world_from_camera.rotation]
    origin = mi.Point3f(*(_parameter(value) for value in world_from_camera.position_m))
    return Space(world, lights, origin, mi.Matrix3f(axes), _parameter(darkest_cd_m2))


def air_of(weather: WeatherSpec) -> Air:
    """The air of one frame."""
    return Air(*(_parameter(value) for value in (weather.scattering_per_m, weather.asymmetry, weather.sky_cd_m2)))


def _parameter(value: float | np.floating) -> Number:
    """A number that is passed to a kernel, rather than compiled into it."""
    return dr.opaque(mi.Float, float(value))
