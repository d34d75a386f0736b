"""Images of cameras that fill a part of their type only, such as 12 of 16 bits, as if they filled all of it."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from foreglow.types.arrays import Image
from foreglow.types.frame import COLOURLESS, Frame


def full_scale(frame: Frame, white_level: int | None) -> Frame:
    """`frame` with images in which white is the largest value of their type: models have learnt from such images.

    Args:
        frame: A frame.
        white_level: Its camera's white; None for images that fill their type, which stay as they are.
    """
    top = np.iinfo(frame.image.dtype).max
    if white_level is None or white_level >= top:
        return frame
    earlier = None if frame.earlier is None else full_scale(frame.earlier, white_level)
    chroma = None if frame.red_chroma is None else _redder(frame.red_chroma, top / white_level)
    return dataclasses.replace(frame, image=_scaled(frame.image, top / white_level), earlier=earlier, red_chroma=chroma)


def _redder(chroma: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    """`Frame.red_chroma`, which is a share of white as well, as much further from that of white light."""
    import cv2

    table = np.clip(np.rint(COLOURLESS + factor * (np.arange(256) - COLOURLESS)), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(np.ascontiguousarray(chroma), table), np.uint8)


def _scaled(image: Image, factor: float) -> Image:
    import cv2

    scalar: Any = factor
    return cast("Image", cv2.multiply(np.ascontiguousarray(image), scalar))  # rounded, and at most the largest value
