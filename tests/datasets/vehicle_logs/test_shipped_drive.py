"""The drive that ships, written as a user's files and read back, against what the simulator knows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import shipped_drive
from foreglow.datasets.simulated import SequenceTruth, read_truth
from foreglow.datasets.vehicle_logs import open_vehicle_data, read_can_log, write_can_log
from foreglow.geometry import Floats, rotation_angles_rad
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.scene_files import scene_of
from foreglow.lab.simulation.writing.street_data import road_ahead
from foreglow.maps import GeographicOrigin
from foreglow.types import EgoMotion, Frame

ORIGIN = GeographicOrigin(48.0, 9.0)
MS = 1_000_000


@pytest.fixture(scope="module")
def drive() -> SequenceTruth:
    (only,) = read_truth(shipped_drive())
    return only


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log"])
def test_its_messages_as_a_can_log(drive: SequenceTruth, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    path = tmp_path / f"drive{suffix}"
    motions = [EgoMotion(frame.ego_speed_mps, frame.ego_yaw_rate_radps) for frame in drive.frames]
    times_ns = [frame.timestamp_ns for frame in drive.frames]
    write_can_log(
        path,
        list(zip(times_ns, [frame.street for frame in drive.frames], strict=True)),
        list(zip(times_ns, motions, strict=True)),
    )
    log = read_can_log(path)
    assert [log.street(time_ns + MS) for time_ns in times_ns] == [frame.street for frame in drive.frames]
    for time_ns, motion in zip(times_ns, motions, strict=True):
        back = log.motion(time_ns + MS)
        assert back is not None
        assert back.speed_mps == pytest.approx(motion.speed_mps, abs=0.0051)
        assert back.yaw_rate_radps == pytest.approx(motion.yaw_rate_radps, abs=0.000051)


@pytest.mark.slow
def test_its_road_as_a_map(drive: SequenceTruth, tmp_path: Path) -> None:
    """Full poses find the road to a centimetre; a heading alone leaves out the body's pitch and the road's crown."""
    geojson, full, level = tmp_path / "road.geojson", tmp_path / "full.csv", tmp_path / "level.csv"
    points = np.array(json.loads((drive.root / "road.json").read_text())["points_world_m"])
    places = np.column_stack([_degrees(points)[:, ::-1], points[:, 2]])
    geojson.write_text(json.dumps({"type": "LineString", "coordinates": places.tolist()}))
    full.write_text("\n".join(_poses(drive)))
    level.write_text("\n".join(",".join(row.split(",")[:4]) for row in _poses(drive)))
    assert max(_errors_m(drive, geojson, full)) < 0.01
    assert np.median(_errors_m(drive, geojson, level)) < 1.0
    assert max(_errors_m(drive, geojson, level)) < 4.0


def _errors_m(drive: SequenceTruth, geojson: Path, poses: Path) -> list[float]:
    """The largest error of the road within 200 m, of each frame."""
    data, true_road = open_vehicle_data(road_map=geojson, poses=poses), Road(scene_of(drive).road)
    errors_m = []
    for known in drive.frames:
        road = data.road(Frame(np.zeros((64, 64), np.uint8), known.timestamp_ns))
        assert road is not None
        true = road_ahead(true_road, known.ego_s_m, known.ego_pose)[:200]
        away = road.points_m[:200] - true[: len(road)]
        errors_m.append(float(np.linalg.norm(away, axis=1).max()))
    return errors_m


def _poses(drive: SequenceTruth) -> list[str]:
    """The true poses as lines of CSV."""
    degrees = _degrees(np.array([frame.ego_pose.position_m for frame in drive.frames]))
    rows = ["timestamp_ns,lat_deg,lon_deg,heading_deg,height_m,pitch_deg,roll_deg"]
    for frame, (latitude, longitude) in zip(drive.frames, degrees.tolist(), strict=True):
        yaw, pitch, roll = np.degrees(rotation_angles_rad(frame.ego_pose.rotation)).tolist()
        # Its own north is not quite the map's.
        heading = 90.0 - yaw + float(np.degrees(ORIGIN.yaw_rad(latitude, longitude, 90.0 - yaw))) - yaw
        height_m = float(frame.ego_pose.position_m[2])
        rows.append(",".join(map(repr, (frame.timestamp_ns, latitude, longitude, heading, height_m, pitch, roll))))
    return rows


def _degrees(points_m: Floats) -> Floats:
    """Latitudes and longitudes, shape (N, 2), of places around the origin: `GeographicOrigin.local` undone."""
    degrees = np.tile([ORIGIN.latitude_deg, ORIGIN.longitude_deg], (len(points_m), 1))
    for _ in range(6):
        missing_m = points_m[:, :2] - ORIGIN.local(degrees[:, 0], degrees[:, 1])
        degrees += missing_m[:, ::-1] / [111_200.0, 74_600.0]
    return degrees
