"""The message in our own recordings that keeps the rest of a frame beside its image: a replay gives the same frames."""

from __future__ import annotations

import math
import zlib
from base64 import b64decode, b64encode
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from foreglow.datasets.images import MAX_SIDE_PX, Chroma
from foreglow.datasets.json_files import Record, StoredAs, adapter
from foreglow.geometry import Camera, Floats, MountSigmas, Pose, check_distortion, check_mount
from foreglow.types import EgoMotion, Frame, Image, RoadAhead

FRAME_TOPIC = "/frame"
"""Topic of our own recordings with a `FrameMessage` just before each image."""

FRAME_TYPE = "foreglow.Frame"
"""Type of these messages; they are encoded as JSON and logged at the time of their image."""

_Three: TypeAlias = tuple[float, float, float]


class _StoredCamera(Record):
    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    position_m: _Three
    rotation: tuple[_Three, _Three, _Three]
    mount_sigmas: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # older recordings do not have them


class _StoredMotion(Record):
    speed_mps: float
    yaw_rate_radps: float
    pitch_rad: float | None  # None if unknown


class _StoredRoad(Record):
    points_m: Annotated[tuple[_Three, ...], Field(max_length=100_000)]
    half_width_m: float
    cross_slopes: tuple[float, ...]
    error_bound_m: float | None  # None if unbounded


@lru_cache(maxsize=8)
def _stored_camera(camera: Camera) -> _StoredCamera:
    first, second, third = _threes(camera.vehicle_from_camera.rotation)
    sigmas = camera.mount_sigmas
    return _StoredCamera(
        width=camera.width_px,
        height=camera.height_px,
        focal_px=(float(camera.focal_px[0]), float(camera.focal_px[1])),
        centre_px=(float(camera.centre_px[0]), float(camera.centre_px[1])),
        distortion=camera.distortion,
        position_m=_threes(camera.vehicle_from_camera.position_m[None])[0],
        rotation=(first, second, third),
        mount_sigmas=(sigmas.yaw_rad, sigmas.pitch_rad, sigmas.roll_rad, sigmas.height_m),
    )


@lru_cache(maxsize=8)  # the same camera for each frame: estimators keep results by camera
def _camera(stored: _StoredCamera) -> Camera:
    mount = Pose(np.array(stored.position_m), np.array(stored.rotation))
    check_mount(mount, "camera")
    size_px = stored.width, stored.height
    check_distortion(size_px, stored.focal_px, stored.centre_px, stored.distortion, "distortion")
    sigmas = MountSigmas(*stored.mount_sigmas)
    return Camera(stored.width, stored.height, stored.focal_px, stored.centre_px, stored.distortion, mount, sigmas)


def _stored_motion(motion: EgoMotion) -> _StoredMotion:
    pitch_rad = None if math.isnan(motion.pitch_rad) else motion.pitch_rad
    return _StoredMotion(speed_mps=motion.speed_mps, yaw_rate_radps=motion.yaw_rate_radps, pitch_rad=pitch_rad)


def _motion(stored: _StoredMotion) -> EgoMotion:
    return EgoMotion(
        stored.speed_mps, stored.yaw_rate_radps, math.nan if stored.pitch_rad is None else stored.pitch_rad
    )


def _stored_road(road: RoadAhead) -> _StoredRoad:
    return _StoredRoad(
        points_m=_threes(road.points_m),
        half_width_m=road.half_width_m,
        cross_slopes=tuple(road.cross_slopes.tolist()),
        error_bound_m=road.error_bound_m if math.isfinite(road.error_bound_m) else None,
    )


def _road(stored: _StoredRoad) -> RoadAhead:
    points_m = np.array(stored.points_m, np.float64).reshape(-1, 3)
    bound_m = math.inf if stored.error_bound_m is None else stored.error_bound_m
    return RoadAhead(points_m, stored.half_width_m, np.array(stored.cross_slopes, np.float64), bound_m)


