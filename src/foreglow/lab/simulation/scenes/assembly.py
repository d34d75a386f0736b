"""From a road, its surroundings and its traffic to a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.draw import Draw, draw_camera, draw_sensor
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, Scene, VehicleSpec, WeatherSpec
from foreglow.lab.simulation.scenes.stream import Braking, slowed, steady
from foreglow.lab.simulation.scenes.surroundings import Profile, SurroundingsSpec
from foreglow.lab.simulation.traffic.kinematics import driving_direction, lateral_m
from foreglow.lab.simulation.world.bodies import BODIES
from foreglow.lab.simulation.world.road import interpolated

STEP_S = 0.1
GAP_M, ASIDE_M = 1.5, 0.15
"""Smallest gaps along the road and across it."""


def without_collisions(
    vehicles: Iterable[VehicleSpec], ego: EgoSpec, road: RoadSpec, duration_s: float
) -> tuple[VehicleSpec, ...]:
    """The vehicles in their order, without those that would touch us or an earlier one; side roads do not count."""
    times_s = np.arange(0.0, duration_s + STEP_S, STEP_S)
    taken = [_extent(_as_vehicle(ego), road, times_s)]
    kept: list[VehicleSpec] = []
    for vehicle in vehicles:
        extent = _extent(vehicle, road, times_s)
        if vehicle.lane == "branch" or not any(_touch(extent, other) for other in taken):
            kept.append(vehicle)
            taken += [extent] if vehicle.lane != "branch" else []
    return tuple(kept)


def is_in_ours(vehicle: VehicleSpec, ego: EgoSpec, road: RoadSpec, times_s: Floats) -> NDArray[np.bool_]:
    """At which of `times_s` a vehicle on the main road and ours are in the same place; straying does not count."""
    begin, end, right, left = _extent(vehicle, road, times_s)
    our_begin, our_end, our_right, our_left = _extent(_as_vehicle(ego), road, times_s)
    return np.asarray((begin < our_end) & (our_begin < end) & (right < our_left) & (our_right < left))


def _as_vehicle(ego: EgoSpec) -> VehicleSpec:
    return VehicleSpec(lane="own", lane_number=ego.lane_number, timetable=ego.timetable)


def _extent(vehicle: VehicleSpec, road: RoadSpec, times_s: Floats) -> Floats:
    """Begin and end along the road, and right and left edge, at all times, shape (4, T)."""
    body = BODIES[vehicle.kind]
    s, _ = interpolated(vehicle.timetable, times_s)
    middle = s + driving_direction(vehicle) * body.box_centre_m[0]
    half = np.array(body.size_m) / 2
    t = np.full(len(s), lateral_m(vehicle, road))
    return np.stack([middle - half[0], middle + half[0], t - half[1], t + half[1]])


def _touch(extent: Floats, other: Floats) -> bool:
    is_beside = (extent[0] < other[1] + GAP_M) & (other[0] < extent[1] + GAP_M)
    is_behind = (extent[2] < other[3] + ASIDE_M) & (other[2] < extent[3] + ASIDE_M)
    return bool((is_beside & is_behind).any())


@dataclass(frozen=True, slots=True)
class Journey:
    """Our own drive.

    Attributes:
        duration_s: Its duration.
        start_m: Where it begins.
        speed_mps: Our speed.
        braking: When we slow down; None for never.
        lane_number: Our lane, counted from the median; None for the one at the edge.
        carpet: The wide light of our low beam, as in `EgoSpec`.
    """

    duration_s: float
    start_m: float
    speed_mps: float
    braking: Braking | None = None
    lane_number: int | None = None
    carpet: float = 1.0

    @property
    def timetable(self) -> Profile:
        """The time table of our vehicle."""
        if self.braking is None:
            return steady(self.start_m, self.speed_mps)
        return slowed(self.start_m, self.speed_mps, self.duration_s, self.braking)


def assembled(
    draw: Draw,
    origin: tuple[str, int],
    journey: Journey,
    road: RoadSpec,
    surroundings: SurroundingsSpec,
    vehicles: Iterable[VehicleSpec],
    weather: WeatherSpec,
) -> Scene:
    """The scene called by the name and with the seed of `origin`; vehicles that would collide are left out."""
    ego = EgoSpec(
        timetable=journey.timetable,
        lane_number=journey.lane_number,
        carpet=journey.carpet,
        brightness=draw.log_uniform(0.5, 1.25),
        yaw_aim_deg=draw.normal(0.0, 0.4),
        pitch_aim_deg=draw.normal(-0.1, 0.3),
        body_motion=draw.log_uniform(0.5, 2.0),
    )
    return Scene(
        name=origin[0],
        seed=origin[1],
        duration_s=round(journey.duration_s, 2),
        road=road,
        surroundings=surroundings,
        vehicles=without_collisions(vehicles, ego, road, journey.duration_s),
        ego=ego,
        weather=weather,
        camera=draw_camera(draw),
        sensor=draw_sensor(draw),
    )
