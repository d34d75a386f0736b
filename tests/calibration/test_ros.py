from __future__ import annotations

import re
from pathlib import Path

import pytest

from foreglow.calibration import ImageChoice, Mount, read_calibration, read_intrinsics

TEXT = """\
image_width: 1280
image_height: 960
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [1312.0, 0, 639.5, 0, 1310.5, 479.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.05, 0.02, 1e-05, 0, 0.001]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [1300.0, 0, 641.5, 0, 0, 1301.0, 478.5, 0, 0, 0, 1, 0]
"""
RATIONAL = TEXT.replace("plumb_bob", "rational_polynomial").replace("cols: 5", "cols: 8")


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "front.yaml"
    path.write_text(text)
    return path


def test_images_as_they_were_taken(tmp_path: Path) -> None:
    intrinsics = read_intrinsics(write(tmp_path, TEXT))
    assert (intrinsics.width_px, intrinsics.height_px) == (1280, 960)
    assert intrinsics.focal_px == (1312.0, 1310.5)
    assert intrinsics.centre_px == (640.0, 480.0)  # half a pixel more than in the file
    assert intrinsics.distortion == (-0.05, 0.02, 1e-5, 0.0, 0.001)


def test_rectified_images(tmp_path: Path) -> None:
    intrinsics = read_intrinsics(write(tmp_path, TEXT), ImageChoice(is_rectified=True))
    assert intrinsics.focal_px == (1300.0, 1301.0)
    assert intrinsics.centre_px == (642.0, 479.0)
    assert not any(intrinsics.distortion)


