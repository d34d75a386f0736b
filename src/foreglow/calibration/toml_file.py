"""A camera's calibration as a TOML file.

    [image]
    width_px = 1280
    height_px = 960

    [intrinsics]
    focal_px = [1312.0, 1312.0]
    centre_px = [640.0, 480.0]
    distortion = [-0.05, 0.02, 0.0, 0.0, 0.0]  # k1, k2, p1, p2, k3 as OpenCV has them; may be left out

    [mount]  # of the camera in the vehicle
    position_m = [1.9, 0.0, 1.3]  # forward of the rear axle, left, above the road
    yaw_deg = 0.0  # to the left
    pitch_deg = -0.7  # upwards
    roll_deg = 0.0  # to the right
    yaw_sigma_deg = 0.1  # standard deviations; 0, or left out, for a mount that counts as exact
    pitch_sigma_deg = 0.1
    roll_sigma_deg = 1.0
    height_sigma_m = 0.02

The centre of the upper left pixel is (0.5, 0.5); `foreglow.geometry` says what the frames are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from foreglow.calibration.values import NO_DISTORTION, Five, Focal, ImageChoice, Intrinsics, Mount, Side, Two
from foreglow.config import FrozenModel, read_toml, validated
from foreglow.geometry import Camera, check_centre, rotation_angles_rad
from foreglow.types.arrays import check_kind

ANGLE_DECIMALS = 12
"""Decimals of a degree in a file: far finer than any calibration, and coarse enough that angles survive the conversion
to a matrix and back.
"""


class _Image(FrozenModel):
    width_px: Side
    height_px: Side


class _Lens(FrozenModel):
    focal_px: Focal
    centre_px: Two
    distortion: Five = NO_DISTORTION


class _IntrinsicsFile(FrozenModel):
    image: _Image
    intrinsics: _Lens
    mount: Mount | None = None


class _CameraFile(_IntrinsicsFile):
    mount: Mount


def read_toml_calibration(path: Path) -> tuple[Intrinsics, Mount]:
    """The camera in the TOML file `path`, and its mount.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is missing, unknown, not a finite number or out of range; the message
            names path and field.
    """
    file = validated(_CameraFile, read_toml(path), str(path))
    return _intrinsics(file, path), file.mount


def read_toml_intrinsics(path: Path, choice: ImageChoice) -> Intrinsics:
    """The camera in the TOML file `path`, with or without a mount; it has a single kind of images.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: As in `read_toml_calibration`; also if another camera, another size or rectified images are asked
            for.
    """
    if choice.camera != 0 or choice.is_rectified:
        raise ValueError(f"{path}: camera: expected no choice for a TOML file, which has a single kind of images")
    intrinsics = _intrinsics(validated(_IntrinsicsFile, read_toml(path), str(path)), path)
    choice.checked_size_px((intrinsics.width_px, intrinsics.height_px), f"{path}: image")
    return intrinsics


def calibration_to_toml(camera: Camera) -> str:
    """`camera` as TOML text that `read_calibration` reads back: all numbers exactly, angles to `ANGLE_DECIMALS`.

    A camera whose angles have no more decimals than that, such as a camera that was read, comes back exactly.
    """
    return tomli_w.dumps(calibration_values(camera))


def calibration_values(camera: Camera) -> dict[str, dict[str, Any]]:
    """The tables of that text, by which two cameras can be compared.

    Raises:
        ValueError: If it is no camera.
    """
    check_kind("camera", camera, Camera)
    yaw, pitch, roll = (
        round(float(np.degrees(angle)), ANGLE_DECIMALS) + 0.0  # no -0.0
        for angle in rotation_angles_rad(camera.vehicle_from_camera.rotation)
    )
    sigmas = camera.mount_sigmas
    known = {
        "yaw_sigma_deg": round(float(np.degrees(sigmas.yaw_rad)), ANGLE_DECIMALS),
        "pitch_sigma_deg": round(float(np.degrees(sigmas.pitch_rad)), ANGLE_DECIMALS),
        "roll_sigma_deg": round(float(np.degrees(sigmas.roll_rad)), ANGLE_DECIMALS),
        "height_sigma_m": float(sigmas.height_m),
    }
    return {
        "image": {"width_px": int(camera.width_px), "height_px": int(camera.height_px)},
        "intrinsics": {
            "focal_px": _floats(camera.focal_px),
            "centre_px": _floats(camera.centre_px),
            "distortion": _floats(camera.distortion),
        },
        "mount": {
            "position_m": _floats(camera.vehicle_from_camera.position_m),
            "yaw_deg": yaw,
            "pitch_deg": pitch,
            "roll_deg": roll,
            **{name: sigma for name, sigma in known.items() if sigma},
        },
    }


def _intrinsics(file: _IntrinsicsFile, path: Path) -> Intrinsics:
    found = Intrinsics(**file.image.model_dump(), **file.intrinsics.model_dump())
    check_centre(found.centre_px, (found.width_px, found.height_px), f"{path}: intrinsics.centre_px")
    return found.of_a_lens(f"{path}: intrinsics.focal_px").undistorted(f"{path}: intrinsics.distortion")


def _floats(values: tuple[float, ...] | np.ndarray) -> list[float]:
    return [float(value) for value in values]
