"""Left-hand traffic: the mirror image of a whole scene."""

from __future__ import annotations

from typing import Any

from foreglow.lab.simulation.scenes.scene import CameraSpec, RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import House, SurroundingsSpec

SWAPPED = {
    "left": "right",
    "right": "left",
    "parked_left": "parked_right",
    "parked_right": "parked_left",
    "chevron_left": "chevron_right",
    "chevron_right": "chevron_left",
}
"""Words that a mirror exchanges."""


def mirrored(scene: Scene) -> Scene:
    """The mirror image of `scene`, left for right; mirroring it again gives `scene`.

    Road, surroundings, vehicles, aims and calibration change sides, and the low beams of all are mirrored with the
    traffic. Everything else follows from the scene as always: labels, street data, lidar. The pictures on signs and the
    textures are drawn anew, since nothing in reality mirrors them.
    """
    ego = scene.ego.model_copy(
        update={"yaw_aim_deg": _negated(scene.ego.yaw_aim_deg), "traffic": SWAPPED[scene.ego.traffic]}
    )
    return scene.model_copy(
        update={
            "road": _road(scene.road),
            "surroundings": _surroundings(scene.surroundings),
            "vehicles": tuple(_vehicle(vehicle) for vehicle in scene.vehicles),
            "ego": ego,
            "camera": _camera(scene.camera),
        }
    )


def _road(road: RoadSpec) -> RoadSpec:
    return road.model_copy(
        update={
            "traffic": SWAPPED[road.traffic],
            "curvature_per_m": tuple((s_m, _negated(curvature)) for s_m, curvature in road.curvature_per_m),
            "branches": tuple(
                branch.model_copy(update={"angle_deg": _negated(branch.angle_deg)}) for branch in road.branches
            ),
        }
    )


def _surroundings(spec: SurroundingsSpec) -> SurroundingsSpec:
    changed: dict[str, Any] = {"left": spec.right, "right": spec.left}
    for name in ("rails", "walls", "signs", "woods", "houses", "street_lamps", "panels", "signals"):
        changed[name] = tuple(_thing(thing) for thing in getattr(spec, name))
    return spec.model_copy(update=changed)


def _thing(thing: Any) -> Any:
    """Something beside the road; the yaw of a house is to the left, that of a panel towards the road."""
    changed: dict[str, Any] = {"side": SWAPPED[thing.side]}
    kind = getattr(thing, "kind", None)
    if kind in SWAPPED:
        changed["kind"] = SWAPPED[kind]
    if isinstance(thing, House):
        changed["yaw_deg"] = _negated(thing.yaw_deg)
    return thing.model_copy(update=changed)


def _vehicle(vehicle: VehicleSpec) -> VehicleSpec:
    lateral_m = None if vehicle.lateral_m is None else _negated(vehicle.lateral_m)
    return vehicle.model_copy(
        update={
            "lane": SWAPPED.get(vehicle.lane, vehicle.lane),
            "lateral_m": lateral_m,
            "yaw_aim_deg": _negated(vehicle.yaw_aim_deg),
        }
    )


def _camera(camera: CameraSpec) -> CameraSpec:
    k1, k2, p1, p2, k3 = camera.distortion
    centre = None if camera.centre_px is None else (camera.width_px - camera.centre_px[0], camera.centre_px[1])
    x, y, z = camera.mount_m
    return camera.model_copy(
        update={
            "centre_px": centre,
            "distortion": (k1, k2, p1, _negated(p2), k3),
            "mount_m": (x, _negated(y), z),
            "yaw_deg": _negated(camera.yaw_deg),
            "roll_deg": _negated(camera.roll_deg),
        }
    )


def _negated(value: float) -> float:
    """The opposite; 0 stays 0 and does not become -0."""
    return -value if value else value
