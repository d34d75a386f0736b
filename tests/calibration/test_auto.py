from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest

from foreglow.calibration.auto import DriveCalibration, calibrate_drive, lens_of
from foreglow.calibration.auto.drive import HEIGHT_M, HEIGHT_SIGMA_M, TAPE_SIGMA_M
from foreglow.datasets import PVDN, shipped_drive
from foreglow.geometry import rotation_angles_rad
from foreglow.types import Frame
from tests.calibration.roads import BONNET_ROW, LENS, STEP_S, drive
from tests.stand_ins import night_image


def calibrated(frames: list[Frame], height_m: float | None = None) -> DriveCalibration:
    return calibrate_drive(frames, LENS, name="drive", rate_hz=1 / STEP_S, num_frames=len(frames), height_m=height_m)


@functools.cache
def of_drive(yaw_deg: float, pitch_deg: float) -> DriveCalibration:
    return calibrated(drive(yaw_deg, pitch_deg))


def angles_deg(found: DriveCalibration) -> tuple[float, float]:
    yaw, pitch, _ = np.degrees(rotation_angles_rad(found.camera.vehicle_from_camera.rotation)).tolist()
    return yaw, pitch


@pytest.mark.slow
@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0.0, 0.0), (2.0, -3.0), (-1.5, 1.0)])
def test_the_mount_shows_in_the_drive(yaw_deg: float, pitch_deg: float) -> None:
    found = of_drive(yaw_deg, pitch_deg)
    sigmas = found.camera.mount_sigmas
    yaw_error, pitch_error = np.subtract(angles_deg(found), (yaw_deg, pitch_deg))
    assert abs(yaw_error) < min(0.2, 2 * math.degrees(sigmas.yaw_rad))
    assert abs(pitch_error) < min(0.2, 2 * math.degrees(sigmas.pitch_rad))
    assert found.num_lines >= 10


@pytest.mark.slow
def test_the_bonnet_is_masked_and_the_road_is_not() -> None:
    found = of_drive(0.0, 0.0)
    assert found.mask.shape == (LENS.height_px, LENS.width_px)
    assert found.mask[BONNET_ROW + 4 :].mean() > 0.8
    assert found.mask[: BONNET_ROW - 8].mean() < 0.1


@pytest.mark.slow
def test_a_camera_that_is_less_steady_is_known_less_well() -> None:
    steady = drive(num=32)
    turned = [frame for part in range(4) for frame in drive(0.5 * part, 0.5 * part, num=32)[8 * part : 8 * part + 8]]
    assert calibrated(turned).camera.mount_sigmas.pitch_rad > 1.5 * calibrated(steady).camera.mount_sigmas.pitch_rad


@pytest.mark.slow
def test_a_measured_height_is_known_better() -> None:
    assumed, measured = of_drive(0.0, 0.0).camera, calibrated(drive(), 1.45).camera
    assert (assumed.vehicle_from_camera.position_m[2], assumed.mount_sigmas.height_m) == (HEIGHT_M, HEIGHT_SIGMA_M)
    assert (measured.vehicle_from_camera.position_m[2], measured.mount_sigmas.height_m) == (1.45, TAPE_SIGMA_M)


def black() -> list[Frame]:
    return [Frame(np.zeros((320, 480), np.uint8), round(index * STEP_S * 1e9), frame=index) for index in range(20)]


def noise() -> list[Frame]:
    images = [night_image(index, 320, 480) for index in range(20)]
    return [Frame(image, round(index * STEP_S * 1e9), frame=index) for index, image in enumerate(images)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (black, "nothing moves in it: the car stands, or it is too dark"),
        (lambda: drive(speed_mps=0.0), "nothing moves in it: the car stands"),
        (lambda: drive(num=1), "expected a drive of at least 10 frames"),
        (lambda: drive(num_flakes=400), "streaks of snow or rain hide it in 2[0-9] of 24 frames"),
        (noise, "nothing moves in it: the car stands, or it is too dark"),
        (lambda: [*drive(num=1), Frame(night_image(), 10**10)], "expected 480x320 px in all frames, got 128x96"),
    ],
)
def test_too_little_is_said(make: Callable[[], list[Frame]], message: str) -> None:
    with pytest.raises(ValueError, match=f"^drive: .*{message}"):
        calibrated(make())


def test_the_lens() -> None:
    frame = Frame(night_image(), 0)
    assert lens_of(frame, "drive", fov_deg=90.0).focal_px == pytest.approx((64.0, 64.0))
    assert lens_of(frame, "drive", focal_px=70.0).centre_px == (64.0, 48.0)
    with pytest.raises(ValueError, match=r"^drive: expected a focal length, which a drive does not show"):
        lens_of(frame, "drive")
    with pytest.raises(ValueError, match=r"^drive: expected a focal length or a field of view, got both"):
        lens_of(frame, "drive", 70.0, 90.0)


@pytest.mark.slow
def test_the_drive_that_ships() -> None:
    """Every fourth frame shows it as well as all do."""
    dataset = PVDN(shipped_drive())
    frames = [dataset.read(image_id) for image_id in dataset.frame_ids[::4]]
    first = frames[0]
    assert first.camera is not None
    assert dataset.rate_hz is not None
    found = calibrate_drive(
        frames, lens_of(first, "curve"), name="curve", rate_hz=dataset.rate_hz / 4, num_frames=len(frames)
    )
    truth_deg = np.degrees(rotation_angles_rad(first.camera.vehicle_from_camera.rotation))[:2]
    errors = np.subtract(angles_deg(found), truth_deg)
    sigmas = np.degrees([found.camera.mount_sigmas.yaw_rad, found.camera.mount_sigmas.pitch_rad])
    assert (np.abs(errors) < 3 * sigmas).all()
