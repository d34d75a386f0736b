"""Street lamps, lit windows, screens and traffic lights: their light, and their image in the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.camera.optics import LampPoints
from foreglow.lab.simulation.light.lamps import FIXED_LAYER, PlacedLamp
from foreglow.lab.simulation.traffic.sightings import Sightings
from foreglow.lab.simulation.world.fixed_light import FixedLight
from foreglow.photometry import IntensityTable, street_lamp, traffic_light, window

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
        """The lights that light what a camera at `position_m`, shape (3,), sees; windows of flats light nothing."""
        distances = np.linalg.norm(self._positions_m - position_m, axis=1)
        return [
            PlacedLamp(light.pose, _table(light), FIXED_LAYER, light.intensity_cd)
            for light, distance in zip(self._lights, distances, strict=True)
            if distance < light.reach_m and light.kind != "window"
        ]

    def points(self, sightings: Sightings) -> LampPoints:
        """The faces of the lights as the camera sees them, a few points each; screens are surfaces of the world."""
        positions, illuminances, radii = [], [], []
        camera_m = sightings.camera_m
        for light, position_m in zip(self._lights, self._positions_m, strict=True):
            distance = float(np.linalg.norm(camera_m - position_m))
            if distance > FARTHEST_M or light.kind == "screen":
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
    tables = {"street_lamp": street_lamp, "signal": traffic_light}
    return tables.get(light.kind, window)()
