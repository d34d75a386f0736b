"""Small drives along a straight marked road, drawn by projection: what a calibration from the drive has to find."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration import Intrinsics, Mount
from foreglow.geometry import Camera
from foreglow.types import Frame

LENS = Intrinsics(width_px=480, height_px=320, focal_px=(450.0, 450.0), centre_px=(240.0, 160.0))
SPEED_MPS = 15.0
STEP_S = 0.1
BONNET_ROW = 300
_DASH_M, _PERIOD_M = 6.0, 12.0


def drive(
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    num: int = 24,
    *,
    speed_mps: float = SPEED_MPS,
    has_lines: bool = True,
    num_flakes: int = 0,
) -> list[Frame]:
    """Frames of a camera on this mount; the bonnet hides the rows from `BONNET_ROW` on.

    Snow falls through the light: of a frame's flakes, each is a streak that leads away from where they come from.
    """
    camera = LENS.camera(Mount(position_m=(1.7, 0.0, 1.3), yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=0.0))
    posts_m = np.random.default_rng(5).uniform([5.0, 4.0, 0.2], [200.0, 9.0, 1.5], (160, 3))
    posts_m[::2, 1] *= -1.0
    frames = []
    for index in range(num):
        way_m = index * STEP_S * speed_mps
        image = np.full((LENS.height_px, LENS.width_px), 12, np.uint8)
        for x, y, z in posts_m - [way_m, 0.0, 0.0]:
            _fill(image, camera, [(x, y - 0.1, z), (x, y + 0.1, z), (x, y + 0.1, z + 0.4), (x, y - 0.1, z + 0.4)])
        if has_lines:
            _stripe(image, camera, -1.8, 4.0, 80.0)
            _stripe(image, camera, 5.4, 4.0, 80.0)
            for start_m in np.arange(-way_m % _PERIOD_M - _PERIOD_M, 80.0, _PERIOD_M):
                _stripe(image, camera, 1.8, max(4.0, start_m), min(80.0, start_m + _DASH_M))
        for x, y, z in np.random.default_rng(index).uniform([4.0, -4.0, 0.0], [16.0, 4.0, 0.9], (num_flakes, 3)):
            ends = [(x + side, y, z + 0.08 * side) for side in (0.0, 1.5)]
            _fill(image, camera, [(a, b + 0.01, c) for a, b, c in ends] + [(a, b - 0.01, c) for a, b, c in ends[::-1]])
        image[BONNET_ROW:] = 40
        noise = np.random.default_rng(index).normal(0.0, 1.0, image.shape)
        frames.append(Frame(np.clip(image + noise, 0, 255).astype(np.uint8), round(index * STEP_S * 1e9), frame=index))
    return frames


def _stripe(image: NDArray[np.uint8], camera: Camera, left_m: float, near_m: float, far_m: float) -> None:
    """A marking of 15 cm from `near_m` to `far_m` ahead."""
    if far_m > near_m:
        near, far = ((x, left_m + side, 0.0) for x, side in ((near_m, 0.075), (far_m, 0.075)))
        _fill(image, camera, [near, far, (far_m, left_m - 0.075, 0.0), (near_m, left_m - 0.075, 0.0)])


def _fill(image: NDArray[np.uint8], camera: Camera, corners_m: list[tuple[float, float, float]]) -> None:
    """Draws the polygon with these corners in the road's frame, ahead of the camera."""
    points = np.array(corners_m)
    points[:, 0] += camera.vehicle_from_camera.position_m[0]
    pixels = camera.project(camera.vehicle_from_camera.to_body(points))
    if np.isfinite(pixels).all() and np.abs(pixels).max() < 4000:
        corners = np.rint((pixels - 0.5) * 16).astype(np.int32)  # OpenCV has the first pixel's centre at (0, 0)
        cv2.fillPoly(image, [corners], 190, cv2.LINE_AA, shift=4)
