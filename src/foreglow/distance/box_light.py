"""What the pixels of a box say about its light: where in the box it is, and how much it stands out."""

from __future__ import annotations

from foreglow import _native
from foreglow.geometry import Floats
from foreglow.types import Boxes, Image

CONTRAST_FLOOR = 5.0
"""Grey levels of 255 that are added to a contrast before its logarithm."""


def light_of_boxes(image: Image, boxes_xyxy_px: Boxes) -> tuple[Floats, Floats]:
    """Where the light of each box is, and how much it stands out.

    A box is read on a grid of 9 x 9 places, which costs the same for boxes of any size. Its surroundings are read half
    its width and height around it; since other lights may be beside the box, half of them count as dark.

    Args:
        image: The frame's pixels.
        boxes_xyxy_px: Shape (N, 4).

    Returns:
        Pixels (x, y), shape (N, 2): the mean of the box weighted with the square of what each pixel has above the
        surroundings; the centre of a box without light. And contrasts, shape (N,): the brightest pixel over the
        surroundings in grey levels of 255, at least `CONTRAST_FLOOR`.
    """
    adjacent = image if image.strides[1] == image.itemsize else image.copy(order="C")
    pixels, peaks = _native.light_of_boxes(adjacent, boxes_xyxy_px)
    return pixels, 255.0 * peaks + CONTRAST_FLOOR
