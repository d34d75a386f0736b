from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foreglow.calibration import calibration_to_toml
from foreglow.datasets.vehicle_data import Equipped
from foreglow.datasets.vehicle_logs import CanLog, VehicleFiles, open_vehicle_data, write_can_log
from foreglow.geometry import Camera, Pose
from foreglow.maps import PoseTrack
from foreglow.types import EgoMotion, Frame
from tests.datasets.vehicle_logs.messages import message
from tests.stand_ins import ListSource

CAMERA = Camera(1280, 960, (1300.0, 1300.0), (640.0, 480.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
SECOND = 1_000_000_000


def frame(time_s: float = 0.0, width_px: int = 1280, height_px: int = 960) -> Frame:
    return Frame(np.zeros((height_px, width_px), np.uint8), timestamp_ns=round(time_s * SECOND))


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "camera.toml"
    path.write_text(calibration_to_toml(CAMERA))
    return path


@pytest.fixture
def can_log(tmp_path: Path) -> Path:
    """A street message and a motion every 100 ms for ten seconds."""
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    path = tmp_path / "drive.log"
    times_ns = range(0, 10 * SECOND, SECOND // 10)
    write_can_log(path, [(t, message()) for t in times_ns], [(t, EgoMotion(12.0, 0.1)) for t in times_ns])
    return path


@pytest.fixture
def road_map(tmp_path: Path) -> Path:
    """A road of 746 m to the east."""
    path = tmp_path / "town.geojson"
    path.write_text(json.dumps({"type": "LineString", "coordinates": [[9.0, 48.0], [9.01, 48.0]]}))
    return path


def poses_at(tmp_path: Path, latitude_deg: float = 47.999985) -> Path:
    """Ten seconds to the east at 7.46 m/s, at first 1.67 m to the right of the road's beginning."""
    path = tmp_path / "drive.csv"
    rows = [f"{k},{latitude_deg},{9 + k * 0.0001},90" for k in range(11)]
    path.write_text("\n".join(["timestamp_s,lat_deg,lon_deg,heading_deg", *rows]))
    return path


def test_a_camera_of_the_frames_size(calibration: Path) -> None:
    data = open_vehicle_data(calibration)
    same, half = data.camera(frame()), data.camera(frame(0.0, 640, 480))
    assert same is not None
    assert same.focal_px == (1300.0, 1300.0)
    assert half is not None
    assert (half.width_px, half.height_px, half.focal_px) == (640, 480, (650.0, 650.0))
    assert data.motion(frame()) is None
    assert data.road(frame()) is None


def test_a_camera_of_another_shape(calibration: Path) -> None:
    data = open_vehicle_data(calibration)
    with pytest.raises(ValueError, match=r"camera\.toml: image: expected .* 1280x720 px, got 1280x960 px"):
        data.camera(frame(0.0, 1280, 720))


def test_motion_and_road_of_a_log(can_log: Path) -> None:
    data = open_vehicle_data(can_log=can_log)
    motion, road = data.motion(frame(5.0)), data.road(frame(5.0))
    assert motion is not None
    assert motion.speed_mps == 12.0
    assert road is not None
    assert (len(road), road.error_bound_m) == (241, 5.0)
    assert data.camera(frame()) is None
    assert data.road(frame(20.0)) is None


def test_the_car_drives_on_from_the_position_of_the_latest_message() -> None:
    """At 20 m/s and two messages a second the road would lie up to 10 m too far ahead."""
    log, no_speed = CanLog(), CanLog()
    for each in (log, no_speed):
        each.add_street(0, message(remaining_length_m=40))
    for time_s in (0.0, 0.4):
        log.add_number("speed", round(time_s * SECOND), 20.0)
        log.add_number("yaw_rate", round(time_s * SECOND), 0.0)
    own = dataclasses.replace(frame(0.5), motion=EgoMotion(30.0, 0.0))
    roads = [
        data.road(each)
        for data, each in (
            (VehicleFiles(log=log), frame(0.0)),
            (VehicleFiles(log=log), frame(0.5)),
            (VehicleFiles(log=no_speed), frame(0.5)),
            (VehicleFiles(log=no_speed), own),
        )
    ]
    assert [road and round(road.points_m[-1, 0]) for road in roads] == [240, 230, 240, 225]


def test_frames_carry_the_reports_of_the_production_system() -> None:
    log = CanLog()
    log.add_number("production", 2_000_000_000, 1.0)
    before, after = Equipped(ListSource([frame(1.9), frame(2.1)]), VehicleFiles(log=log))
    assert (before.is_reported, after.is_reported) == (None, True)


def test_the_offset_between_the_clocks(can_log: Path) -> None:
    data = open_vehicle_data(can_log=can_log, time_offset_s=100.0)
    assert data.motion(frame(105.0)) is not None
    assert data.motion(frame(5.0)) is None
    with pytest.raises(ValueError, match=r"drive\.log: time: expected .*from 0\.000 to 9\.900 s and a frame at 16999"):
        data.motion(frame(1.7e9))


def test_the_road_of_a_map(tmp_path: Path, road_map: Path) -> None:
    data = open_vehicle_data(road_map=road_map, poses=poses_at(tmp_path), pose_error_m=2.0)
    road = data.road(frame(5.5))
    assert road is not None
    assert road.points_m[0].tolist() == pytest.approx([0.0, 1.67, 0.0], abs=0.01)
    assert (len(road), road.error_bound_m) == (401, 2.0)
    assert data.road(frame(10.5)) is None
    with pytest.raises(ValueError, match=r"drive\.csv: time: expected data of the frames' time"):
        data.road(frame(1.7e9))


def test_the_map_goes_before_the_log(tmp_path: Path, road_map: Path, can_log: Path) -> None:
    poses = poses_at(tmp_path)
    data = open_vehicle_data(can_log=can_log, road_map=road_map, poses=poses, pose_error_m=np.inf)
    by_map, by_log = data.road(frame(5.0)), data.road(frame(10.4))
    assert by_map is not None
    assert by_map.error_bound_m == np.inf
    assert by_log is not None
    assert by_log.error_bound_m == 5.0


def test_a_log_of_the_speed_that_has_fallen_silent_is_not_replaced_by_a_motion_of_the_source(can_log: Path) -> None:
    own = EgoMotion(25.0, 0.0)
    frames = [dataclasses.replace(frame(time_s), motion=own) for time_s in (5.0, 11.0)]
    before, after = Equipped(ListSource(frames), open_vehicle_data(can_log=can_log))
    assert before.motion is not None
    assert before.motion.speed_mps == 12.0
    assert after.motion is None
    of_reports = CanLog()
    of_reports.add_number("production", 0, 1.0)
    kept = list(Equipped(ListSource(frames), VehicleFiles(log=of_reports)))
    assert [each.motion for each in kept] == [own, own]


def test_frames_carry_it(calibration: Path, can_log: Path) -> None:
    (equipped,) = Equipped(ListSource([frame(1.0)]), open_vehicle_data(calibration, can_log))
    assert equipped.camera is not None
    assert equipped.motion is not None
    assert equipped.road is not None


def test_nothing_known_is_nothing() -> None:
    data = VehicleFiles()
    assert (data.camera(frame()), data.motion(frame()), data.road(frame())) == (None, None, None)


def test_combinations_that_make_no_sense(tmp_path: Path, road_map: Path, calibration: Path) -> None:
    poses = poses_at(tmp_path)
    with pytest.raises(ValueError, match="expected a calibration, a CAN log, or a map with poses, got none"):
        open_vehicle_data()
    with pytest.raises(ValueError, match=r"a\.dbc: expected a CAN log with it, got none"):
        open_vehicle_data(calibration, dbc=tmp_path / "a.dbc")
    with pytest.raises(ValueError, match=r"a\.toml: expected a CAN log with it, got none"):
        open_vehicle_data(mapping=tmp_path / "a.toml")
    with pytest.raises(ValueError, match=r"town\.geojson: expected poses on it, got none"):
        open_vehicle_data(road_map=road_map)
    with pytest.raises(ValueError, match=r"drive\.csv: expected a map with them, got none"):
        open_vehicle_data(poses=poses)
    with pytest.raises(ValueError, match="time offset: expected a finite number of seconds, got nan"):
        open_vehicle_data(calibration, time_offset_s=np.nan)
    with pytest.raises(ValueError, match="pose error: expected a number of metres of at least 0, got -1"):
        open_vehicle_data(calibration, pose_error_m=-1)


def test_poses_beside_the_map(tmp_path: Path, road_map: Path) -> None:
    poses = poses_at(tmp_path, latitude_deg=48.01)
    with pytest.raises(ValueError, match=r"drive\.csv: expected poses along the roads of .*town\.geojson.* 1112 m"):
        open_vehicle_data(road_map=road_map, poses=poses)


def test_poses_that_head_across_the_road_or_are_at_another_height(tmp_path: Path, road_map: Path) -> None:
    poses = poses_at(tmp_path)
    poses.write_text(poses.read_text().replace(",90\n", ",0\n").removesuffix("90") + "0")
    across = (
        r"drive\.csv: expected poses along the roads of .*town\.geojson; none is, those .* across it, by more than 60"
    )
    with pytest.raises(ValueError, match=across):
        open_vehicle_data(road_map=road_map, poses=poses)
    road_map.write_text(json.dumps({"type": "LineString", "coordinates": [[9.0, 48.0, 411.0], [9.01, 48.0, 411.0]]}))
    rows = [f"{k},47.999985,{9 + k * 0.0001},90,459,0,0" for k in range(11)]
    poses.write_text("\n".join(["timestamp_s,lat_deg,lon_deg,heading_deg,height_m,pitch_deg,roll_deg", *rows]))
    with pytest.raises(
        ValueError, match="with heights of one kind; none is, those near a road are more than 5 m above"
    ):
        open_vehicle_data(road_map=road_map, poses=poses)


def test_poses_at_the_height_of_an_antenna(tmp_path: Path, road_map: Path) -> None:
    road_map.write_text(json.dumps({"type": "LineString", "coordinates": [[9.0, 48.0, 411.0], [9.01, 48.0, 411.0]]}))

    def opened(height_m: float) -> VehicleFiles:
        rows = [f"{k},47.999985,{9 + k * 0.0001},90,{height_m},0,0" for k in range(11)]
        poses = tmp_path / "drive.csv"
        poses.write_text("\n".join(["timestamp_s,lat_deg,lon_deg,heading_deg,height_m,pitch_deg,roll_deg", *rows]))
        return open_vehicle_data(road_map=road_map, poses=poses)

    assert opened(411.9).road(frame(5.5)) is not None
    for height_m, words in ((412.6, "1.6 m above"), (408.0, "3.0 m below")):
        with pytest.raises(ValueError, match=rf"drive\.csv: .*on the road.*{words} the roads of .*antenna"):
            opened(height_m)


def test_reports_of_the_poses_come_with_the_frames() -> None:
    rotations = Rotation.from_matrix(np.stack([np.eye(3)] * 2))
    times_ns, reports = np.array([0, SECOND]), np.array([False, True])
    poses = PoseTrack(times_ns, np.zeros((2, 3)), rotations, has_attitude=True, reports=reports)
    equipped = Equipped(ListSource([frame(0.5), frame(1.0)]), VehicleFiles(poses=poses))
    assert [seen.is_reported for seen in equipped] == [False, True]


def test_files_go_to_other_processes_also_after_they_were_used(calibration: Path, can_log: Path) -> None:
    data = open_vehicle_data(calibration, can_log)
    now = frame(1.05)
    known, road = data.motion(now), data.road(now)
    assert data.camera(now) is not None
    again = pickle.loads(pickle.dumps(data))
    assert again.camera(now).focal_px == CAMERA.focal_px
    assert again.camera(now) is again.camera(frame(1.1))
    assert known is not None
    assert road is not None
    assert again.motion(now).speed_mps == known.speed_mps
    assert len(again.road(now)) == len(road)
