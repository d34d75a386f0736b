"""Rear lamps are red: kinds of light by the colour of a box, where the camera has colour.

The network reads grey images, in which rear lamps ahead look like far headlamps. How red a box is,

    r = mean of its red chroma / mean of its grey level,

both from 0 to 1 (Cr + Cb / 2 for the chroma, see `datasets.images.red_chroma`), is about 0 for white light and above 1
for that of a rear lamp that is not clipped. It moves probability from the front kinds to the rear kinds of the same
light, or back:

    log odds of rear <- log odds of rear + w (r - r0),  limited to a change of 4 either way.

Whether there is light of a vehicle at all, the score, does not change.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.types import LIGHT_KINDS, Frame
from foreglow.types.frame import colourless

EVEN_REDNESS = 0.08
"""r0, at which colour says nothing. Chosen, as are the others, on sorted lights of two real clips: decision 23."""

WEIGHT = 30.0
"""w."""

LARGEST_CHANGE = 4.0
"""Of the log odds: colour alone does not outweigh a network that is quite sure."""

_IS_REAR = np.array([name.startswith("rear") for name in LIGHT_KINDS])


def redness(frame: Frame, boxes_xyxy_px: NDArray[np.int32]) -> NDArray[np.float64]:
    """How red each box is, shape (N,), no unit; NaN for a black box, and without colour.

    Args:
        frame: The frame.
        boxes_xyxy_px: Shape (N, 4), half-open, within the frame.
    """
    found = np.full(len(boxes_xyxy_px), np.nan)
    if frame.red_chroma is None:
        return found
    white = np.iinfo(frame.image.dtype).max / np.iinfo(frame.red_chroma.dtype).max
    even = colourless(frame.red_chroma)
    for index, (left, top, right, bottom) in enumerate(boxes_xyxy_px.tolist()):
        grey = cv2.mean(frame.image[top:bottom, left:right])[0] / white
        chroma = cv2.mean(frame.red_chroma[top // 2 : -(-bottom // 2), left // 2 : -(-right // 2)])[0] - even
        if grey > 0:
            found[index] = chroma / grey
    return found


def kinds_by_colour(light_kinds: NDArray[np.float32], redness: NDArray[np.float64]) -> NDArray[np.float32]:
    """The probabilities of `LIGHT_KINDS`, shape (N, 4), given how red the boxes are; unchanged where that is NaN.

    >>> kinds = np.array([[0.6, 0.2, 0.15, 0.05]] * 3, np.float32)
    >>> [f"{rear:.2f}" for rear in kinds_by_colour(kinds, np.array([0.3, 0.08, np.nan]))[:, [1, 3]].sum(axis=1)]
    ['0.95', '0.25', '0.25']
    """
    change = np.clip(
        WEIGHT * (np.nan_to_num(redness, nan=EVEN_REDNESS) - EVEN_REDNESS), -LARGEST_CHANGE, LARGEST_CHANGE
    )
    weighted = light_kinds * np.where(_IS_REAR, np.exp(change)[:, np.newaxis], 1.0)
    return np.asarray(weighted / weighted.sum(axis=1, keepdims=True), light_kinds.dtype)
