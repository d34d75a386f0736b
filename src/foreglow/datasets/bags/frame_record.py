"""What our own recordings keep of a frame beside its image, so that a replay gives the same frames."""

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
"""Topic of our own recordings that says for each image, just before it, what its frame is."""

FRAME_TYPE = "foreglow.Frame"
"""Type of the messages that hold a `FrameRecord`, encoded as JSON, logged at the time of their image."""

_Three = tuple[float, float, float]


class CameraRecord(Record):
    """A `Camera`, field by field."""

    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    position_m: _Three
    rotation: Annotated[tuple[_Three, ...], Field(min_length=3, max_length=3)]


class MotionRecord(Record):
    """An `EgoMotion`; a pitch that nobody knows is None."""

    speed_mps: float
    yaw_rate_radps: float
    pitch_rad: float | None


class RoadRecord(Record):
    """A `RoadAhead`; an error without bound is None."""

    points_m: Annotated[tuple[_Three, ...], Field(max_length=100_000)]
    half_width_m: float
    cross_slopes: tuple[float, ...]
    error_bound_m: float | None


class FrameRecord(Record):
    """All of a `Frame` but its image and where it came from; numbers come back as they were, to the last bit."""

    frame: int
    sequence: str
    timestamp_ns: int
    camera: CameraRecord | None
    motion: MotionRecord | None
    road: RoadRecord | None

    @classmethod
    def of(cls, frame: Frame) -> FrameRecord:
        """The record of `frame`."""
        motion, road = frame.motion, frame.road
        return cls(
            frame=frame.frame,
            sequence=frame.sequence,
            timestamp_ns=frame.timestamp_ns,
            camera=None if frame.camera is None else _camera_record(frame.camera),
            motion=None
            if motion is None
            else MotionRecord(
                speed_mps=motion.speed_mps,
                yaw_rate_radps=motion.yaw_rate_radps,
                pitch_rad=None if math.isnan(motion.pitch_rad) else motion.pitch_rad,
            ),
            road=None
            if road is None
            else RoadRecord(
                points_m=_threes(road.points_m),
                half_width_m=road.half_width_m,
                cross_slopes=tuple(road.cross_slopes.tolist()),
                error_bound_m=road.error_bound_m if math.isfinite(road.error_bound_m) else None,
            ),
        )

    def frame_of(self, image: Image, path: str) -> Frame:
        """The frame with its image.

        Raises:
            ValueError: If camera, motion or road cannot be, or the camera is for images of another size.
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
def _camera_record(camera: Camera) -> CameraRecord:
    pose = camera.vehicle_from_camera
    return CameraRecord(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=(float(camera.focal_px[0]), float(camera.focal_px[1])),
        centre_px=(float(camera.centre_px[0]), float(camera.centre_px[1])),
        distortion=camera.distortion,
        position_m=_threes(pose.position_m[None])[0],
        rotation=_threes(pose.rotation),
    )


@lru_cache(maxsize=8)  # the same camera for each frame: estimators remember what depends on it
def _camera(record: CameraRecord) -> Camera:
    return Camera(
        record.width_px,
        record.height_px,
        record.focal_px,
        record.centre_px,
        record.distortion,
        Pose(np.array(record.position_m), np.array(record.rotation)),
    )


def _threes(points: Floats) -> tuple[_Three, ...]:
    """Points of shape (N, 3) as tuples."""
    return tuple((x, y, z) for x, y, z in points.tolist())
