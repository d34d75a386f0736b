"""Lamps in the world, as the renderer wants them."""

from __future__ import annotations

from dataclasses import dataclass

from foreglow.geometry import Pose
from foreglow.photometry import IntensityTable

FIXED_LAYER, EGO_LAYER, FIRST_VEHICLE_LAYER = 0, 1, 2
"""Whose light a layer holds: street lamps, ourselves, then one layer for each other vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedLamp:
    """A point source with an intensity table.

    Attributes:
        world_from_lamp: Where it is and how it is turned, mis-aim included.
        table: Its intensity; the same object for lamps that share it, so that it is sent to the renderer once.
        layer: Number of the layer that its light goes to.
        scale: Factor on the table.
        radius_m: Of its disc, for its own picture and its visible share.
    """

    world_from_lamp: Pose
    table: IntensityTable
    layer: int
    scale: float = 1.0
    radius_m: float = 0.08


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
        """What the renderer calls its mesh."""
        return mesh_name(self.kind, self.is_light)


def mesh_name(kind: str, is_light: bool) -> str:
    """What the renderer calls the mesh of a kind of body in one of its paints.

    >>> mesh_name("car", False)
    'car/dark'
    """
    return f"{kind}/{'light' if is_light else 'dark'}"
