"""The light of our headlamps at other drivers' eyes and on the road, and of lamps on posts on our lane."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import VehicleTruth
from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.evaluation.occurrence import is_coming
from foreglow.lab.simulation import DriveFrame, Scene
from foreglow.lab.simulation.scenes.scene import EgoSpec
from foreglow.lab.simulation.traffic.actors import matrix_of
from foreglow.lab.simulation.world.road import Road
from foreglow.photometry import Headlamp, Headlamps, read_headlamps, street_lamp

FARTHEST_M = 400.0
"""In the simulator no light of ours reaches an eye that is further away."""

ROAD_DISTANCES_M = np.arange(40.0, 121.0, 10.0)
"""Where the light on the road is measured, arc lengths ahead of our rear axle."""

VERGE_M = 0.75
"""Distance of the point on the verge from the edge of the carriageway on our side."""

LIT_M = np.arange(0.0, 101.0, 5.0)
"""Where it is asked whether the road is lit, arc lengths ahead of our rear axle."""

MIN_LIT_LX, MIN_LIT_SHARE = 0.5, 0.75
"""A road is lit where lamps on posts give at least so much, on at least this share of `LIT_M`; one lamp alone lights
some 40 m of it."""


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
        verge_m = -scene.road.mirror * (self._road.half_width_m + VERGE_M)
        self._offsets_m = (_lane_m(scene), verge_m)

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
    left, right = (
        Headlamp(lamp.vehicle_from_lamp @ aim, matrix_of(ego, lamp.matrix))
        for lamp in (headlamps.left, headlamps.right)
    )
    return dataclasses.replace(headlamps, left=left, right=right)


def _lane_m(scene: Scene) -> float:
    """Offset of the middle of our lane to the left of the road's centre line."""
    return -scene.road.mirror * scene.road.lane_m(scene.ego.lane_number)


class StreetLight:
    """The light of a drive's lamps on posts on our lane, as on a flat road without anything in between."""

    def __init__(self, scene: Scene) -> None:
        edge_m = scene.road.half_width_m
        self._lane_m = _lane_m(scene)
        lamps = [lamp for lamp in scene.surroundings.street_lamps if lamp.intensity_cd > 0]
        sides = [1.0 if lamp.side == "left" else -1.0 for lamp in lamps]
        self._positions_m = np.array(
            [
                (lamp.s_m, side * (edge_m + lamp.offset_m), lamp.height_m)
                for lamp, side in zip(lamps, sides, strict=True)
            ]
        ).reshape(-1, 3)
        self._intensities_cd = np.array([lamp.intensity_cd for lamp in lamps])

    def is_lit(self, s_m: float) -> bool:
        """Whether the road ahead of the arc length `s_m` is lit."""
        points_m = np.stack([s_m + LIT_M, np.full(len(LIT_M), self._lane_m), np.zeros(len(LIT_M))], axis=1)
        offsets_m = points_m[:, np.newaxis] - self._positions_m
        distances_m = np.linalg.norm(offsets_m, axis=2)
        downwards = np.stack([-offsets_m[..., 2], offsets_m[..., 0], offsets_m[..., 1]], axis=-1)
        intensities_cd = self._intensities_cd * street_lamp().towards(downwards)
        lux = (intensities_cd * downwards[..., 0] / distances_m**3).sum(axis=1)
        return bool((lux >= MIN_LIT_LX).mean() >= MIN_LIT_SHARE)
