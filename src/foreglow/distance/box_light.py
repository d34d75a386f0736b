"""What the pixels of a box say about its light: where in the box it is, and the features that tell kinds apart."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import Boxes, Image

NUM_SAMPLES = 9
"""Along either side of a box: the light is read on a grid, which costs the same for boxes of any size."""

_SHARES = (np.arange(NUM_SAMPLES) + 0.5) / NUM_SAMPLES
_RIM = np.array([-0.5, 0.0, 0.5, 1.0, 1.5])
"""Places around a box, in its own widths and heights, where its surroundings are read."""
_RIM_X = np.concatenate([_RIM, _RIM, np.full(3, -0.5), np.full(3, 1.5)])
_RIM_Y = np.concatenate([np.full(5, -0.5), np.full(5, 1.5), _RIM[1:-1], _RIM[1:-1]])

CONTRAST_FLOOR = 5.0
"""Grey levels of 255 that are added to a contrast before its logarithm."""


def light_of_boxes(image: Image, boxes_xyxy_px: Boxes) -> tuple[Floats, Floats]:
    """Where the light of each box is, and how much it stands out.

    Args:
        image: The frame's pixels.
        boxes_xyxy_px: Shape (N, 4).

    Returns:
        Pixels (x, y), shape (N, 2): the mean of the box weighted with the square of what each pixel has above the
        surroundings; the centre of a box without light. And contrasts, shape (N,): the brightest pixel over the
        surroundings in grey levels of 255, at least `CONTRAST_FLOOR`.
    """
    boxes = boxes_xyxy_px.astype(np.float64)
    corners, sizes = boxes[:, :2], boxes[:, 2:] - boxes[:, :2]
    x, y = (corners[:, axis, None] + sizes[:, axis, None] * _SHARES for axis in (0, 1))
    inside = image[_index(y, image.shape[0])[:, :, None], _index(x, image.shape[1])[:, None, :]].astype(np.float64)
    rim_x, rim_y = (corners[:, axis, None] + sizes[:, axis, None] * rim for axis, rim in ((0, _RIM_X), (1, _RIM_Y)))
    rim = image[_index(rim_y, image.shape[0]), _index(rim_x, image.shape[1])].astype(np.float64)
    # Other lights may be beside the box: half of the rim is dark.
    surroundings = np.sort(rim, axis=1)[:, rim.shape[1] // 2]
    above = np.maximum(inside - surroundings[:, None, None], 0.0)
    peaks = above.max(axis=(1, 2), initial=0.0)
    weights = above * above + 1e-9
    totals = weights.sum(axis=(1, 2))
    pixels = np.empty((len(boxes), 2))
    pixels[:, 0] = (weights.sum(axis=1) * x).sum(axis=1) / totals
    pixels[:, 1] = (weights.sum(axis=2) * y).sum(axis=1) / totals
    return pixels, peaks * (255.0 / np.iinfo(image.dtype).max) + CONTRAST_FLOOR


def _index(places_px: Floats, size_px: int) -> np.ndarray:
    """Pixel that holds each place; the nearest one in the image for places outside."""
    return np.minimum(np.maximum(places_px, 0.0), size_px - 0.5).astype(np.intp)
