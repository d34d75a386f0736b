"""Street lamps and lit windows: their light, and their image in the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.camera.optics import LampPoints
from foreglow.lab.simulation.light.lamps import FIXED_LAYER, PlacedLamp
from foreglow.lab.simulation.traffic.sightings import Sightings
from foreglow.lab.simulation.world.buildings import FixedLight
from foreglow.photometry import IntensityTable, street_lamp, window

REACH_M = 120.0
"""Light of street lamps further from the camera does not matter in the image; the lamps themselves are still seen."""

FARTHEST_M = 600.0
"""Lights further away are not drawn."""

PANE = np.array([(y, z) for z in (-1 / 3, 0.0, 1 / 3) for y in (-0.25, 0.25)])
"""Points that draw a light's face, in its width and height."""

SMALL_PX = 8.0
"""A face that is smaller in the image is drawn as one disc."""


class FixedLights:
    """The fixed lights of a scene."""

    def __init__(self, lights: Sequence[FixedLight]) -> None:
        self._lights = tuple(light for light in lights if light.intensity_cd > 0)
        self._positions_m = np.array([light.pose.position_m for light in self._lights]).reshape(-1, 3)

    def lamps_near(self, position_m: Floats) -> list[PlacedLamp]:
        """The street lamps whose light a camera at `position_m`, shape (3,), sees; windows light nothing."""
        near = np.linalg.norm(self._positions_m - position_m, axis=1) < REACH_M
        return [
            PlacedLamp(light.pose, street_lamp(), FIXED_LAYER, light.intensity_cd)
            for light, is_near in zip(self._lights, near, strict=True)
            if is_near and light.kind == "street_lamp"
        ]

    def points(self, sightings: Sightings) -> LampPoints:
        """The faces of the lights as the camera sees them, a few points each."""
        positions, illuminances, radii = [], [], []
        camera_m = sightings.camera_m
        for light, position_m in zip(self._lights, self._positions_m, strict=True):
            distance = float(np.linalg.norm(camera_m - position_m))
            if distance > FARTHEST_M:
                continue
            towards = light.pose.to_body(camera_m)
            intensity = float(_table(light).towards(towards)) * light.intensity_cd
            is_small = sightings.radius_px(max(light.size_m), distance) < SMALL_PX
            pane = PANE[:1] * 0.0 if is_small else PANE
            # Slightly in front of the face, which otherwise would hide its own points.
            points = light.pose.to_outer(np.column_stack([np.full(len(pane), 0.03), pane * light.size_m]))
            seen = sightings.visible_points(points) if intensity > 0 else np.zeros(len(pane), bool)
            cell_m = np.sqrt(light.size_m[0] * light.size_m[1] / len(pane) / np.pi)
            for point in points[seen]:
                positions.append(sightings.project(point))
                illuminances.append(intensity / len(pane) / distance**2 * sightings.attenuation(distance))
                radii.append(sightings.radius_px(float(cell_m), distance))
        return LampPoints(np.array(positions).reshape(-1, 2), np.array(illuminances), np.array(radii))


def _table(light: FixedLight) -> IntensityTable:
    return street_lamp() if light.kind == "street_lamp" else window()
