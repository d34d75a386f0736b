"""Lamps and bodies in the world, as the renderer needs them."""

from __future__ import annotations

from dataclasses import dataclass

from foreglow.geometry import Pose
from foreglow.photometry import IntensityTable

FIXED_LAYER, EGO_LAYER, FIRST_VEHICLE_LAYER = 0, 1, 2
"""Layers of light by source: street lamps, our own lamps, then one layer for each other vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLamp:
    """A point source with an intensity table.

    Attributes:
        world_from_lamp: Its pose, misalignment included.
        table: Its intensity; lamps that share a table share the object, so that it is sent to the renderer once.
        layer: Number of the layer for its light.
        scale: Factor on the table.
        radius_m: Radius of its disc, for its image and its visible share.
        lights_nothing: Whether it is so faint that it is only seen itself, and what it lights is left out.
    """

    world_from_lamp: Pose
    table: IntensityTable
    layer: int
    scale: float = 1.0
    radius_m: float = 0.08
    lights_nothing: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBody:
    """A vehicle's body in the world.

    Attributes:
        kind: Name of the body, such as `car`.
        is_light: Whether the paint is light.
        world_from_vehicle: Its pose.
    """

    kind: str
    is_light: bool
    world_from_vehicle: Pose

    @property
    def mesh_name(self) -> str:
        """Name of its mesh in the renderer."""
        return mesh_name(self.kind, self.is_light)


def mesh_name(kind: str, is_light: bool) -> str:
    """Name, in the renderer, of the mesh of a kind of body with light or dark paint.

    >>> mesh_name("car", False)
    'car/dark'
    """
    return f"{kind}/{'light' if is_light else 'dark'}"