def test_a_mount_makes_a_camera(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    assert read_calibration(path, Mount(position_m=(2, 0, 1.3), yaw_deg=0, pitch_deg=0, roll_deg=0)).focal_px == (
        1312.0,
        1310.5,
    )
    with pytest.raises(ValueError, match=r"front\.yaml: mount: missing"):
        read_calibration(path)


def test_a_rational_model_without_its_own_terms(tmp_path: Path) -> None:
    text = RATIONAL.replace("0.001]", "0.001, 0, 0, 0]")
    assert read_intrinsics(write(tmp_path, text)).distortion == (-0.05, 0.02, 1e-5, 0.0, 0.001)


@pytest.mark.parametrize("terms", ["", "0.1, 0, 0, 0"])
def test_fewer_terms(tmp_path: Path, terms: str) -> None:
    given = [float(term) for term in terms.split(",") if term]
    text = TEXT.replace("-0.05, 0.02, 1e-05, 0, 0.001", terms).replace("cols: 5", f"cols: {len(given)}")
    expected = given or [0.0] * 4
    assert read_intrinsics(write(tmp_path, text)).distortion == (*expected, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image_width: 1280\n", "", r"front\.yaml: image_width: missing"),
        (
            "image_width: 1280",
            "image_width: 1280\nimage_width: 640",
            r"front\.yaml: .*each once, image_width comes twice",
        ),
        ("  rows: 3\n", "  rows: 3\n  cols: 4\n", r"front\.yaml: expected YAML: keys: .* cols comes twice"),
        ("image_width: 1280", "image_width: 0", r"image_width: .*greater than or equal to 1, got 0"),
        ("image_width: 1280", "image_width: 1280.5", r"image_width: .*integer"),
        ("[1312.0", "[.nan", r"camera_matrix\.data\.0: .*finite number, got nan"),
        ("639.5", ".inf", r"camera_matrix\.data\.2: .*finite number, got inf"),
        ("[1312.0", "[-1312.0", r"front\.yaml: camera_matrix: fx: expected a positive focal length, got -1312"),
        ("1310.5", "0", r"camera_matrix: fy: expected a positive focal length, got 0"),
        (
            "1310.5",
            "6.0",
            r"camera_matrix: expected focal lengths in pixels, for a field of view of at most 170",
        ),
        ("1310.5", "1e9", r"camera_matrix: fy: expected a focal length of 1 to 1e\+06 px, got 1e\+09"),
        (
            "1310.5",
            "1e300",
            r"camera_matrix\.data: expected numbers of at most 1e\+12, got \[1312\.0, 0, 639\.5, 0, '1e300'",
        ),
        ("639.5", "1e6", r"camera_matrix: cx, cy: expected a principal point at most 2560 px outside .* got \(1e\+06"),
        ("479.5", "-1e10", r"camera_matrix: cx, cy: expected a principal point .* got \(640, -1e\+10\)"),
        ("[-0.05", "[-3", r"distortion_coefficients: expected one that can be undone everywhere in the image, \[-3"),
        ("0.001]", "1e7]", r"distortion_coefficients: expected coefficients of at most 1e\+06, got \[-0\.05"),
        ("image_width: 1280", "image_width: 1048577", r"image_width: .*less than or equal to 1048576, got 1048577"),
        ("[1312.0", "[wide", r"camera_matrix\.data\.0: .*valid number, got 'wide'"),
        ("1312.0, ", "", r"camera_matrix: expected 3 rows, 3 columns and 9 numbers, got 3 rows, 3 columns and 8"),
        ("0, 0, 1]", "0, 0, 2]", r"camera_matrix: expected fx 0 cx"),
        ("plumb_bob", "equidistant", r"distortion_model: expected one of plumb_bob, .*got 'equidistant'; rectify"),
        ("0.001]", "0.001, 0.2]", r"distortion_coefficients: expected k1, k2, p1, p2, k3 and no further term but 0"),
        ("-0.05, 0.02, ", "", r"distortion_coefficients: expected 0, 4, 5 or more numbers, got 3"),
        (", 0.001]", "]", r"distortion_coefficients: expected as many numbers as rows and cols say, 1 x 5, got 4"),
        ("camera_name", "name", r"name: unknown, expected one of image_width"),
        ("[1312.0", "{", r"(?s)front\.yaml: expected YAML: .*line 7"),
        (TEXT, "just a text", r"front\.yaml: expected the fields image_width, .*got str"),
    ],
)
def test_errors_name_path_and_field(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(ValueError, match=message) as caught:
        read_intrinsics(write(tmp_path, TEXT.replace(old, new, 1)))
    assert "front.yaml" in str(caught.value)


def test_a_rational_model_with_terms_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no further term but 0"):
        read_intrinsics(write(tmp_path, RATIONAL.replace("0.001]", "0.001, 0, 0.1, 0]")))


MESSAGE = """\
header:
  stamp: {sec: 1, nanosec: 5}
  frame_id: front
height: 960
width: 1280
distortion_model: plumb_bob
d:
- -0.05
- 0.02
- 1.0e-05
- 0.0
- 0.001
k: [1312.0, 0, 639.5, 0, 1310.5, 479.5, 0, 0, 1]
r: [1, 0, 0, 0, 1, 0, 0, 0, 1]
p: [1300.0, 0, 641.5, 0, 0, 1301.0, 478.5, 0, 0, 0, 1, 0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""


@pytest.mark.parametrize("of_ros_1", [False, True])
@pytest.mark.parametrize("is_rectified", [False, True])
def test_a_message_as_ros2_topic_echo_prints_it(tmp_path: Path, of_ros_1: bool, is_rectified: bool) -> None:
    choice = ImageChoice(is_rectified=is_rectified)
    expected = read_intrinsics(write(tmp_path, TEXT), choice)
    text = re.sub("^[dkrp](?=:)", lambda name: name[0].upper(), MESSAGE, flags=re.MULTILINE) if of_ros_1 else MESSAGE
    assert read_intrinsics(write(tmp_path, text.replace("binning_x: 0", "binning_x: 1")), choice) == expected
    whole = text.replace("  height: 0\n  width: 0", "  height: 960\n  width: 1280")
    assert read_intrinsics(write(tmp_path, whole), choice) == expected


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("binning_y: 0", "binning_y: 2", r"binning_x, .*expected those of whole images, .* got 0, 2 and 0x0 px at"),
        ("  width: 0", "  width: 640", r"roi: expected those of whole images, .* got 0, 0 and 640x0 px at \(0, 0\)"),
        ("k: [1312.0, ", "k: [", "k: "),
        ("k: [1312.0, ", "k: [0, ", "k: |camera_matrix"),
        ("height: 960", "height: 0", "height: "),
        ("r: [", "K: []\nr: [", "K: "),
    ],
)
def test_a_message_that_cannot_be_used(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ValueError, match=rf"front\.yaml: .*(?:{message})"):
        read_intrinsics(write(tmp_path, MESSAGE.replace(old, new)))


def test_choices_that_the_file_does_not_have(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    with pytest.raises(ValueError, match="camera: expected 0, a ROS file has one camera, got 1"):
        read_intrinsics(path, ImageChoice(camera=1))
    with pytest.raises(ValueError, match="image_width, image_height: expected 640x480 px as asked for, got 1280x960"):
        read_intrinsics(path, ImageChoice(size_px=(640, 480)))
    without = write(tmp_path, TEXT[: TEXT.index("projection_matrix")])
    with pytest.raises(ValueError, match="projection_matrix: missing, rectified images need it"):
        read_intrinsics(without, ImageChoice(is_rectified=True))
