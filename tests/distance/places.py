"""Cameras over roads, boxes in their images, and the ranges that geometry gives them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from foreglow.config import DistanceConfig
from foreglow.distance import make_estimator
from foreglow.geometry import Camera, Pose, rotation
from foreglow.types import Detections, EgoMotion, Frame, Proposals, Ranges, RoadAhead

WIDTH_PX, HEIGHT_PX = 128, 96
CENTRE_BOX = (63, 47, 64, 48)
"""The pixel whose centre is the principal point of `camera`."""


def camera(
    height_m: float = 1.25,
    *,
    yaw_rad: float = 0.0,
    pitch_rad: float = 0.0,
    forward_m: float = 0.0,
    left_m: float = 0.0,
    focal_px: float = 1000.0,
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> Camera:
    mount = Pose(np.array([forward_m, left_m, height_m]), rotation(yaw_rad, pitch_rad))
    return Camera(WIDTH_PX, HEIGHT_PX, (focal_px, focal_px), (63.5, 47.5), distortion, mount)


def aimed(target_m: ArrayLike, height_m: float = 1.25, forward_m: float = 0.0, left_m: float = 0.0) -> Camera:
    """A camera whose axis goes through the point `target_m` of the vehicle's frame."""
    x, y, z = np.asarray(target_m, np.float64) - [forward_m, left_m, height_m]
    yaw, pitch = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    return camera(height_m, yaw_rad=yaw, pitch_rad=pitch, forward_m=forward_m, left_m=left_m)


def straight_road(left_m: float = 1.6, length_m: float = 400.0, begin_m: float = 0.0, step_m: float = 1.0) -> RoadAhead:
    x = np.arange(begin_m, begin_m + length_m + 1e-9, step_m)
    return RoadAhead(np.stack([x, np.full_like(x, left_m), np.zeros_like(x)], -1), 3.2, error_bound_m=0.0)


def frame(camera: Camera | None, road: RoadAhead | None = None, motion: EgoMotion | None = None) -> Frame:
    height_px, width_px = (HEIGHT_PX, WIDTH_PX) if camera is None else (camera.height_px, camera.width_px)
    return Frame(np.zeros((height_px, width_px), np.uint8), 0, camera=camera, road=road, motion=motion)


def detections(boxes: Sequence[Sequence[int]] = (CENTRE_BOX,)) -> Detections:
    array = np.array(boxes, np.int32).reshape(-1, 4)
    return Detections(Proposals(array), np.ones(len(array), np.float32), 0.5)


def ranges(name: str, seen: Frame, boxes: Sequence[Sequence[int]] = (CENTRE_BOX,), **fields: str | bool) -> Ranges:
    config = DistanceConfig.model_validate({"estimator": name, **fields})
    return make_estimator(config).estimate(seen, detections(boxes))


def range_m(name: str, seen: Frame, box: Sequence[int] = CENTRE_BOX, **fields: str | bool) -> float:
    return float(ranges(name, seen, [box], **fields).ranges_m[0])
