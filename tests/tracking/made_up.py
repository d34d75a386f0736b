"""Frames and detections without images, for the tests of trackers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foreglow.geometry import Camera, Pose
from foreglow.types import Detections, EgoMotion, Frame, Proposals, Ranges

FRAME_S = 1 / 18


def camera() -> Camera:
    """Without distortion, level, 1.2 m above the road."""
    mount = Pose(np.array([1.0, 0.0, 1.2]), np.eye(3))
    return Camera(1280, 960, (1400.0, 1400.0), (640.0, 480.0), (0.0, 0.0, 0.0, 0.0, 0.0), mount)


def frame_at(time_s: float, *, yaw_rate_radps: float | None = None, size_px: tuple[int, int] = (1280, 960)) -> Frame:
    """A frame whose image takes no memory; with camera and motion where a rate of turn is given."""
    image = np.broadcast_to(np.uint8(0), (size_px[1], size_px[0]))
    equipped = yaw_rate_radps is not None
    motion = EgoMotion(20.0, yaw_rate_radps) if yaw_rate_radps is not None else None
    return Frame(image, round(time_s * 1e9), camera=camera() if equipped else None, motion=motion)


def detections_of(*rows: Sequence[float]) -> Detections:
    """Rows of x1, y1, x2, y2, score."""
    table = np.array(rows, np.float64).reshape(-1, 5)
    return Detections(Proposals(table[:, :4].astype(np.int32)), table[:, 4].astype(np.float32), 0.5)


def ranges_of(detections: Detections, ranges_m: Sequence[float], sigmas_m: Sequence[float]) -> Ranges:
    return Ranges(detections, np.array(ranges_m, np.float64), np.array(sigmas_m, np.float64))
