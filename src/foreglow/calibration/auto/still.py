"""What stands still in the image while the car drives: the bonnet, reflections, stickers, a logo."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration.auto.views import Grey
from foreglow.geometry import Floats

REDUCTION = 2
"""The mask is found in images that are smaller by this factor."""

BLUR_PX = (3, 3)
MIN_GRADIENT = 10.0
"""Grey levels a pixel, mean over the drive, from which there is an edge; our own light on the road has none."""

STILL_SHARE = 0.85
"""An edge whose mean gradient over the drive has at least this share of its mean strength never moves: elsewhere
gradients of all directions come by and cancel."""

STANDING_SHARE = 0.85
"""If so large a part of all edges never moves, the car stands."""

MIN_RADIAL_COSINE = 0.97
"""An edge below the vanishing point that leads to it this exactly is a lane marking, which stands still as well."""

FAR_SHARE = 0.1
"""Nearer to the vanishing point than this share of the width, far things hardly move."""

BONNET_TOP_SHARE = 0.75
BONNET_WIDTH_SHARE = 0.2
"""A thing that is in the image's lower quarter and at least so wide is the bonnet's edge: all below it is masked."""


class StillEdges:
    """Adds up the gradients of a drive's images."""

    def __init__(self) -> None:
        self._shape = (0, 0)
        self._num = 0
        self._means = np.zeros((2, 0, 0), np.float32)
        self._strengths = np.zeros((0, 0), np.float32)

    def add(self, grey: Grey) -> None:
        """Takes one more image; all have the same shape."""
        size = (grey.shape[1] // REDUCTION, grey.shape[0] // REDUCTION)
        small = cv2.GaussianBlur(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), BLUR_PX, 0)
        gradients = np.stack([cv2.Sobel(small, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1))])
        if not self._num:
            self._shape = grey.shape
            self._means, self._strengths = np.zeros_like(gradients), np.zeros_like(gradients[0])
        self._num += 1
        self._means += gradients
        self._strengths += np.hypot(*gradients)

    def _still(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which pixels have an edge that never moves, and which have any edge."""
        is_edge = self._strengths > MIN_GRADIENT * max(self._num, 1)
        return is_edge & (np.hypot(*self._means) > STILL_SHARE * self._strengths), is_edge

    @property
    def stands(self) -> bool:
        """Whether the car stands, as nearly all edges do; also without any edge."""
        is_still, is_edge = self._still()
        return bool(is_still.sum() >= STANDING_SHARE * is_edge.sum())

    def mask(self, vanishing_px: Floats) -> NDArray[np.bool_]:
        """Shape of the images, True where something stands still.

        Args:
            vanishing_px: Shape (2,), column and row of the images at which lane markings meet; they are left out.
        """
        is_still, _ = self._still()
        height, width = is_still.shape
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        right, down = columns - vanishing_px[0] / REDUCTION, rows - vanishing_px[1] / REDUCTION
        # The gradient of an edge that leads to the vanishing point is across the way from there.
        across = np.abs(self._means[0] * down - self._means[1] * right)
        lengths = np.hypot(*self._means) * np.hypot(right, down)
        is_still &= (down < 0) | (across < MIN_RADIAL_COSINE * lengths)
        is_still &= np.hypot(right, down) > FAR_SHARE * width
        side = max(3, width // 80) | 1
        solid = cv2.morphologyEx(is_still.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
        solid = cv2.morphologyEx(solid, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(solid, connectivity=8)
        for label, (_, top, box_width, _, _) in enumerate(boxes[1:], start=1):
            if top > BONNET_TOP_SHARE * height and box_width > BONNET_WIDTH_SHARE * width:
                below = np.maximum.accumulate(labels == label, axis=0)
                solid[below] = 1
        solid = cv2.dilate(solid, np.ones((3, 3), np.uint8))
        resized = cv2.resize(solid, self._shape[::-1], interpolation=cv2.INTER_NEAREST)
        return np.asarray(resized, np.bool_)
