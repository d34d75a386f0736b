"""Where in a box its light is, and how much it stands out, from the box's pixels."""

from __future__ import annotations

import foreglow._native as _native
from foreglow.geometry import Floats
from foreglow.types import Boxes, Image

CONTRAST_FLOOR = 5.0
"""Grey levels of 255 that are added to a contrast before its logarithm."""


def light_of_boxes(image: Image, boxes_xyxy_px: Boxes) -> tuple[Floats, Floats]:
    """Where the light of each box is, and how much it stands out.

    A box is sampled on a grid of 9 x 9 points, which costs the same for boxes of any size. The surroundings are 16
    points up to half its width and height beyond it; their median counts, since other lights may be among them.

    Args:
        image: The frame's pixels.
        boxes_xyxy_px: Shape (N, 4).

    Returns:
        Pixels (x, y), shape (N, 2): the mean position in the box, weighted with the square of each pixel's excess over
        the surroundings; the centre of a box without light. And contrasts, shape (N,): the brightest pixel over the
        surroundings in grey levels of 255, plus `CONTRAST_FLOOR`.
    """
    adjacent = image if image.strides[1] == image.itemsize else image.copy(order="C")
    pixels, peaks = _native.light_of_boxes(adjacent, boxes_xyxy_px)
    return pixels, 255.0 * peaks + CONTRAST_FLOOR
