"""Images of cameras that fill a part of their type only, such as 12 of 16 bits, as if they filled all of it."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np

from foreglow.types.arrays import Image
from foreglow.types.frame import Frame


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
    return dataclasses.replace(frame, image=_scaled(frame.image, top / white_level), earlier=earlier)


def _scaled(image: Image, factor: float) -> Image:
    import cv2

    scalar: Any = factor
    return cast("Image", cv2.multiply(np.ascontiguousarray(image), scalar))  # rounded, and at most the largest value
