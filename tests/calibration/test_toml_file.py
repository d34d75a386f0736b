from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.calibration import ImageChoice, Mount, calibration_to_toml, read_calibration, read_intrinsics
from foreglow.geometry import Camera, MountSigmas, Pose, rotation, rotation_angles_rad

TEXT = """\
[image]
width_px = 1280
height_px = 960

[intrinsics]
focal_px = [
    1312.0,
    1310.5,
]
centre_px = [
    640.25,
    480.0,
]
distortion = [
    -0.05,
    0.02,
    0.001,
    0.0,
    0.0,
]

[mount]
position_m = [
    1.9,
    0.1,
    1.3,
]
yaw_deg = 0.25
pitch_deg = -0.7
roll_deg = 1.1
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "camera.toml"
    path.write_text(text)
    return path


def test_a_file_comes_back_as_it_is(tmp_path: Path) -> None:
    camera = read_calibration(write(tmp_path, TEXT))
    assert (camera.width_px, camera.height_px) == (1280, 960)
    assert camera.focal_px == (1312.0, 1310.5)
    assert camera.distortion == (-0.05, 0.02, 0.001, 0.0, 0.0)
    assert camera.vehicle_from_camera.position_m.tolist() == [1.9, 0.1, 1.3]
    assert calibration_to_toml(camera) == TEXT
    assert camera.mount_sigmas == MountSigmas()


def test_standard_deviations_come_back_as_they_are(tmp_path: Path) -> None:
    text = TEXT + "yaw_sigma_deg = 0.2\npitch_sigma_deg = 0.15\nheight_sigma_m = 0.02\n"
    camera = read_calibration(write(tmp_path, text))
    yaw_rad, pitch_rad = np.radians([0.2, 0.15]).tolist()
    assert camera.mount_sigmas == MountSigmas(yaw_rad, pitch_rad, 0.0, 0.02)
    assert camera.scaled(640, 480).mount_sigmas == camera.mount_sigmas
    assert calibration_to_toml(camera) == text
    with pytest.raises(ValueError, match=r"camera.toml: mount.pitch_sigma_deg: "):
        read_calibration(write(tmp_path, TEXT + "pitch_sigma_deg = -0.1\n"))


@pytest.mark.parametrize("position_m", [[2.0, 0.0, -1.3], [2.0, 0.0, 0.0], [2.0, 0.0, 100.0], [1e6, 0.0, 1.3]])
def test_a_mount_is_on_a_vehicle_and_above_the_road(tmp_path: Path, position_m: list[float]) -> None:
    text = TEXT.partition("[mount]")[0] + f"[mount]\nposition_m = {position_m}\n"
    with pytest.raises(ValueError, match=r"mount\.position_m"):
        read_calibration(write(tmp_path, text))


def test_angles_are_what_they_say(tmp_path: Path) -> None:
    text = TEXT.replace("yaw_deg = 0.25", "yaw_deg = 45.0").replace("-0.7", "30.0").replace("1.1", "0.0")
    forward, _, up = read_calibration(write(tmp_path, text)).vehicle_from_camera.rotation.T
    np.testing.assert_allclose(forward, [np.sqrt(0.375), np.sqrt(0.375), 0.5], atol=1e-12)
    np.testing.assert_allclose(up, [-np.sqrt(0.125), -np.sqrt(0.125), np.sqrt(0.75)], atol=1e-12)


def test_what_may_be_left_out(tmp_path: Path) -> None:
    text = "[image]\nwidth_px=64\nheight_px=48\n[intrinsics]\nfocal_px=[60,60]\ncentre_px=[32,24]\n"
    camera = read_calibration(
        write(tmp_path, text + "[mount]\nposition_m=[1,0,1]\nyaw_deg=0\npitch_deg=0\nroll_deg=0\n")
    )
    assert camera.distortion == (0, 0, 0, 0, 0)
    np.testing.assert_array_equal(camera.vehicle_from_camera.rotation, np.eye(3))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("width_px = 1280", "", r"camera\.toml: image\.width_px: missing"),
        ("[mount]", "[mounted]", r"camera\.toml: mount: missing"),
        ("width_px = 1280", "width_px = 0", r"image\.width_px: .*greater than or equal to 1, got 0"),
        ("width_px = 1280", "width_px = 1280.5", r"image\.width_px: .*integer"),
        ("1312.0", "-1312.0", r"intrinsics\.focal_px\.0: .*greater than or equal to 1, got -1312"),
        ("1312.0", "1e-300", r"intrinsics\.focal_px\.0: .*greater than or equal to 1, got 1e-300"),
        ("1312.0", "1e300", r"intrinsics\.focal_px\.0: .*less than or equal to 1000000, got 1e\+300"),
        ("1312.0", "6.0", r"intrinsics\.focal_px: expected focal lengths in pixels, .* got 6 px, 178\.9 degrees"),
        ("1312.0", "nan", r"intrinsics\.focal_px\.0: .*finite number, got nan"),
        ("640.25", "inf", r"intrinsics\.centre_px\.0: .*finite number, got inf"),
        (
            "640.25",
            "1e6",
            r"camera\.toml: intrinsics\.centre_px: expected a principal point at most 2560 px outside the image of "
            r"1280x960 px, got \(1e\+06, 480\)",
        ),
        ("480.0,", "-2561.0,", r"intrinsics\.centre_px: expected .* got \(640\.25, -2561\)"),
        ("-0.05", "-3.0", r"intrinsics\.distortion: expected one that can be undone .* at pixel \(0, 0\)"),
        ("-0.05", "-1e7", r"intrinsics\.distortion\.0: .*greater than or equal to -1000000, got -10000000\.0"),
        ("width_px = 1280", "width_px = 1048577", r"image\.width_px: .*less than or equal to 1048576, got 1048577"),
        ("1312.0", '"1312"', r"intrinsics\.focal_px\.0: .*valid number, got '1312'"),
        ("    1310.5,\n", "", r"intrinsics\.focal_px\.1: expected one more value, got \[1312.0\]"),
        ("pitch_deg = -0.7", "pitch_deg = -46", r"mount\.pitch_deg: .*-45, got -46"),
        ("yaw_deg = 0.25", "yaw_deg = 180", r"mount\.yaw_deg: .*45, got 180"),
        ("roll_deg = 1.1", "roll_deg = 179", r"mount\.roll_deg: .*45, got 179"),
        ("yaw_deg = 0.25", "", r"camera\.toml: mount\.yaw_deg: missing"),
        ("pitch_deg = -0.7", "", r"camera\.toml: mount\.pitch_deg: missing"),
        ("roll_deg = 1.1", "", r"camera\.toml: mount\.roll_deg: missing"),
        (
            "roll_deg = 1.1",
            "roll_deg = 1.1\nrol_deg = 1.1",
            r"mount\.rol_deg: unknown, expected one of position_m, yaw_deg, pitch_deg, roll_deg",
        ),
        ("[mount]", "[mount", r"camera\.toml: expected TOML"),
    ],
)
def test_errors_name_path_and_field(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(ValueError, match=message):
        read_calibration(write(tmp_path, TEXT.replace(old, new, 1)))


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_calibration(tmp_path / "nowhere.toml")


TURNS = st.integers(-44_999, 45_000).map(lambda thousandths: thousandths / 1000)


@pytest.mark.slow
@settings(derandomize=True, max_examples=60)
@given(st.tuples(TURNS, TURNS, TURNS), st.floats(3, 1e4), st.floats(-1e3, 1e3))
def test_any_camera_comes_back(
    tmp_path_factory: pytest.TempPathFactory, angles_deg: tuple[float, float, float], focal: float, number: float
) -> None:
    yaw, pitch, roll = angles_deg
    turned = rotation(*np.radians([yaw, pitch, roll]))
    camera = Camera(
        7,
        5,
        (focal, focal / 3),
        (number / 80, 1 / 3),
        (number / 1e12, 1e-9, 0, 0, 0),
        Pose(np.array([number / 40, 0.1, 1 / 7]), turned),
    )
    path = write(tmp_path_factory.mktemp("any"), calibration_to_toml(camera))
    back = read_calibration(path)
    assert (back.focal_px, back.centre_px, back.distortion) == (camera.focal_px, camera.centre_px, camera.distortion)
    np.testing.assert_array_equal(back.vehicle_from_camera.position_m, camera.vehicle_from_camera.position_m)
    np.testing.assert_allclose(back.vehicle_from_camera.rotation, turned, atol=1e-13)
    assert calibration_to_toml(back) == path.read_text()


@pytest.mark.parametrize("pitch_deg", [-90.0, 90.0])
def test_a_camera_that_looks_straight_down_or_up(pitch_deg: float) -> None:
    turned = rotation(*np.radians([30.0, pitch_deg, 20.0]))
    np.testing.assert_allclose(rotation(*rotation_angles_rad(turned)), turned, atol=1e-12)


def test_another_mount_than_the_files(tmp_path: Path) -> None:
    camera = read_calibration(write(tmp_path, TEXT), Mount(position_m=(0, 0, 2), yaw_deg=0, pitch_deg=0, roll_deg=0))
    assert camera.vehicle_from_camera.position_m.tolist() == [0, 0, 2]
    assert camera.focal_px == (1312.0, 1310.5)


def test_a_camera_without_a_mount(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT[: TEXT.index("[mount]")])
    assert read_intrinsics(path).focal_px == (1312.0, 1310.5)
    with pytest.raises(ValueError, match="mount: missing"):
        read_calibration(path)


def test_choices_that_a_toml_file_does_not_have(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    with pytest.raises(ValueError, match=r"camera\.toml: camera: expected no choice"):
        read_intrinsics(path, ImageChoice(is_rectified=True))
    with pytest.raises(ValueError, match=r"camera\.toml: image: expected 640x480 px as asked for, got 1280x960"):
        read_intrinsics(path, ImageChoice(size_px=(640, 480)))
