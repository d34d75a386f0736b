"""Roads by construction, a camera over them, and images with what stands on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.types import Detections, EgoMotion, Frame, Image, Proposals, RoadAhead

HALF_WIDTH_M = 3.2
LEVEL = 1e-12
"""A cross slope of none: a map that has none at all leaves it to be guessed."""


def camera(pitch_rad: float = -0.01) -> Camera:
    mount = Pose(np.array([2.0, 0.0, 1.25]), rotation(pitch_rad=pitch_rad))
    return Camera(1280, 960, (1260.0, 1260.0), (640.0, 480.0), (0.0, 0.0, 0.0, 0.0, 0.0), mount)


def road(points_m: ArrayLike, cross_slope: float = LEVEL, error_bound_m: float = 2.0) -> RoadAhead:
    points = np.asarray(points_m, np.float64)
    return RoadAhead(points, HALF_WIDTH_M, np.full(len(points), cross_slope), error_bound_m)


def line(curvatures: Floats, heights_m: ArrayLike = 0.0) -> Floats:
    """A centre line that starts half a lane to our left, along x; one curvature for each metre."""
    headings = np.concatenate([[0.0], np.cumsum(curvatures)])
    middles = (headings[1:] + headings[:-1]) / 2
    steps = np.stack([np.cos(middles), np.sin(middles), np.zeros_like(middles)], -1)
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    points[:, 1] += HALF_WIDTH_M / 2
    points[:, 2] = heights_m
    return points


def straight(length_m: int = 450) -> RoadAhead:
    return road(line(np.zeros(length_m)))


def lights(camera: Camera, points_m: ArrayLike, radius_px: int = 3, pitch_rad: float = 0.0) -> tuple[Image, Detections]:
    """An image with a bright disc at each point before a car whose nose is up by the pitch, and their boxes."""
    image = np.full((camera.height_px, camera.width_px), 8, np.uint8)
    points = np.asarray(points_m, np.float64) @ rotation(pitch_rad=pitch_rad)
    pixels = camera.project(camera.vehicle_from_camera.to_body(points))
    rows, columns = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    boxes = []
    for x, y in pixels:
        image[(columns - x) ** 2 + (rows - y) ** 2 <= radius_px**2] = 250
        corner = np.floor([x - radius_px - 1, y - radius_px - 1]).astype(int)
        boxes.append([*corner, *(corner + 2 * radius_px + 3)])
    return image, detections(boxes)


def detections(boxes: Sequence[Sequence[int]]) -> Detections:
    array = np.array(boxes, np.int32).reshape(-1, 4)
    return Detections(Proposals(array), np.ones(len(array), np.float32), 0.5)


def frame(
    image: Image, camera: Camera | None, road: RoadAhead | None, motion: EgoMotion | None = None, time_s: float = 0.0
) -> Frame:
    return Frame(image, round(time_s * 1e9), camera=camera, road=road, motion=motion)
