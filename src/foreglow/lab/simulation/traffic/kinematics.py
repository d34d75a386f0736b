"""Poses of vehicles at a time, from time tables, with the motion of our body on its springs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.simulation.world.road import Road, interpolated

EGO_WHEELBASE_M = 2.8
STREAM = 1
"""Random stream of the body's motion."""

PITCH_DEG, ROLL_DEG, HEAVE_M = 0.12, 0.10, 0.008
"""Standard deviations of the body's motion on a good country road; similar to published ride measurements."""

NUM_WAVES = 12

PARKED_FROM_LANE_M = 2.45
"""From the middle of our lane to that of a parked vehicle, at least: half of a lorry, half of our car, 0.25 m. Where
the road ends before, it stands on the pavement with its outer wheels."""

STRAY_WAVE_M = 150.0
"""Way in which a driver who strays is back: about 7 s at 80 km/h."""


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """A vehicle at one time.

    Attributes:
        pose: world_from_vehicle.
        s_m: Arc length of the rear axle along its road.
        speed_mps: Forward speed.
        yaw_rate_radps: Yaw rate to the left.
    """

    pose: Pose
    s_m: float
    speed_mps: float
    yaw_rate_radps: float


class BodyMotion:
    """Pitch, roll and heave over time: sums of waves around the body's and the wheels' natural frequencies.

    It is a function of time alone, so that any frame can be rendered without earlier ones.
    """

    def __init__(self, seed: int, strength: float) -> None:
        """Draws the waves; `strength` scales them all."""
        rng = np.random.default_rng([seed, STREAM])
        is_body = np.arange(NUM_WAVES) < NUM_WAVES - 3  # the others are the wheels, ten times faster and weaker
        centres = np.where(is_body, 1.4, 11.0)
        self._frequencies_hz = centres * np.exp(rng.normal(0.0, 0.25, (3, NUM_WAVES)))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, (3, NUM_WAVES))
        amplitudes = np.where(is_body, 1.0, 0.12) * np.sqrt(2.0 / is_body.sum())
        self._amplitudes = strength * np.array([[PITCH_DEG], [ROLL_DEG], [HEAVE_M]]) * amplitudes

    def at(self, time_s: float) -> Pose:
        """steady_vehicle_from_vehicle at `time_s`."""
        waves = np.sin(2.0 * np.pi * self._frequencies_hz * time_s + self._phases)
        pitch_deg, roll_deg, heave_m = (self._amplitudes * waves).sum(1)
        turned = rotation(0.0, float(np.radians(pitch_deg)), float(np.radians(roll_deg)))
        return Pose(np.array([0.0, 0.0, heave_m]), turned)


def ego_state(ego: EgoSpec, road: Road, body: BodyMotion, time_s: float) -> VehicleState:
    """Our own vehicle at `time_s`, in the middle of its lane or straying to either side of it."""
    s, speed = (float(value) for value in interpolated(ego.timetable, time_s))
    phase = 2.0 * np.pi * s / STRAY_WAVE_M
    slope, bend_per_m = (ego.stray_m * (2.0 * np.pi / STRAY_WAVE_M) ** order for order in (1, 2))
    heading_rad = float(np.arctan(slope * np.cos(phase)))
    left_m = -road.spec.mirror * road.spec.lane_m(ego.lane_number) + ego.stray_m * float(np.sin(phase))
    steady = road.pose(s, left_m, 1, EGO_WHEELBASE_M) @ Pose(np.zeros(3), rotation(heading_rad, 0.0, 0.0))
    curvature_per_m = float(road.curvature_per_m(s)) - bend_per_m * float(np.sin(phase))
    return VehicleState(steady @ body.at(time_s), s, speed, speed * curvature_per_m)


def vehicle_state(
    vehicle: VehicleSpec, road: Road, branches: tuple[Road, ...], wheelbase_m: float, time_s: float
) -> VehicleState:
    """Another vehicle at `time_s`; `road` is the main road, `branches` its side roads."""
    s, rate = (float(value) for value in interpolated(vehicle.timetable, time_s))
    own_road = branches[vehicle.branch] if vehicle.lane == "branch" else road
    direction = driving_direction(vehicle)
    lateral = lateral_m(vehicle, own_road.spec)
    speed = direction * rate
    # Driving against the arc length turns a bend to the left into one to the right.
    yaw_rate = speed * direction * float(own_road.curvature_per_m(s))
    return VehicleState(own_road.pose(s, lateral, direction, wheelbase_m), s, speed, yaw_rate)


def driving_direction(vehicle: VehicleSpec) -> int:
    """1 along the arc length of its road, -1 against it."""
    if vehicle.lane == "own":
        return 1
    if vehicle.lane == "oncoming":
        return -1
    return -1 if vehicle.is_towards else 1


def lateral_m(vehicle: VehicleSpec, road: RoadSpec) -> float:
    """Offset of the vehicle to the left of the centre line of its road, by default the middle of its lane."""
    if vehicle.lateral_m is not None:
        return vehicle.lateral_m
    lane = road.mirror * road.lane_m(vehicle.lane_number)
    parked = max(road.half_width_m - 0.9, road.lane_m() + PARKED_FROM_LANE_M)
    offsets: dict[str, float] = {
        "own": -lane,
        "oncoming": lane,
        "parked_left": parked,
        "parked_right": -parked,
        "branch": lane if vehicle.is_towards else -lane,
    }
    return offsets[vehicle.lane]
