"""A drive that needs no renderer: small pictures of noise, and truth that is made up but complete."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import numpy as np

from foreglow.datasets import ImageCategory
from foreglow.datasets.simulated import Artifact, LampTruth, VehicleTruth
from foreglow.geometry import Camera, Pose, rotation
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoSpec, RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.world.road import Road, interpolated
from foreglow.lab.simulation.writing.street_data import StreetDataError, StreetMap
from foreglow.types import Frame

WIDTH_PX, HEIGHT_PX = 96, 72


def scene(seed: int, num_frames: int = 3, rate_hz: float = 18.0) -> Scene:
    return Scene(
        name=f"stub {seed}",
        seed=seed,
        duration_s=num_frames / rate_hz,
        rate_hz=rate_hz,
        road=RoadSpec(
            length_m=300.0, curvature_per_m=((0.0, 0.0), (60.0, 0.008)), elevation_m=((0.0, 1.0), (300.0, 7.0))
        ),
        vehicles=(VehicleSpec(), VehicleSpec(kind="lorry", lane="own")),
        ego=EgoSpec(timetable=((0.0, 20.0 + seed), (10.0, 150.0))),
        camera=CameraSpec(width_px=WIDTH_PX, height_px=HEIGHT_PX, focal_px=98.4),
    )


def drive(scene: Scene, fail_at: tuple[int, int] | None = None, lag_ns: int = 0) -> Iterator[DriveFrame]:
    """The frames of `scene`; raises in frame `fail_at[1]` of the scene with seed `fail_at[0]`."""
    rng = np.random.default_rng([scene.seed, 1])
    road = Road(scene.road)
    mount = Pose(np.array(scene.camera.mount_m), rotation(pitch_rad=math.radians(scene.camera.pitch_deg)))
    streets = _streets(scene.road)
    focal = scene.camera.focal_px
    camera = Camera(WIDTH_PX, HEIGHT_PX, (focal, focal), (WIDTH_PX / 2, HEIGHT_PX / 2), (-0.05, 0.02, 0, 0, 0), mount)
    for index in range(scene.num_frames):
        if fail_at == (scene.seed, index):
            raise RuntimeError("interrupted here")
        time_s = index / scene.rate_hz
        s_m, speed_mps = interpolated(scene.ego.timetable, time_s)
        depth_m = rng.uniform(5.0, 150.0, (HEIGHT_PX, WIDTH_PX)).astype(np.float32)
        depth_m[: HEIGHT_PX // 3] = np.nan
        timestamp_ns = 500_000_000 + round(index * 1e9 / scene.rate_hz) + index * lag_ns
        yield DriveFrame(
            image_id=index,
            timestamp_ns=timestamp_ns,
            frame=Frame(rng.integers(0, 256, (HEIGHT_PX, WIDTH_PX), dtype=np.uint8), timestamp_ns, frame=index),
            camera=camera,
            ego_pose=road.pose(float(s_m), -1.75, 1, 2.7),
            ego_s_m=float(s_m),
            ego_speed_mps=float(speed_mps),
            ego_yaw_rate_radps=0.01 * index,
            vehicles=tuple(_vehicle(number, index, road, rng) for number in range(index % 3)),
            category=ImageCategory(index % 3),
            is_production_detected=index >= 2,
            street=streets.message(float(s_m)),
            depth_m=depth_m,
            ego_eye_lx={"0": float(rng.random()), "fixed": 0.0},
        )


@functools.cache
def _streets(spec: RoadSpec) -> StreetMap:
    return StreetMap(Road(spec), StreetDataError(), np.random.default_rng(0))


def _vehicle(number: int, index: int, road: Road, rng: np.random.Generator) -> VehicleTruth:
    pose = road.pose(70.0 + 20.0 * number, 1.75, -1, 2.7)
    artifacts = (
        _artifact(0, "lamp", rng, is_direct=True),
        _artifact(1, "haze", rng),
        _artifact(-1, "rail", rng, is_doubtful=True),
    )
    return VehicleTruth(
        vehicle_id=number,
        kind=("car", "lorry")[number],
        pose=pose,
        speed_mps=float(rng.uniform(0, 30)),
        size_m=(4.4, 1.8, 1.5),
        box_centre_m=np.array([1.3, 0.0, 0.75]),
        box_xyxy_px=(4, 5, 20, 21) if number == 0 else None,
        visible_share=0.25,
        range_m=float(rng.uniform(20, 200)),
        lamps=(
            LampTruth("low_left", False, pose.to_outer([3.6, 0.6, 0.65]), (3.5, 7.25), 0.08, 1234.5, 0.5),
            LampTruth("rear_left", True, pose.to_outer([-0.9, 0.6, 0.8]), (math.nan, math.nan), 0.06, 0.0, 0.0),
        ),
        artifacts=artifacts if index == 1 or number else artifacts[2:],
        candidates=(*artifacts, _artifact(-1, "foliage", rng)),
        eye_world_m=pose.to_outer([1.0, 0.4, 1.2]),
        eye_lx={"ego": float(rng.random()), "1": 0.125},
    )


def _artifact(
    number: int, kind: str, rng: np.random.Generator, *, is_direct: bool = False, is_doubtful: bool = False
) -> Artifact:
    x, y = rng.uniform((0, 0), (WIDTH_PX, HEIGHT_PX)).tolist()
    return Artifact(
        instance_id=number,
        position_px=(x, y),
        kind=kind,  # type: ignore[arg-type]
        is_direct=is_direct,
        is_rear=False,
        is_doubtful=is_doubtful,
        depth_m=math.nan if kind == "haze" else float(rng.uniform(10, 100)),
        grey=float(rng.uniform(2, 200)),
        contrast=float(rng.uniform(5, 50)),
        area_px=int(rng.integers(25, 500)),
        lamp="low_left" if is_direct else "",
    )
