from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.calibration import ImageChoice, Mount, read_calibration, read_intrinsics

MOUNT = Mount(position_m=(1.6, 0.06, 1.65), yaw_deg=0.0, pitch_deg=-1.0, roll_deg=0.0)

CAM_TO_CAM = """\
calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.95e-02
S_00: 1.392000e+03 5.120000e+02
K_00: 9.842e+02 0.0 6.900e+02 0.0 9.808e+02 2.331e+02 0.0 0.0 1.0
D_00: -3.728e-01 2.037e-01 2.219e-03 1.383e-03 -7.233e-02
S_rect_00: 1.242e+03 3.75e+02
P_rect_00: 7.215e+02 0.0 6.095e+02 0.0 0.0 7.215e+02 1.728e+02 0.0 0.0 0.0 1.0 0.0
S_02: 1.392e+03 5.12e+02
K_02: 9.597e+02 0.0 6.960e+02 0.0 9.569e+02 2.241e+02 0.0 0.0 1.0
D_02: -3.691e-01 1.968e-01 1.353e-03 5.677e-04 -6.770e-02
S_rect_02: 1.242e+03 3.75e+02
P_rect_02: 7.215e+02 0.0 6.095e+02 4.485e+01 0.0 7.215e+02 1.728e+02 2.163e-01 0.0 0.0 1.0 2.745e-03
"""

ODOMETRY = """\
P0: 718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0
P1: 718.856 0 607.1928 -386.1448 0 718.856 185.2157 0 0 0 1 0
Tr: 1 0 0 0 0 1 0 0 0 0 1 0
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "calib.txt"
    path.write_text(text)
    return path


def test_images_as_they_were_taken(tmp_path: Path) -> None:
    intrinsics = read_intrinsics(write(tmp_path, CAM_TO_CAM), ImageChoice(camera=2))
    assert (intrinsics.width_px, intrinsics.height_px) == (1392, 512)
    assert intrinsics.focal_px == (959.7, 956.9)
    assert intrinsics.centre_px == (696.5, 224.6)  # half a pixel more than in the file
    assert intrinsics.distortion == (-0.3691, 0.1968, 0.001353, 0.0005677, -0.0677)


def test_rectified_images(tmp_path: Path) -> None:
    intrinsics = read_intrinsics(write(tmp_path, CAM_TO_CAM), ImageChoice(camera=2, is_rectified=True))
    assert (intrinsics.width_px, intrinsics.height_px) == (1242, 375)
    assert intrinsics.focal_px == (721.5, 721.5)
    assert intrinsics.centre_px == (610.0, 173.3)
    assert not any(intrinsics.distortion)


def test_the_odometry_set_needs_a_size(tmp_path: Path) -> None:
    path = write(tmp_path, ODOMETRY)
    intrinsics = read_intrinsics(path, ImageChoice(camera=1, size_px=(1241, 376)))
    assert (intrinsics.width_px, intrinsics.height_px) == (1241, 376)
    assert intrinsics.centre_px == (607.6928, 185.7157)
    with pytest.raises(ValueError, match=r"calib\.txt: size: missing, .*give the images' size"):
        read_intrinsics(path)


def test_a_mount_is_needed(tmp_path: Path) -> None:
    path = write(tmp_path, CAM_TO_CAM)
    assert read_calibration(path, MOUNT).vehicle_from_camera.position_m.tolist() == [1.6, 0.06, 1.65]
    with pytest.raises(ValueError, match=r"calib\.txt: mount: missing, .*calibrate convert"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("K_00: 9.842e+02", "K_00: nan", r"calib\.txt: K_00: expected finite numbers, got nan"),
        ("K_00: 9.842e+02", "K_00: inf", "K_00: expected finite numbers, got inf"),
        ("K_00: 9.842e+02", "K_00: -984", "K_00: fx: expected a positive focal length, got -984"),
        ("K_00: 9.842e+02", "K_00: f", "K_00: expected 9 numbers: could not convert"),
        ("K_00: 9.842e+02", "K_00:", "K_00: expected 9 numbers, got 8"),
        ("K_00: 9.842e+02 0.0", "K_00: 984 0.1", r"K_00: expected fx 0 cx, 0 fy cy, 0 0 1, got \[\[984"),
        ("D_00: -3.728e-01", "D_00:", "D_00: expected 5 numbers, got 4"),
        ("S_00: 1.392000e+03", "S_00: 1392.5", r"S_00: expected a width and a height in whole pixels, got 1392\.5"),
        ("S_00: 1.392000e+03", "S_00: -1392", "S_00: expected a width and a height"),
        ("6.900e+02", "1e20", r"K_00: cx, cy: expected a principal point .* got \(1e\+20, "),
        ("D_00: -3.728e-01", "D_00: -3", r"D_00: expected one that can be undone everywhere in the image, \[-3\.0, "),
        ("D_00: -3.728e-01", "D_00: 1e7", r"D_00: expected coefficients of at most 1e\+06, got \[10000000\.0"),
        ("S_00: 1.392000e+03", "S_00: 1e300", "S_00: expected a width and a height of at most 1048576 px"),
        ("D_00:", "K_00: 1\nD_00:", r"calib\.txt: entries: expected each once, K_00 comes twice"),
        ("K_00:", "K:", r"K_00: missing, the file's entries are: calib_time, corner_dist, S_00"),
    ],
)
def test_errors_name_path_and_field(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in CAM_TO_CAM
    with pytest.raises(ValueError, match=message):
        read_intrinsics(write(tmp_path, CAM_TO_CAM.replace(old, new, 1)))


def test_another_size_than_asked_for(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"S_00: expected 1242x375 px as asked for, got 1392x512"):
        read_intrinsics(write(tmp_path, CAM_TO_CAM), ImageChoice(size_px=(1242, 375)))


@pytest.mark.parametrize("text", ["", "no calibration at all\n", "\n\n"])
def test_a_file_of_something_else(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"calib\.txt: S_00: missing, the file's entries are: none"):
        read_intrinsics(write(tmp_path, text))


def test_entries_without_a_colon_are_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="entries are: none, expected lines such as `P0: numbers`"):
        read_intrinsics(write(tmp_path, ODOMETRY.replace(":", "")), ImageChoice(size_px=(1241, 376)))


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_bytes(b"\x89PNG\xff")
    with pytest.raises(ValueError, match=r"calib\.txt: expected UTF-8 text"):
        read_intrinsics(path)


def test_an_ending_that_nobody_reads(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"camera\.xml: expected a calibration that ends in \.toml, \.txt, \.yaml"):
        read_intrinsics(tmp_path / "camera.xml")
