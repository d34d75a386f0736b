from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foreglow.geometry import rotation_angles_rad
from foreglow.maps import GeographicOrigin, PoseTrack, read_poses

ORIGIN = GeographicOrigin(48.0, 9.0)
METRIC = """\
timestamp_s,x_m,y_m,z_m,qx,qy,qz,qw
1700000000.1,0,0,5,0,0,0,1
1700000000.2,2,0,6,0,0,0.70710678,0.70710678

1700000003.2,4,0,6,0,0,0.70710678,0.70710678
"""
EARTH = """\
timestamp_ns, lat_deg, lon_deg, heading_deg
0, 48.0, 9.0, 350
100000000, 48.0001, 9.0, 10
"""


def write(tmp_path: Path, text: str, name: str = "drive.csv") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_between_two_poses(tmp_path: Path) -> None:
    track = read_poses(write(tmp_path, METRIC))
    assert track.has_attitude
    assert track.times_ns[0] == 1_700_000_000_100_000_000  # exactly
    between = track.pose(1_700_000_000_150_000_000)
    assert between is not None
    np.testing.assert_allclose(between.position_m, [1.0, 0.0, 5.5])
    assert rotation_angles_rad(between.rotation) == pytest.approx((np.pi / 4, 0.0, 0.0), abs=1e-7)


def test_at_the_poses_themselves_and_outside(tmp_path: Path) -> None:
    track = read_poses(write(tmp_path, METRIC))
    for time_ns, position_m in zip(track.times_ns.tolist(), track.positions_m, strict=True):
        at = track.pose(time_ns)
        assert at is not None
        np.testing.assert_allclose(at.position_m, position_m)
    assert track.pose(1_700_000_000_099_999_999) is None
    assert track.pose(1_700_000_003_200_000_001) is None
    assert track.pose(1_700_000_002_000_000_000) is None  # in a gap of three seconds


def test_on_the_earth(tmp_path: Path) -> None:
    """Headings turn the short way, across north."""
    track = read_poses(write(tmp_path, EARTH), ORIGIN)
    assert not track.has_attitude
    between = track.pose(50_000_000)
    assert between is not None
    np.testing.assert_allclose(between.position_m, [0.0, 5.56, 0.0], atol=0.01)
    assert rotation_angles_rad(between.rotation)[0] == pytest.approx(np.pi / 2)


def test_on_the_earth_with_all_angles(tmp_path: Path) -> None:
    text = "timestamp_s,lat_deg,lon_deg,heading_deg,height_m,pitch_deg,roll_deg\n0,48,9,0,400,2,1\n1,48,9,0,402,2,1\n"
    track = read_poses(write(tmp_path, text), ORIGIN)
    assert track.has_attitude
    at = track.pose(500_000_000)
    assert at is not None
    assert at.position_m[2] == 401.0
    assert np.degrees(rotation_angles_rad(at.rotation)) == pytest.approx([90.0, 2.0, 1.0])


@pytest.mark.parametrize("given", ["height_m", "pitch_deg,roll_deg", "height_m,pitch_deg"])
def test_heights_and_angles_go_together(tmp_path: Path, given: str) -> None:
    """What there was of them changed nothing, and nobody was told."""
    more = ",1" * len(given.split(","))
    text = f"timestamp_s,lat_deg,lon_deg,heading_deg,{given}\n0,48,9,0{more}\n1,48,9,0{more}\n"
    with pytest.raises(ValueError, match=r"header: expected height_m, pitch_deg, roll_deg together, \w+ is missing"):
        read_poses(write(tmp_path, text), ORIGIN)


