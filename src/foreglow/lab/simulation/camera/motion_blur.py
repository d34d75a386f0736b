"""Motion blur: motion in the image while the shutter is open, and the resulting blur."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Pose
from foreglow.lab.simulation.camera.optics import Image

MIN_MOTION_PX = 0.7
"""Shorter motion is left out, since the point spread hides it."""

NUM_TAPS = 4
"""Taps of each of the two passes; together they make 16 evenly spaced taps along the motion."""

STEP = 8
"""The motion is computed for every eighth pixel."""


class MotionBlur:
    """Blur by the camera's own motion; moving objects are treated as standing still."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        width, height = -(-camera.width_px // STEP), -(-camera.height_px // STEP)
        columns = (np.arange(width) + 0.5) * camera.width_px / width
        rows = (np.arange(height) + 0.5) * camera.height_px / height
        self._pixels = np.stack(np.meshgrid(columns, rows), -1)
        self._rays = camera.rays(self._pixels)

    def flow_px(self, depth_m: Image, before_from_after: Pose) -> Image | None:
        """Motion of each pixel's surface through the image during the exposure.

        Args:
            depth_m: Shape (H, W), along each pixel's ray, metres; NaN is infinitely far.
            before_from_after: The camera's pose when the shutter closes, in its frame when it opened.

        Returns:
            Shape (H, W, 2), float32, pixels x, y; None if nothing moves by more than `MIN_MOTION_PX`.
        """
        size = self._rays.shape[1::-1]
        depth = cv2.resize(np.nan_to_num(depth_m, nan=1e5, posinf=1e5), size, interpolation=cv2.INTER_NEAREST)
        moved = self._camera.project(before_from_after.to_body(self._rays * depth[..., np.newaxis]))
        flow = np.nan_to_num(moved - self._pixels).astype(np.float32)
        # Close objects that leave the image move by far more than can be seen.
        flow = np.clip(flow, -0.1 * self._camera.width_px, 0.1 * self._camera.width_px)
        if float(np.hypot(flow[..., 0], flow[..., 1]).max()) <= MIN_MOTION_PX:
            return None
        full = (self._camera.width_px, self._camera.height_px)
        return np.asarray(cv2.resize(flow, full, interpolation=cv2.INTER_LINEAR))


def blur(luminance: Image, flow_px: NDArray[np.float32] | None) -> Image:
    """`luminance`, shape (H, W), averaged along `flow_px`, shape (H, W, 2), centred on each pixel.

    Only the rectangle around everything that moves by more than `MIN_MOTION_PX` is changed. Without motion, the image
    itself is returned.
    """
    if flow_px is None:
        return luminance
    blurred = luminance
    # A coarse comb, then a fine one that fills its gaps, where these are wider than a pixel.
    for spacing, least_px in ((1.0 / NUM_TAPS, MIN_MOTION_PX), (1.0 / NUM_TAPS**2, float(NUM_TAPS))):
        window = _moving(flow_px, least_px)
        if window is None:
            break
        rows, columns = (np.arange(each.start, each.stop, dtype=np.float32) for each in window)
        x, y = np.meshgrid(columns, rows)
        flow_x, flow_y = (np.ascontiguousarray(flow_px[*window, axis]) for axis in (0, 1))
        total = np.zeros_like(x)
        for tap in range(NUM_TAPS):
            share = (tap - (NUM_TAPS - 1) / 2) * spacing
            at_x, at_y = cv2.scaleAdd(flow_x, share, x), cv2.scaleAdd(flow_y, share, y)
            cv2.accumulate(cv2.remap(blurred, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), total)
        blurred = blurred.copy() if blurred is luminance else blurred
        blurred[window] = total / NUM_TAPS
    return blurred


def _moving(flow_px: NDArray[np.float32], least_px: float) -> tuple[slice, slice] | None:
    """Rows and columns around all that moves by more than `least_px`; None if nothing does."""
    least_px /= np.sqrt(2.0)
    is_moving = (np.abs(flow_px[..., 0]) > least_px) | (np.abs(flow_px[..., 1]) > least_px)
    rows, columns = np.flatnonzero(is_moving.any(1)), np.flatnonzero(is_moving.any(0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def sheared(luminance: Image, motion_px: Image) -> Image:
    """`luminance`, shape (H, W), read out row by row while it moves by `motion_px`, shape (H, W, 2).

    The middle row is where it was: a rolling shutter.
    """
    height, width = luminance.shape
    share = ((np.arange(height, dtype=np.float32) + 0.5) / height - 0.5)[:, np.newaxis]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    x, y = x - share * motion_px[..., 0], y - share * motion_px[..., 1]
    return np.asarray(cv2.remap(luminance, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
