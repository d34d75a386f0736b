"""The frames of a drive as the calibration looks at them: small, 8 bits, with the dark brightened."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration.values import Intrinsics, Mount
from foreglow.geometry import Camera, Floats
from foreglow.types import Frame, Image


def lens_of(frame: Frame, name: str, focal_px: float | None = None, fov_deg: float | None = None) -> Intrinsics:
    """The lens that took `frame`: with the focal length or field of view given, or else that of the frame's camera.

    With a focal length, the principal point is the middle, and nothing is distorted.

    Args:
        frame: A frame.
        name: Of its source, for messages.
        focal_px: Focal length.
        fov_deg: Field of view, from the left edge of the image to the right one.

    Raises:
        ValueError: If both are given, or neither, and the frame has no camera.
    """
    if focal_px is not None and fov_deg is not None:
        raise ValueError(f"{name}: expected a focal length or a field of view, got both")
    width_px, height_px = frame.width_px, frame.height_px
    if fov_deg is not None:
        focal_px = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
    if focal_px is not None:
        return Intrinsics(
            width_px=width_px,
            height_px=height_px,
            focal_px=(focal_px, focal_px),
            centre_px=(width_px / 2, height_px / 2),
        )
    camera = frame.camera
    if camera is None:
        raise ValueError(
            f"{name}: expected a focal length, which a drive does not show: give --fov DEG (the horizontal field of "
            "view, from the data sheet) or --focal PX"
        )
    return Intrinsics(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=camera.focal_px,
        centre_px=camera.centre_px,
        distortion=camera.distortion,
    )


MAX_WIDTH_PX = 1280
"""Wider images are reduced by a whole factor to at most this width."""

MIN_STEP_S = 0.05
"""Frames that are closer together show too little motion."""

MAX_VIEWS = 400
"""Of a longer drive, so many frames are looked at: pairs, evenly spread."""

_STORED_TO_NS = 1_500_000  # many files have times in whole milliseconds

BRIGHT_PERCENTILE = 99.5

Grey = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame to look at.

    Attributes:
        grey: The small image, with the square root of the light.
        time_s: When it was taken.
        sequence: Name of its sequence.
    """

    grey: Grey
    time_s: float
    sequence: str


class Lens:
    """Tangents of the angles to the right and downwards for pixels of the small images, without the distortion.

    Attributes:
        focal_px: Focal length in the small images.
        reduction: Pixels of a frame for one of the small image.
    """

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._camera: Camera = intrinsics.camera(
            Mount(position_m=(0.0, 0.0, 1.0), yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0)
        )
        self.reduction = reduction_of(intrinsics.width_px)
        self.focal_px = intrinsics.focal_px[0] / self.reduction

    def tangents(self, pixels: Floats) -> Floats:
        """Shape (..., 2), for pixels (x, y) of that shape; the first one's centre is (0, 0), as OpenCV has it."""
        rays = self._camera.rays((np.asarray(pixels, np.float64) + 0.5) * self.reduction)
        return -rays[..., 1:] / rays[..., :1]


def reduction_of(width_px: int) -> int:
    """The whole factor by which images of this width are reduced."""
    return math.ceil(width_px / MAX_WIDTH_PX)


def views_of(frames: Iterable[Frame], rate_hz: float | None, num_frames: int | None) -> Iterator[tuple[Frame, View]]:
    """The frames to look at, in the order of time: by their own times, however the rate varies."""
    gap = max(1, math.ceil(MIN_STEP_S * (rate_hz or 1.0) - 1e-6))
    stride = max(1, math.ceil((num_frames or 0) * 2 / (gap * MAX_VIEWS)))
    least_ns, number, latest = MIN_STEP_S * 1e9 - _STORED_TO_NS, 0, ("", 0)
    for frame in frames:
        is_near = number > 0 and frame.sequence == latest[0] and 0 <= frame.timestamp_ns - latest[1] < least_ns
        if is_near:
            continue
        if number % stride < 2:
            yield frame, View(_small(frame.image), frame.timestamp_ns * 1e-9, frame.sequence)
        number, latest = number + 1, (frame.sequence, frame.timestamp_ns)


def _small(image: Image) -> Grey:
    reduction = reduction_of(image.shape[1])
    light: NDArray[np.float32] = image.astype(np.float32)
    if reduction > 1:
        size = (image.shape[1] // reduction, image.shape[0] // reduction)
        cut = np.ascontiguousarray(light[: size[1] * reduction, : size[0] * reduction])
        light = np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.float32)
    bright = max(float(np.percentile(light, BRIGHT_PERCENTILE)), np.iinfo(image.dtype).max * 0.02)
    return np.asarray(np.sqrt(np.clip(light / bright, 0.0, 1.0)) * 255.0, np.uint8)
