"""Several vehicles at once through the whole chain: light, labels, categories, lidar and files."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.datasets.simulated import VehicleTruth, read_truth
from foreglow.lab.simulation import DatasetConfig, Scene, drive_frames, simulate_dataset
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scenarios import mirrored
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoSpec, RoadSpec, SensorSpec, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import Panel, Signal, SurroundingsSpec, Verge

pytestmark = pytest.mark.renderer

BARE = Verge(grass_per_m2=0.0, bank_m=0.0, ditch_m=0.0)
OPEN = SurroundingsSpec(left=BARE, right=BARE, delineator_spacing_m=0.0)
CAMERA = CameraSpec(width_px=320, height_px=240, focal_px=328.0)
MOTORWAY = RoadSpec(length_m=300.0, num_lanes=2, median="barrier", median_m=2.0, shoulders_m=(0.8, 2.0))


def scene(*vehicles: VehicleSpec, **changes: object) -> Scene:
    """Our drive among `vehicles`, two frames."""
    fields: dict[str, object] = {
        "duration_s": 2 / 18,
        "road": RoadSpec(length_m=300.0),
        "surroundings": OPEN,
        "vehicles": vehicles,
        "ego": EgoSpec(timetable=((0.0, 20.0), (10.0, 220.0)), body_motion=0.0),
        "camera": CAMERA,
        "sensor": SensorSpec(exposure="night"),
    }
    return Scene(**(fields | changes))  # type: ignore[arg-type]


def oncoming(s_m: float, **fields: object) -> VehicleSpec:
    return VehicleSpec(timetable=((0.0, s_m), (10.0, s_m - 200.0)), **fields)  # type: ignore[arg-type]


def ahead(s_m: float, **fields: object) -> VehicleSpec:
    return VehicleSpec(lane="own", timetable=((0.0, s_m), (10.0, s_m + 200.0)), **fields)  # type: ignore[arg-type]


@functools.cache
def first_frame(drive: Scene) -> DriveFrame:
    return next(drive_frames(drive, "fast"))


def direct(vehicle: VehicleTruth) -> dict[str, tuple[float, float]]:
    return {artifact.lamp: artifact.position_px for artifact in vehicle.artifacts if artifact.is_direct}


def queue() -> DriveFrame:
    return first_frame(scene(*(oncoming(s_m) for s_m in (70.0, 95.0, 120.0, 240.0)), ahead(60.0)))


def test_every_vehicle_of_a_queue_has_its_own_lamps() -> None:
    frame = queue()
    assert [vehicle.vehicle_id for vehicle in frame.vehicles] == [0, 1, 2, 3, 4]
    assert {"low_left", "low_right"} <= set(direct(frame.vehicles[0]))
    ids = [artifact.instance_id for vehicle in frame.vehicles for artifact in vehicle.artifacts]
    assert len(ids) == len(set(ids))
    for vehicle in frame.vehicles:
        for lamp in vehicle.lamps:
            if lamp.name in direct(vehicle) and len(direct(vehicle)) > 1:
                np.testing.assert_allclose(direct(vehicle)[lamp.name], lamp.position_px, atol=1.0)


def test_lamps_that_merge_in_the_image_are_one_key_point_of_their_vehicle() -> None:
    far = queue().vehicles[3]
    assert far.range_m > 200
    assert len(direct(far)) == 1


def test_the_vehicle_ahead_shows_rear_lamps_and_does_not_count_as_oncoming() -> None:
    alone = first_frame(scene(ahead(45.0, brakes_s=((0.0, 1.0),))))
    (vehicle,) = alone.vehicles
    marked = [artifact for artifact in vehicle.artifacts if artifact.is_direct]
    assert marked
    assert all(artifact.is_rear for artifact in marked)
    assert alone.category == 0


def test_brake_lamps_are_seen_brighter() -> None:
    frames = [first_frame(scene(ahead(45.0, brakes_s=spans))) for spans in ((), ((0.0, 1.0),))]
    assert frames[1].frame.image.sum(dtype=np.int64) > frames[0].frame.image.sum(dtype=np.int64)
    assert max(lamp.intensity_cd for lamp in frames[1].vehicles[0].lamps) > 60


def test_markers_are_seen_but_do_not_move_the_range() -> None:
    (vehicle,) = first_frame(scene(oncoming(90.0, kind="semitrailer"))).vehicles
    seen = [lamp.name for lamp in vehicle.lamps if lamp.visible_share > 0.2]
    assert {"front_marker_1_left", "front_marker_2_right"} <= set(seen)
    heads = np.mean([lamp.position_world_m for lamp in vehicle.lamps if lamp.is_headlamp], axis=0)
    camera_m = np.array([20.0 + CAMERA.mount_m[0], -1.75, CAMERA.mount_m[2]])
    assert vehicle.range_m == pytest.approx(np.linalg.norm(heads - camera_m), abs=0.3)


def test_a_barrier_hides_most_of_the_lamps_behind_it() -> None:
    near = oncoming(60.0, lane_number=0)
    open_road = MOTORWAY.model_copy(update={"median": "none"})
    ego = EgoSpec(timetable=((0.0, 20.0), (10.0, 220.0)), lane_number=0, body_motion=0.0)
    shares = [
        first_frame(scene(near, road=road, ego=ego)).vehicles[0].lamps[0].visible_share
        for road in (open_road, MOTORWAY)
    ]
    assert shares[0] == 1.0
    assert shares[1] < 0.2


def test_the_mirror_image_of_a_scene_looks_like_one() -> None:
    drive = scene(oncoming(70.0), ahead(60.0, kind="van"), road=RoadSpec(length_m=300.0, wear=0.0))
    here, there = first_frame(drive), first_frame(mirrored(drive))
    flipped = there.frame.image[:, ::-1].astype(float)
    grey = here.frame.image.astype(float)
    assert np.abs(grey - flipped).mean() < 3.0
    assert np.abs(grey - there.frame.image).mean() > 2 * np.abs(grey - flipped).mean()
    for before, after in zip(here.vehicles, there.vehicles, strict=True):
        for lamp, other in zip(before.lamps, after.lamps, strict=True):
            same = next(each for each in after.lamps if each.name == _swapped(lamp.name))
            np.testing.assert_allclose(same.position_px[0], 320 - lamp.position_px[0], atol=0.5)
            assert other.is_rear == lamp.is_rear


def _swapped(name: str) -> str:
    return name.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")


def test_screens_and_signals_are_seen_where_they_are() -> None:
    surroundings = OPEN.model_copy(
        update={
            "panels": (Panel(side="right", s_m=70.0, screen_cd_m2=150.0),),
            "signals": (Signal(side="left", s_m=60.0),),
        }
    )
    dark = OPEN.model_copy(
        update={
            "panels": (Panel(side="right", s_m=70.0, screen_cd_m2=0.0),),
            "signals": (Signal(side="left", s_m=60.0, intensity_cd=0.0),),
        }
    )
    lit, unlit = (first_frame(scene(surroundings=each)).frame.image.astype(float) for each in (surroundings, dark))
    added = lit - unlit
    right, left = added[:, 160:], added[:, :160]
    assert (right > 60).sum() > 300  # a surface
    assert 1 <= (left > 60).sum() < 100  # a point
    assert lit.max() < 256


def test_a_data_set_with_traffic_is_read_back_and_driven_again_with_the_same_bytes(tmp_path: Path) -> None:
    small = {"camera": CameraSpec(width_px=160, height_px=120, focal_px=164.0)}
    drives = [
        scene(oncoming(70.0), oncoming(90.0, kind="semitrailer"), ahead(50.0, kind="bicycle"), seed=4, **small),
        mirrored(scene(oncoming(80.0, lane_number=1), ahead(60.0, lane_number=0), road=MOTORWAY, seed=5, **small)),
    ]
    for name in ("first", "second"):
        simulate_dataset(tmp_path / name, drives, _fast, DatasetConfig())
    files = sorted(path.relative_to(tmp_path / "first") for path in (tmp_path / "first").rglob("*") if path.is_file())
    for path in files:
        assert (tmp_path / "first" / path).read_bytes() == (tmp_path / "second" / path).read_bytes(), path
    truth = list(read_truth(tmp_path / "first" / "night" / "train"))
    kinds = [[vehicle.kind for vehicle in next(iter(drive.frames)).vehicles] for drive in truth]
    assert kinds == [["car", "semitrailer", "bicycle"], ["car", "car"]]
    assert len(list(PVDN(tmp_path / "first" / "night" / "train"))) == 4


def _fast(drive: Scene):  # type: ignore[no-untyped-def]
    return drive_frames(drive, "fast")
