"""The vehicles of a scene with their bodies and lamps, placed in the world at a time."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.light.lamps import PlacedBody, PlacedLamp
from foreglow.lab.simulation.scenes.scene import EgoSpec, VehicleSpec
from foreglow.lab.simulation.traffic.kinematics import VehicleState, vehicle_state
from foreglow.lab.simulation.world.bodies import BODIES, Body, LampMount
from foreglow.lab.simulation.world.road import Road
from foreglow.photometry import Headlamps, IntensityTable, high_beam, low_beam, read_ies, rear_lamp

BEHIND_M = 15.0
"""A vehicle further than this behind our rear axle is left out: neither its light nor its body is in the image."""

FARTHEST_M = 900.0
"""A vehicle beyond this distance is left out: at 900 m, a low beam lights a wall with less than 0.01 lx."""


@dataclass(frozen=True, slots=True, eq=False)
class LitLamp:
    """A lamp of a vehicle at one time.

    Attributes:
        name: Name of its mount.
        is_rear: Whether it shines backwards.
        placed: Its pose and its light.
    """

    name: str
    is_rear: bool
    placed: PlacedLamp


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """Another vehicle at one time.

    Attributes:
        vehicle_id: Its index in `Scene.vehicles`.
        spec: Its description in the scene.
        body: Its shape.
        state: Its pose and motion.
        lamps: Its lamps that are on.
    """

    vehicle_id: int
    spec: VehicleSpec
    body: Body
    state: VehicleState
    lamps: tuple[LitLamp, ...]

    @property
    def placed_body(self) -> PlacedBody:
        """Its body, for the renderer."""
        return PlacedBody(self.spec.kind, self.spec.is_light, self.state.pose)

    @property
    def eye_world_m(self) -> Floats:
        """Its driver's eye, shape (3,)."""
        return self.state.pose.to_outer(self.body.eye_m)


def actors_at(
    vehicles: tuple[VehicleSpec, ...],
    roads: tuple[Road, tuple[Road, ...]],
    ego_pose: Pose,
    time_s: float,
    first_layer: int,
) -> tuple[Actor, ...]:
    """The vehicles that matter at `time_s`; the light of the vehicle at index i has the layer `first_layer` + i.

    Args:
        vehicles: The vehicles of the scene.
        roads: The main road and its side roads.
        ego_pose: world_from_vehicle of our own vehicle.
        time_s: Time since the begin of the drive.
        first_layer: Layer of the first vehicle's light.
    """
    actors: list[Actor] = []
    for number, spec in enumerate(vehicles):
        body = BODIES[spec.kind]
        state = vehicle_state(spec, *roads, body.wheelbase_m, time_s)
        own_road = roads[1][spec.branch] if spec.lane == "branch" else roads[0]
        ahead = float(ego_pose.to_body(state.pose.position_m)[0])
        distance = float(np.linalg.norm(state.pose.position_m - ego_pose.position_m))
        is_near = ahead > -BEHIND_M and distance < FARTHEST_M
        if is_near and 0.0 < state.s_m < own_road.length_m:
            lamps = _lamps(spec, body, state.pose, first_layer + len(actors))
            actors.append(Actor(number, spec, body, state, lamps))
    return tuple(actors)


def ego_tables(ego: EgoSpec, led_levels: Floats, headlamps: Headlamps) -> tuple[IntensityTable, IntensityTable]:
    """The light of our left and right headlamps; `led_levels`, shape (2, L), 0..1, is for the matrix beam only."""
    if ego.beam == "matrix":
        return headlamps.left.matrix.table(led_levels[0]), headlamps.right.matrix.table(led_levels[1])
    table = high_beam() if ego.beam == "high" else _low_table(ego.low_beam_file)
    return table, table


def ego_lamps(
    ego: EgoSpec, pose: Pose, tables: tuple[IntensityTable, IntensityTable], layer: int, mounts: Headlamps
) -> tuple[PlacedLamp, PlacedLamp]:
    """Our headlamps in the world: mounted as in their description, and misaligned as in the scene."""
    out_of_aim = Pose(np.zeros(3), _aim(ego.yaw_aim_deg, ego.pitch_aim_deg))
    left, right = (
        PlacedLamp(pose @ lamp.vehicle_from_lamp @ out_of_aim, table, layer, ego.brightness)
        for lamp, table in zip((mounts.left, mounts.right), tables, strict=True)
    )
    return left, right


def _lamps(spec: VehicleSpec, body: Body, pose: Pose, layer: int) -> tuple[LitLamp, ...]:
    if spec.beam == "off":
        return ()
    return tuple(
        LitLamp(mount.name, mount.function == "rear", _placed(mount, spec, pose, layer))
        for mount in body.lamps
        if mount.function != "high"  # the table of the high beam includes the low beam, and replaces it
    )


def _placed(mount: LampMount, spec: VehicleSpec, pose: Pose, layer: int) -> PlacedLamp:
    if mount.function == "rear":
        turned, table = rotation(np.pi), rear_lamp()
    else:
        turned = _aim(spec.yaw_aim_deg, spec.pitch_aim_deg)
        table = high_beam() if spec.beam == "high" else _low_table(spec.low_beam_file)
    in_world = pose @ Pose(np.asarray(mount.position_m), turned)
    return PlacedLamp(in_world, table, layer, spec.brightness, mount.radius_m)


def _aim(yaw_deg: float, pitch_deg: float) -> Floats:
    return rotation(float(np.radians(yaw_deg)), float(np.radians(pitch_deg)))


@functools.cache  # one object for each table, which is sent to the renderer once
def _low_table(file: str | None) -> IntensityTable:
    """The built-in low beam, or that of an IES file."""
    return low_beam() if file is None else read_ies(Path(file))
