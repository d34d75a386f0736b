"""Images of cameras that fill a part of their type only, such as 12 of 16 bits, as if they filled all of it."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np

from foreglow.types.arrays import Image
from foreglow.types.frame import Frame, colourless


def full_scale(frame: Frame, white_level: int | None) -> Frame:
    """`frame` with images in which white is the largest value of their type: models have learnt from such images.

    So it is in its chroma.

    Args:
        frame: A frame.
        white_level: Its camera's white; None for images that fill their type, which stay as they are.
    """
    top = np.iinfo(frame.image.dtype).max
    if white_level is None or white_level >= top:
        return frame
    earlier = None if frame.earlier is None else full_scale(frame.earlier, white_level)
    factor, chroma = top / white_level, frame.red_chroma
    if chroma is not None:
        chroma = _scaled(chroma, factor, colourless(chroma))
    return dataclasses.replace(frame, image=_scaled(frame.image, factor), earlier=earlier, red_chroma=chroma)


def _scaled(image: Image, factor: float, zero: int = 0) -> Image:
    """How far `image` is from `zero`, `factor` times, rounded, and within the type."""
    import cv2

    pixels: Any = np.ascontiguousarray(image)
    if not zero:
        return cast("Image", cv2.multiply(pixels, cast("Any", factor)))
    return cast("Image", cv2.addWeighted(pixels, factor, pixels, 0.0, zero * (1.0 - factor)))
