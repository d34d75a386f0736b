from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.display.calibration_check import (
    HORIZON_BGR,
    LANE_BGR,
    VANISHING_BGR,
    CameraFigures,
    check_lines,
    draw_check,
    warnings_of,
    write_check,
)
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.types import Image

LEVEL = Camera(1280, 960, (1300.0, 1300.0), (640.0, 480.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))


def turned(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0, height_m: float = 1.3) -> Camera:
    pose = Pose(np.array([1.9, 0.0, height_m]), rotation(*np.radians([yaw_deg, pitch_deg, roll_deg])))
    return dataclasses.replace(LEVEL, vehicle_from_camera=pose)


def dark(width_px: int = 1280, height_px: int = 960) -> Image:
    return np.full((height_px, width_px), 20, np.uint8)


@pytest.mark.parametrize("yaw_deg", [90.0, 180.0])
def test_a_camera_that_looks_elsewhere(yaw_deg: float) -> None:
    """The words were of a column nan."""
    lines = check_lines(turned(yaw_deg))
    assert "vanishing at   no pixel in or near the image" in lines
    assert "warning: the camera does not look along the drive, which is behind it or far outside the image" in lines
    assert not any("nan" in line for line in lines)


def test_figures_of_a_level_camera() -> None:
    figures = CameraFigures.of(LEVEL)
    assert figures.vanishing_px == pytest.approx((640.0, 480.0))
    assert figures.horizontal_fov_deg == pytest.approx(2 * np.degrees(np.arctan(640 / 1300)))
    assert figures.vertical_fov_deg == pytest.approx(2 * np.degrees(np.arctan(480 / 1300)))
    # Row r below the horizon sees h f / r: at 50 m that is row 33.8.
    row = 1300 * 1.3 / 50
    assert figures.row_m[0] == pytest.approx(1300 * 1.3 * (1 / (row - 0.5) - 1 / (row + 0.5)))
    assert warnings_of(LEVEL) == []


def test_a_pitch_moves_the_vanishing_point() -> None:
    figures = CameraFigures.of(turned(pitch_deg=-2.0))
    assert figures.pitch_deg == pytest.approx(-2.0)
    assert figures.vanishing_px == pytest.approx((640.0, 480 - 1300 * np.tan(np.radians(2.0))))


def test_the_lines_say_the_figures() -> None:
    text = "\n".join(check_lines(turned(pitch_deg=-1.0)))
    assert "1.30 m above the road, points 1.00 degrees down and " in text
    assert "m of flat road at 50 m" in text
    assert "m of flat road at 100 m" in text
    assert "warning" not in text


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (turned(pitch_deg=-25.0), "the horizon is outside the image: row -"),
        (turned(pitch_deg=25.0), "the horizon is outside the image: row 10"),
        (turned(yaw_deg=44.0), "does not look along the drive"),
        (turned(roll_deg=8.0), "roll 8.0 degrees"),
        (dataclasses.replace(LEVEL, centre_px=(320.0, 480.0)), "the principal point is far off the middle: cx 320"),
        (dataclasses.replace(LEVEL, centre_px=(640.0, 640.0)), "the principal point is far off the middle: cy 640"),
        (dataclasses.replace(LEVEL, focal_px=(1300.0, 1000.0)), "pixels are not square: fx 1300, fy 1000"),
    ],
)
def test_warnings(camera: Camera, expected: str) -> None:
    found = warnings_of(camera)
    assert [warning for warning in found if expected in warning], found
    assert draw_check(camera, dark()).shape == (960, 1280, 3)  # and it still draws


def where(picture: np.ndarray, colour_bgr: tuple[int, int, int]) -> Floats:
    """Pixels x, y, shape (N, 2), where a line of that colour covers a third of the black ground or more."""
    drawn, colour = picture.astype(np.float64), np.array(colour_bgr, np.float64)
    share = drawn @ colour / (colour @ colour)
    is_line = (share > 1 / 3) & (np.abs(drawn - share[..., None] * colour).max(-1) < 12)
    return np.asarray(np.argwhere(is_line)[:, ::-1] + 0.5, np.float64)


@pytest.mark.slow
def test_the_picture_of_a_level_camera() -> None:
    picture = draw_check(LEVEL, dark())
    horizon = where(picture, HORIZON_BGR)
    assert np.abs(horizon[:, 1] - 480.0).max() <= 1.0
    assert len(np.unique(horizon[:, 0])) > 1200
    assert np.abs(where(picture, VANISHING_BGR).mean(0) - (640.0, 480.0)).max() < 1.5
    # The lane's edges: 1.75 m to either side, at row 700 that is 1.75 / 1.3 * 220 px.
    lane = where(picture, LANE_BGR)
    edges = lane[np.abs(lane[:, 1] - 700.0) <= 0.5, 0]
    assert [edges[edges < 640].mean(), edges[edges > 640].mean()] == pytest.approx(
        [640 - 1.75 / 1.3 * 220, 640 + 1.75 / 1.3 * 220], abs=2.0
    )


def test_lines_bend_with_the_lens() -> None:
    bent = dataclasses.replace(turned(pitch_deg=-8.0), distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))
    horizon = where(draw_check(bent, dark()), HORIZON_BGR)
    middle = horizon[np.abs(horizon[:, 0] - 640) < 20, 1].mean()
    sides = horizon[np.abs(horizon[:, 0] - 640) > 600, 1].mean()
    assert sides > middle + 3  # above the middle, a barrel pulls the ends of a line down


def test_small_images_are_enlarged_and_16_bits_are_shown() -> None:
    picture = draw_check(LEVEL.scaled(320, 240), (dark(320, 240).astype(np.uint16) * 50))
    assert picture.shape == (720, 960, 3)
    assert np.abs(where(picture, HORIZON_BGR)[:, 1] - 360.0).max() <= 1.5


def test_an_image_of_another_size(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a\.png: size: expected 1280x960 px as the calibration has it, got 640x480"):
        write_check(tmp_path / "out.png", LEVEL, dark(640, 480), "a.png")
    with pytest.raises(ValueError, match=r"out\.gif: expected a picture that ends in \.png"):
        write_check(tmp_path / "out.gif", LEVEL, dark(), "a.png")


def test_a_picture_in_a_file(tmp_path: Path) -> None:
    write_check(tmp_path / "out.png", LEVEL, dark(), "a.png")
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "out.png")), draw_check(LEVEL, dark()))
