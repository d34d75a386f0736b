"""The light of our headlamps at other drivers' eyes and on the road, LED by LED, in a simulated drive.

    E = I(direction) / r^2 * cos(incidence) * exp(-b r)

I is a lamp's intensity, cd; r the range, m; the incidence that on a plane across the eye's line of sight; b the
scattering of the air, 1/m. What stands between lamp and eye is known from the simulator: a lamp is seen or it is not.
Light on the road is taken on a plane that faces the lamps, through clear air with nothing in between.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import VehicleTruth
from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.evaluation.occurrence import is_coming
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import EgoSpec, Scene
from foreglow.lab.simulation.world.road import Road
from foreglow.photometry import Headlamp, Headlamps, read_headlamps

FARTHEST_M = 400.0
"""In the simulator no light of ours reaches an eye that is further away."""

ROAD_DISTANCES_M = np.arange(40.0, 121.0, 10.0)
"""Where the light on the road is measured, arc lengths ahead of our rear axle."""

VERGE_M = 0.75
"""Distance of the point on the verge from the right edge of the carriageway."""


class EyeLight(NamedTuple):
    """The light at one eye in one frame.

    Attributes:
        range_m: From our vehicle's origin; NaN where it is beside or behind our lamps, or too far away.
        azimuth_rad: Of the eye in our vehicle's frame, to the left; NaN as the range.
        base_lx: By both low beams.
        leds_lx: Shape (2, L), by each LED at level 1.
    """

    range_m: float
    azimuth_rad: float
    is_in_sight: bool
    base_lx: float
    leds_lx: NDArray[np.float32]


class OurLight:
    """The light of our headlamps in one drive, as they are mounted, aimed and as bright as the scene has them."""

    def __init__(self, scene: Scene, headlamps: Headlamps | None = None) -> None:
        """Takes the scene, and our headlamps; None for the built-in ones."""
        self._lamps = _aimed(headlamps or read_headlamps(), scene.ego)
        self._positions_m = np.stack(
            [lamp.vehicle_from_lamp.position_m for lamp in (self._lamps.left, self._lamps.right)]
        )
        self._brightness = scene.ego.brightness
        self._scattering_per_m = scene.weather.scattering_per_m
        self._road = Road(scene.road)
        edge_m = self._road.half_width_m
        self._offsets_m = (-0.5 * edge_m, -edge_m - VERGE_M)

    def at_eye(self, known: DriveFrame, vehicle: VehicleTruth, levels: Floats) -> EyeLight:
        """The light at the driver's eye of `vehicle`, or at its mirrors where we follow it.

        What stands in between follows from the sum of both lamps' light in the simulator: one, both or none of them is
        seen, whichever comes nearest to that sum. A vehicle that we follow is in sight when its rear lamps are.

        Args:
            known: The frame.
            vehicle: One of its vehicles.
            levels: Shape (2, L), what was shone in this frame.
        """
        eye = known.ego_pose.to_body(vehicle.eye_world_m)
        forward = known.ego_pose.rotation.T @ vehicle.pose.rotation[:, 0]
        is_oncoming = is_coming(known.ego_pose, vehicle)
        no_light = np.zeros((2, self._lamps.num_leds), np.float32)
        range_m = float(np.hypot(eye[0], eye[1]))
        if eye[0] <= self._lamps.left.vehicle_from_lamp.position_m[0] + 0.5 or range_m > FARTHEST_M:
            return EyeLight(np.nan, np.nan, is_oncoming and vehicle.eye_lx.get("ego", 0.0) > 0, 0.0, no_light)
        sight = forward if is_oncoming else -forward
        base_lx, leds_lx = (self._facing(eye, sight, light_lx) for light_lx in self._by_lamp(eye))
        if is_oncoming:
            expected_lx = base_lx + (levels * leds_lx).sum(axis=1)
            is_seen = seen_lamps(expected_lx, vehicle.eye_lx.get("ego", 0.0))
        else:
            is_seen = np.full(2, any(lamp.is_rear and lamp.visible_share > 0 for lamp in vehicle.lamps))
        return EyeLight(
            range_m=range_m,
            azimuth_rad=float(np.arctan2(eye[1], eye[0])),
            is_in_sight=bool(is_seen.any()),
            base_lx=float(base_lx @ is_seen),
            leds_lx=(leds_lx * is_seen[:, None]).astype(np.float32),
        )

    def on_road(self, known: DriveFrame) -> tuple[Floats, NDArray[np.float32]]:
        """Mean illuminance of own lane and verge, facing the lamps, with nothing in between.

        Returns:
            By both low beams, shape (2,); by each LED at level 1, shape (2, 2, L): area, lamp, LED.
        """
        arcs_m = known.ego_s_m + ROAD_DISTANCES_M
        areas = [self._road.points(arcs_m, offset_m) for offset_m in self._offsets_m]
        points = known.ego_pose.to_body(np.concatenate(areas))
        base_lx, leds_lx = self._lamps.illuminance_lx(points)
        num = len(ROAD_DISTANCES_M)
        base = base_lx.reshape(2, num).mean(axis=1) * self._brightness
        leds = leds_lx.reshape(2, num, 2, -1).mean(axis=1) * self._brightness
        return base, leds.astype(np.float32)

    def _by_lamp(self, point: Floats) -> tuple[Floats, Floats]:
        """Illuminance by each low beam, shape (2,), and by each LED, shape (2, L), facing them."""
        offsets = point - self._positions_m
        squares = np.sum(offsets * offsets, axis=1)
        base_cd = [self._lamps.intensities_cd(offset[None])[0][0, lamp] for lamp, offset in enumerate(offsets)]
        leds_lx = self._lamps.illuminance_lx(point[None])[1][0]
        return np.array(base_cd) / squares, leds_lx

    def _facing(self, eye: Floats, forward: Floats, light_lx: Floats) -> Floats:
        """The light on a plane across `forward`, in place of one that faces the lamps, through the air; by lamp."""
        away = self._positions_m - eye
        ranges_m = np.linalg.norm(away, axis=1)
        kept = np.clip(away @ forward / ranges_m, 0.0, None) * np.exp(-self._scattering_per_m * ranges_m)
        return np.asarray(light_lx * (self._brightness * kept).reshape(2, *([1] * (light_lx.ndim - 1))))


def seen_lamps(expected_lx: Floats, found_lx: float) -> NDArray[np.bool_]:
    """Which of two lamps are seen, when they would give `expected_lx`, shape (2,), and give `found_lx` together.

    >>> seen_lamps(np.array([2.0, 3.0]), 3.0).tolist()
    [False, True]
    """
    choices = np.array([[False, False], [True, False], [False, True], [True, True]])
    return np.asarray(choices[np.argmin(np.abs(choices @ expected_lx - found_lx))])


def _aimed(headlamps: Headlamps, ego: EgoSpec) -> Headlamps:
    aim = Pose(np.zeros(3), rotation(float(np.radians(ego.yaw_aim_deg)), float(np.radians(ego.pitch_aim_deg))))
    left, right = (Headlamp(lamp.vehicle_from_lamp @ aim, lamp.matrix) for lamp in (headlamps.left, headlamps.right))
    return dataclasses.replace(headlamps, left=left, right=right)
