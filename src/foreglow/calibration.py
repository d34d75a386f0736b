"""A camera's calibration as a TOML file that people read and write.

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

The centre of the upper left pixel is (0.5, 0.5); `foreglow.geometry` says what the frames are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import tomli_w
from pydantic import Field

from foreglow.config import FrozenModel, read_toml, validated
from foreglow.geometry import Camera, Pose, rotation, rotation_angles_rad

ANGLE_DECIMALS = 12
"""Of a degree, in a file: far below any calibration, and coarse enough that angles survive the way to a matrix and
back.
"""

# TOML has lists where Python has tuples; what is in them stays strict.
_Two: TypeAlias = Annotated[tuple[float, float], Field(strict=False)]
_Three: TypeAlias = Annotated[tuple[float, float, float], Field(strict=False)]
_Five: TypeAlias = Annotated[tuple[float, float, float, float, float], Field(strict=False)]
_Focal: TypeAlias = Annotated[tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]], Field(strict=False)]
_Angle: TypeAlias = Annotated[float, Field(ge=-360, le=360)]


class _Image(FrozenModel):
    width_px: Annotated[int, Field(ge=1)]
    height_px: Annotated[int, Field(ge=1)]


class _Intrinsics(FrozenModel):
    focal_px: _Focal
    centre_px: _Two
    distortion: _Five = (0.0, 0.0, 0.0, 0.0, 0.0)


class _Mount(FrozenModel):
    position_m: _Three
    yaw_deg: _Angle = 0.0
    pitch_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    roll_deg: _Angle = 0.0


class _Calibration(FrozenModel):
    image: _Image
    intrinsics: _Intrinsics
    mount: _Mount


def read_calibration(path: Path | str) -> Camera:
    """The camera in the TOML file `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is missing, unknown, no finite number or out of range; the message
            names path and field.
    """
    path = Path(path)
    file = validated(_Calibration, read_toml(path), str(path))
    mount = file.mount
    turned = rotation(*np.radians([mount.yaw_deg, mount.pitch_deg, mount.roll_deg]))
    return Camera(
        width_px=file.image.width_px,
        height_px=file.image.height_px,
        focal_px=file.intrinsics.focal_px,
        centre_px=file.intrinsics.centre_px,
        distortion=file.intrinsics.distortion,
        vehicle_from_camera=Pose(np.array(mount.position_m), turned),
    )


def calibration_to_toml(camera: Camera) -> str:
    """`camera` as TOML text that `read_calibration` reads back: all numbers exactly, angles to `ANGLE_DECIMALS`.

    A camera whose angles have no more decimals than that, such as one that was read, comes back exactly.
    """
    yaw, pitch, roll = (
        round(float(np.degrees(angle)), ANGLE_DECIMALS) + 0.0  # no -0.0
        for angle in rotation_angles_rad(camera.vehicle_from_camera.rotation)
    )
    return tomli_w.dumps(
        {
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
            },
        }
    )


def _floats(values: tuple[float, ...] | np.ndarray) -> list[float]:
    return [float(value) for value in values]
