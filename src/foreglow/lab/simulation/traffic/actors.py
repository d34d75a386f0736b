"""The vehicles of a scene with their bodies and lamps, placed in the world at a time."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.light.lamps import FIXED_LAYER, PlacedBody, PlacedLamp
from foreglow.lab.simulation.scenes.scene import EgoSpec, VehicleSpec
from foreglow.lab.simulation.traffic.kinematics import VehicleState, vehicle_state
from foreglow.lab.simulation.world.bodies import (
    BODIES,
    BRAKE_FUNCTIONS,
    MARKER_FUNCTIONS,
    REAR_FUNCTIONS,
    Body,
    LampFunction,
    LampMount,
)
from foreglow.lab.simulation.world.road import Road
from foreglow.photometry import (
    Headlamps,
    IntensityTable,
    MatrixLamp,
    bicycle_lamp,
    brake_lamp,
    centre_brake_lamp,
    high_beam,
    low_beam,
    marker_lamp,
    read_ies,
    rear_lamp,
)
from foreglow.photometry.matrix import with_mirrored_base

BEHIND_M = 15.0
"""A vehicle further than this behind our rear axle is left out: neither its light nor its body is in the image."""

FOLLOWING_BEHIND_M = 50.0
"""The same for a vehicle that drives in our direction, whose headlamps light the road beside us before it overtakes."""

FARTHEST_M = 900.0
"""A vehicle beyond this distance is left out: at 900 m, a low beam lights a wall with less than 0.01 lx."""


@dataclass(frozen=True, slots=True, eq=False)
class LitLamp:
    """A lamp of a vehicle at one time.

    Attributes:
        name: Name of its mount.
        is_rear: Whether it shines backwards; a side marker does on a vehicle that drives ahead of us.
        placed: Its pose and its light.
        function: What the lamp is for.
        face_m: Width and height of its face, as in `LampMount`.
    """

    name: str
    is_rear: bool
    placed: PlacedLamp
    function: LampFunction = "low"
    face_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """Another vehicle at one time.

    Attributes:
        vehicle_id: Its index in `Scene.vehicles`.
        spec: Its description in the scene.
        body: Its shape.
        state: Its pose and motion.
        lamps: Its lamps that are on.
        layer: Layer of the light of its lamps; None if they light nothing.
    """

    vehicle_id: int
    spec: VehicleSpec
    body: Body
    state: VehicleState
    lamps: tuple[LitLamp, ...]
    layer: int | None

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
    """The vehicles that matter at `time_s`; those that light something have layers from `first_layer` on, in order.

    Args:
        vehicles: The vehicles of the scene.
        roads: The main road and its side roads.
        ego_pose: world_from_vehicle of our own vehicle.
        time_s: Time since the begin of the drive.
        first_layer: Layer of the first vehicle's light.
    """
    actors: list[Actor] = []
    is_left = roads[0].spec.traffic == "left"
    next_layer = first_layer
    for number, spec in enumerate(vehicles):
        body = _right_hand_drive(spec.kind) if is_left else BODIES[spec.kind]
        state = vehicle_state(spec, *roads, body.wheelbase_m, time_s)
        own_road = roads[1][spec.branch] if spec.lane == "branch" else roads[0]
        ahead = float(ego_pose.to_body(state.pose.position_m)[0])
        distance = float(np.linalg.norm(state.pose.position_m - ego_pose.position_m))
        behind_m = FOLLOWING_BEHIND_M if spec.lane == "own" else BEHIND_M
        is_near = ahead > -behind_m and distance < FARTHEST_M
        if is_near and 0.0 < state.s_m < own_road.length_m:
            is_braking = any(begin <= time_s < end for begin, end in spec.brakes_s)
            layer = None
            if spec.beam != "off" and (spec.lights_up_to_m is None or distance < spec.lights_up_to_m):
                layer = next_layer
                next_layer += 1
            lamps = _lamps(spec, body, state.pose, layer, is_braking=is_braking, is_left=is_left)
            actors.append(Actor(number, spec, body, state, lamps, layer))
    return tuple(actors)


def ego_tables(ego: EgoSpec, led_levels: Floats, headlamps: Headlamps) -> tuple[IntensityTable, IntensityTable]:
    """The light of our left and right headlamps; `led_levels`, shape (2, L), 0..1, is for the matrix beam only.

    Matrix lamps and high beam have light of their own: what `ego` says of the low beam is of the beam `low` alone.
    In a car for left-hand traffic the low beam is mirrored; the LEDs of the matrix beam stay where they are.
    """
    is_left = ego.traffic == "left"
    if ego.beam == "matrix":
        lamps = [matrix_of(ego, lamp.matrix) for lamp in (headlamps.left, headlamps.right)]
        return lamps[0].table(led_levels[0]), lamps[1].table(led_levels[1])
    if ego.beam == "high":
        return (_high_table(is_left),) * 2
    return (_low_table(ego.low_beam_file, is_left, (ego.carpet, ego.stray)),) * 2


def matrix_of(ego: EgoSpec, lamp: MatrixLamp) -> MatrixLamp:
    """One of our matrix lamps, with its low beam for the side of traffic that our car is made for."""
    return with_mirrored_base(lamp) if ego.traffic == "left" else lamp


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


@functools.cache
def _right_hand_drive(kind: str) -> Body:
    """The body with its driver on the other side."""
    x, y, z = BODIES[kind].eye_m
    return replace(BODIES[kind], eye_m=(x, -y, z))


def _lamps(
    spec: VehicleSpec, body: Body, pose: Pose, layer: int | None, *, is_braking: bool, is_left: bool
) -> tuple[LitLamp, ...]:
    """The lamps that are on; `is_left` says that traffic keeps to the left. Without a layer they light nothing."""
    if spec.beam == "off":
        return ()
    lamps = []
    for mount in body.lamps:
        if mount.function == "high":  # the table of the high beam includes the low beam, and replaces it
            continue
        if mount.function in BRAKE_FUNCTIONS and not is_braking:
            continue
        is_rear = mount.function in REAR_FUNCTIONS or (mount.function == "side_marker" and spec.lane == "own")
        lamps.append(
            LitLamp(mount.name, is_rear, _placed(mount, spec, pose, layer, is_left), mount.function, mount.face_m)
        )
    return tuple(lamps)


def _placed(mount: LampMount, spec: VehicleSpec, pose: Pose, layer: int | None, is_left: bool) -> PlacedLamp:
    if mount.function in _SIGNALS:
        turned, table = rotation(mount.yaw_rad), _SIGNALS[mount.function]()
    else:
        turned, table = _aim(spec.yaw_aim_deg, spec.pitch_aim_deg), _headlamp_table(spec, is_left)
    in_world = pose @ Pose(np.asarray(mount.position_m), turned)
    lights_nothing = layer is None or mount.function in MARKER_FUNCTIONS
    number = FIXED_LAYER if layer is None else layer
    return PlacedLamp(in_world, table, number, spec.brightness, mount.radius_m, lights_nothing=lights_nothing)


_SIGNALS: dict[LampFunction, Callable[[], IntensityTable]] = {
    "rear": rear_lamp,
    "rear_marker": rear_lamp,
    "front_marker": marker_lamp,
    "side_marker": marker_lamp,
    "brake": brake_lamp,
    "centre_brake": centre_brake_lamp,
}


def _headlamp_table(spec: VehicleSpec, is_left: bool) -> IntensityTable:
    if spec.kind == "bicycle":
        return bicycle_lamp()
    return _high_table(is_left) if spec.beam == "high" else _low_table(spec.low_beam_file, is_left)


def _aim(yaw_deg: float, pitch_deg: float) -> Floats:
    return rotation(float(np.radians(yaw_deg)), float(np.radians(pitch_deg)))


@functools.lru_cache(maxsize=16)  # one object for each table, which is sent to the renderer once
def _low_table(file: str | None, is_left: bool, factors: tuple[float, float] = (1.0, 1.0)) -> IntensityTable:
    """The low beam with factors on its parts, or that of an IES file; mirrored where traffic keeps to the left."""
    table = low_beam(*factors) if file is None else read_ies(Path(file))
    return table.mirrored if is_left and file is None else table


@functools.cache
def _high_table(is_left: bool) -> IntensityTable:
    """The built-in high beam, which holds the low beam."""
    return high_beam().mirrored if is_left else high_beam()
