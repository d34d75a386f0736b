"""The message in our own recordings that keeps the rest of a frame beside its image: a replay gives the same frames."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from foreglow.datasets.json_files import Record
from foreglow.geometry import Camera, Floats, Pose
from foreglow.types import EgoMotion, Frame, Image, RoadAhead

FRAME_TOPIC = "/frame"
"""Topic of our own recordings with a `FrameMessage` just before each image."""

FRAME_TYPE = "foreglow.Frame"
"""Type of these messages; they are encoded as JSON and logged at the time of their image."""

_Three = tuple[float, float, float]


class _StoredCamera(Record):
    """A `Camera`, field by field."""

    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    position_m: _Three
    rotation: Annotated[tuple[_Three, ...], Field(min_length=3, max_length=3)]


class _StoredMotion(Record):
    """An `EgoMotion`; an unknown pitch is None."""

    speed_mps: float
    yaw_rate_radps: float
    pitch_rad: float | None


class _StoredRoad(Record):
    """A `RoadAhead`; an error without bound is None."""

    points_m: Annotated[tuple[_Three, ...], Field(max_length=100_000)]
    half_width_m: float
    cross_slopes: tuple[float, ...]
    error_bound_m: float | None


class FrameMessage(Record):
    """All of a `Frame` but its image and its path; numbers come back as they were, to the last bit."""

    frame: int
    sequence: str
    timestamp_ns: int
    camera: _StoredCamera | None
    motion: _StoredMotion | None
    road: _StoredRoad | None

    @classmethod
    def of(cls, frame: Frame) -> FrameMessage:
        """The message about `frame`."""
        motion, road = frame.motion, frame.road
        return cls(
            frame=frame.frame,
            sequence=frame.sequence,
            timestamp_ns=frame.timestamp_ns,
            camera=None if frame.camera is None else _stored_camera(frame.camera),
            motion=None
            if motion is None
            else _StoredMotion(
                speed_mps=motion.speed_mps,
                yaw_rate_radps=motion.yaw_rate_radps,
                pitch_rad=None if math.isnan(motion.pitch_rad) else motion.pitch_rad,
            ),
            road=None
            if road is None
            else _StoredRoad(
                points_m=_threes(road.points_m),
                half_width_m=road.half_width_m,
                cross_slopes=tuple(road.cross_slopes.tolist()),
                error_bound_m=road.error_bound_m if math.isfinite(road.error_bound_m) else None,
            ),
        )

    def frame_of(self, image: Image, path: str) -> Frame:
        """The frame with its image.

        Raises:
            ValueError: If camera, motion or road is not valid, or the camera is for images of another size.
        """
        motion, road = self.motion, self.road
        return Frame(
            image,
            timestamp_ns=self.timestamp_ns,
            frame=self.frame,
            sequence=self.sequence,
            path=path,
            camera=None if self.camera is None else _camera(self.camera),
            motion=None
            if motion is None
            else EgoMotion(
                motion.speed_mps, motion.yaw_rate_radps, math.nan if motion.pitch_rad is None else motion.pitch_rad
            ),
            road=None
            if road is None
            else RoadAhead(
                np.array(road.points_m, np.float64).reshape(-1, 3),
                road.half_width_m,
                np.array(road.cross_slopes, np.float64),
                math.inf if road.error_bound_m is None else road.error_bound_m,
            ),
        )


@lru_cache(maxsize=8)
def _stored_camera(camera: Camera) -> _StoredCamera:
    pose = camera.vehicle_from_camera
    return _StoredCamera(
        width=camera.width_px,
        height=camera.height_px,
        focal_px=(float(camera.focal_px[0]), float(camera.focal_px[1])),
        centre_px=(float(camera.centre_px[0]), float(camera.centre_px[1])),
        distortion=camera.distortion,
        position_m=_threes(pose.position_m[None])[0],
        rotation=_threes(pose.rotation),
    )


@lru_cache(maxsize=8)  # the same camera for each frame: estimators keep results by camera
def _camera(stored: _StoredCamera) -> Camera:
    return Camera(
        stored.width,
        stored.height,
        stored.focal_px,
        stored.centre_px,
        stored.distortion,
        Pose(np.array(stored.position_m), np.array(stored.rotation)),
    )


def _threes(points: Floats) -> tuple[_Three, ...]:
    """Points of shape (N, 3) as tuples."""
    return tuple((x, y, z) for x, y, z in points.tolist())
