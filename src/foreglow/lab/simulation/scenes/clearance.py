"""Which vehicles would drive through each other."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, VehicleSpec
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