def test_tum(tmp_path: Path) -> None:
    text = "# t x y z qx qy qz qw\n0.5 1 2 3 0 0 0 1\n1.0 2 2 3 0 0 0 1 # end\n"
    at = read_poses(write(tmp_path, text, "drive.tum")).pose(750_000_000)
    assert at is not None
    assert at.position_m.tolist() == [1.5, 2.0, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("timestamp_s", "time", r"drive\.csv: header: expected one of the columns timestamp_ns, timestamp_s"),
        ("z_m", "height", "header: expected the columns timestamp_s, x_m, y_m, z_m, qx"),
        ("1700000000.2,2", "1700000000.2,two", "line 3: expected numbers: could not convert"),
        ("1700000000.2,2", "1700000000.2,2_0", "line 3: expected numbers: could not convert"),
        ("1700000000.2,2", "1700000000.2,\u0662", "line 3: expected numbers: could not convert"),
        ("1700000000.2,", "\u0661700000000.2,", "line 3: "),
        ("1700000000.2,2", "1700000000.2,nan", "line 3: x_m: expected a finite number, got nan"),
        ("1700000000.2,2", "1700000000.2", "line 3: expected 8 numbers, got 7"),
        ("1700000003.2", "1700000000.2", "line 5: timestamp_s: expected times that rise"),
        ("0,0,0,1\n", "0,0,0,2\n", r"line 2: qx, qy, qz, qw: expected a quaternion of length 1, got \[0"),
        (METRIC[METRIC.index("\n") + 1 :], "", "expected at least two poses, got 0"),
        ("1700000000.2,", "1e400,", "line 3: timestamp_s: expected a finite number, got inf"),
        ("1700000000.2,", "1e300,", "line 3: timestamp_s: expected a time, got '1e300'"),
        ("1700000000.2,2", "1700000000.2,1e11", r"x, y: expected up to 1e\+08 m from the origin, got 1e\+11"),
        (METRIC, "", "expected a header line, the file is empty"),
    ],
)
def test_errors(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in METRIC
    with pytest.raises(ValueError, match=message) as caught:
        read_poses(write(tmp_path, METRIC.replace(old, new, 1)))
    assert "drive.csv: " in str(caught.value)


@pytest.mark.parametrize(
    ("column", "value"),
    [("heading_deg", "40000"), ("pitch_deg", "89"), ("pitch_deg", "-31"), ("roll_deg", "180"), ("roll_deg", "-31")],
)
def test_angles_that_cannot_be(column: str, value: str, tmp_path: Path) -> None:
    columns = ("timestamp_s", "lat_deg", "lon_deg", "heading_deg", "height_m", "pitch_deg", "roll_deg")
    rows = [dict.fromkeys(columns, "1"), dict.fromkeys(columns, "2") | {column: value}]
    text = "\n".join([",".join(columns), *(",".join(row.values()) for row in rows), ""])
    with pytest.raises(ValueError, match=rf"drive\.csv: line 3: {column}: expected -\d+ to \d+ degrees.*, got {value}"):
        read_poses(write(tmp_path, text), GeographicOrigin(1.0, 1.0))


def in_tum(turns: Rotation, order: list[int]) -> str:
    """Poses of a car, their quaternions in another order of qx, qy, qz, qw."""
    return "".join(
        f"{time_s} 0 0 0 {' '.join(map(str, quaternion))}\n"
        for time_s, quaternion in enumerate(turns.as_quat()[:, order].tolist())
    )


LEVEL = Rotation.from_euler("ZYX", [[0.0, 0.0, 0.0], [20.0, -19.3, 3.0], [40.0, 3.0, -8.0]], degrees=True)
CAMERA_AXES = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.mark.parametrize(
    ("turns", "order"),
    [
        (LEVEL, [3, 0, 1, 2]),
        (LEVEL, [2, 1, 0, 3]),
        (LEVEL * CAMERA_AXES, [0, 1, 2, 3]),
        (LEVEL * Rotation.from_euler("X", 180.0, degrees=True), [0, 1, 2, 3]),
        (LEVEL * Rotation.from_euler("X", 90.0, degrees=True), [0, 1, 2, 3]),
        (LEVEL * Rotation.from_euler("Y", -50.0, degrees=True), [0, 1, 2, 3]),
    ],
)
def test_a_tilt_that_no_car_has_on_a_road(turns: Rotation, order: list[int], tmp_path: Path) -> None:
    """A quaternion in another order, or other axes, turned the road upside down or mirrored it."""
    assert read_poses(write(tmp_path, in_tum(LEVEL, [0, 1, 2, 3]), "level.tum")).has_attitude
    expected = (
        r"line \d: qx, qy, qz, qw: expected a car on a road, pitch and roll of at most 30 degrees, got .*x forward"
    )
    with pytest.raises(ValueError, match=rf"drive\.tum: {expected}"):
        read_poses(write(tmp_path, in_tum(turns, order), "drive.tum"))


def test_poses_and_map_must_be_of_one_kind(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"drive\.csv: expected poses with lat_deg, .*as the map is, got x_m"):
        read_poses(write(tmp_path, METRIC), ORIGIN)
    with pytest.raises(ValueError, match=r"drive\.csv: expected poses with x_m, .*as the map is, got lat_deg"):
        read_poses(write(tmp_path, EARTH))
    with pytest.raises(ValueError, match=r"line 2: expected a latitude of -90 to 90"):
        read_poses(write(tmp_path, EARTH.replace("48.0,", "98.0,")), ORIGIN)


def test_a_track_of_one_pose() -> None:
    with pytest.raises(ValueError, match="expected at least two poses, got 1"):
        PoseTrack(np.array([0]), np.zeros((1, 3)), Rotation.identity(1), has_attitude=True)
    with pytest.raises(ValueError, match="expected times that rise, pose 2 does not"):
        PoseTrack(np.array([5, 5]), np.zeros((2, 3)), Rotation.identity(2), has_attitude=True)


def test_the_time_is_linear_in_the_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No pose is made for each line, and no array."""
    calls = 0

    def counting(*args: Any, **keywords: Any) -> Rotation:
        nonlocal calls
        calls += 1
        return from_quat(*args, **keywords)

    from_quat = Rotation.from_quat
    monkeypatch.setattr("scipy.spatial.transform.Rotation.from_quat", counting)
    read_poses(write(tmp_path, "".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(1000)), "drive.tum"))
    assert calls == 1


def test_a_column_tells_what_the_production_system_reports(tmp_path: Path) -> None:
    text = "timestamp_s,x_m,y_m,z_m,qx,qy,qz,qw,reported\n1,0,0,0,0,0,0,1,0\n2,9,0,0,0,0,0,1,1\n9,99,0,0,0,0,0,1,0\n"
    track = read_poses(write(tmp_path, text))
    said = [track.is_reported(int(time_s * 1e9)) for time_s in (0.5, 1.0, 1.9, 2.0, 3.0, 3.1, 9.0)]
    assert said == [None, False, False, True, True, None, False]
    with pytest.raises(ValueError, match=r"drive.csv: line 3: reported: expected 0 or 1, got 2"):
        read_poses(write(tmp_path, text.replace("1,1", "1,2")))