class _StoredChroma(Record):
    width: Annotated[int, Field(ge=1, le=MAX_SIDE_PX // 2)]
    height: Annotated[int, Field(ge=1, le=MAX_SIDE_PX // 2)]
    bits: Literal[8, 16] = 8  # older recordings do not have it
    zlib: str  # the rows, compressed, in base 64; little-endian


def _stored_chroma(chroma: Chroma) -> _StoredChroma:
    height, width = chroma.shape
    return _StoredChroma(width=width, height=height, bits=_bits(chroma), zlib=_packed(chroma))


def _chroma(stored: _StoredChroma) -> Chroma:
    return _rows(stored)


class _StoredEarlier(Record):
    timestamp_ns: int
    width: Annotated[int, Field(ge=1, le=MAX_SIDE_PX)]
    height: Annotated[int, Field(ge=1, le=MAX_SIDE_PX)]
    bits: Literal[8, 16]
    zlib: str  # as above; little-endian


def _stored_earlier(earlier: Frame) -> _StoredEarlier:
    image = earlier.image
    return _StoredEarlier(
        timestamp_ns=earlier.timestamp_ns,
        width=earlier.width_px,
        height=earlier.height_px,
        bits=_bits(image),
        zlib=_packed(image),
    )


def _earlier(stored: _StoredEarlier) -> Frame:
    return Frame(_rows(stored), stored.timestamp_ns)


def _bits(rows: Image) -> Literal[8, 16]:
    return 8 if rows.dtype == np.uint8 else 16


def _rows(stored: _StoredChroma | _StoredEarlier) -> Image:
    values = _unpacked(stored.zlib, stored.height, stored.width * stored.bits // 8)
    rows: NDArray[Any] = np.frombuffer(values, f"<u{stored.bits // 8}").reshape(stored.height, -1)
    return rows.astype(rows.dtype.newbyteorder("="), copy=False)


def _packed(rows: Image) -> str:
    little = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
    return b64encode(zlib.compress(little.tobytes(), level=1)).decode()


def _unpacked(text: str, num_rows: int, row_bytes: int) -> bytes:
    size = num_rows * row_bytes
    try:
        values = zlib.decompressobj().decompress(b64decode(text, validate=True), max_length=size)
    except (ValueError, zlib.error) as error:
        raise ValueError(f"zlib: expected compressed rows in base 64, cannot be read: {error}") from None
    if len(values) != size:
        raise ValueError(f"zlib: expected {num_rows} rows of {row_bytes} bytes, got {len(values)} bytes")
    return values


def _threes(points: Floats) -> tuple[_Three, ...]:
    return tuple((x, y, z) for x, y, z in points.tolist())


@dataclass(frozen=True, slots=True, eq=False)
class FrameMessage:
    """All of a `Frame` but its image and its path; numbers come back as they were, to the last bit."""

    __pydantic_config__ = ConfigDict(strict=True, allow_inf_nan=False)

    frame: int
    sequence: str
    timestamp_ns: int
    camera: Annotated[Camera, StoredAs(_StoredCamera, _camera, _stored_camera)] | None
    motion: Annotated[EgoMotion, StoredAs(_StoredMotion, _motion, _stored_motion)] | None
    road: Annotated[RoadAhead, StoredAs(_StoredRoad, _road, _stored_road)] | None
    is_damaged: bool = False  # older recordings have neither this
    is_reported: bool | None = None  # nor this
    red_chroma: Annotated[Chroma, StoredAs(_StoredChroma, _chroma, _stored_chroma)] | None = None  # nor this
    earlier: Annotated[Frame, StoredAs(_StoredEarlier, _earlier, _stored_earlier)] | None = None  # nor this

    @classmethod
    def of(cls, frame: Frame) -> FrameMessage:
        """The message about `frame`."""
        return cls(
            frame.frame,
            frame.sequence,
            frame.timestamp_ns,
            frame.camera,
            frame.motion,
            frame.road,
            is_damaged=frame.is_damaged,
            is_reported=frame.is_reported,
            red_chroma=frame.red_chroma,
            earlier=frame.earlier,
        )

    def to_json(self) -> bytes:
        """The message as JSON."""
        text: bytes = adapter(FrameMessage).dump_json(self)
        return text

    def frame_of(self, image: Image, path: str) -> Frame:
        """The frame with its image.

        Raises:
            ValueError: If the camera, the chroma or the earlier image is for images of another size.
        """
        return Frame(
            image,
            timestamp_ns=self.timestamp_ns,
            frame=self.frame,
            sequence=self.sequence,
            path=path,
            camera=self.camera,
            motion=self.motion,
            road=self.road,
            is_damaged=self.is_damaged,
            is_reported=self.is_reported,
            red_chroma=self.red_chroma,
            earlier=self.earlier,
        )
