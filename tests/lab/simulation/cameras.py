"""Small cameras for tests."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Camera, Pose


def camera(width_px: int = 320, height_px: int = 240, mount: Pose | None = None) -> Camera:
    """PVDN's field of view without distortion, in fewer pixels."""
    focal = 1312.0 * width_px / 1280
    if mount is None:
        mount = Pose(np.zeros(3), np.eye(3))
    return Camera(width_px, height_px, (focal, focal), (width_px / 2, height_px / 2), (0.0, 0.0, 0.0, 0.0, 0.0), mount)
