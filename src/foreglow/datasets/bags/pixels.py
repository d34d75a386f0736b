"""From the pixels of an image message to a grey image; the encodings are those of ROS and Foxglove."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.images import check_size, to_grey
from foreglow.types import Image


@dataclass(frozen=True, slots=True)
class _Layout:
    """How an encoding stores pixels.

    Attributes:
        depth: Bytes per value.
        channels: Values per pixel.
        order: Order of the colours, if there are any.
        bayer: OpenCV's conversion of a colour mosaic.
    """

    depth: int
    channels: int = 1
    order: Literal["rgb", "bgr"] = "rgb"
    bayer: int | None = None


def _layouts() -> dict[str, _Layout]:
    layouts = {"8UC1": _Layout(1), "16UC1": _Layout(2)}
    for depth, bits in ((1, "8"), (2, "16")):
        layouts |= {
            f"mono{bits}": _Layout(depth),
            f"rgb{bits}": _Layout(depth, 3, "rgb"),
            f"bgr{bits}": _Layout(depth, 3, "bgr"),
            f"rgba{bits}": _Layout(depth, 4, "rgb"),
            f"bgra{bits}": _Layout(depth, 4, "bgr"),
            # ROS names the upper left 2x2 pixels by rows, and so do these names of OpenCV.
            f"bayer_rggb{bits}": _Layout(depth, bayer=cv2.COLOR_BayerRGGB2GRAY),
            f"bayer_bggr{bits}": _Layout(depth, bayer=cv2.COLOR_BayerBGGR2GRAY),
            f"bayer_gbrg{bits}": _Layout(depth, bayer=cv2.COLOR_BayerGBRG2GRAY),
            f"bayer_grbg{bits}": _Layout(depth, bayer=cv2.COLOR_BayerGRBG2GRAY),
        }
    return layouts


ENCODINGS: Mapping[str, _Layout] = MappingProxyType(_layouts())
"""Encodings by name. Source: sensor_msgs/image_encodings.hpp; foxglove.RawImage."""


@dataclass(frozen=True, slots=True)
class Pixels:
    """The pixels of an image message.

    Attributes:
        height_px: Rows.
        width_px: Columns.
        encoding: A name in `ENCODINGS`.
        is_big_endian: Whether values of two bytes have the more significant byte first.
        step: Bytes from a row to the next.
        data: All bytes.
    """

    height_px: int
    width_px: int
    encoding: str
    is_big_endian: bool
    step: int
    data: memoryview


def grey_image(pixels: Pixels) -> Image:
    """The grey image, shape (height, width), uint8 or uint16, an array of its own; colour becomes grey as in `to_grey`.

    Raises:
        ValueError: If the encoding is unknown, the size is not accepted, the step is too short or the data do not fit
            size and step; the message starts with the field.
    """
    layout = ENCODINGS.get(pixels.encoding)
    if layout is None:
        raise ValueError(f"encoding: expected one of {', '.join(ENCODINGS)}, got {pixels.encoding!r}")
    height, width, step = pixels.height_px, pixels.width_px, pixels.step
    check_size(height, width, "header")
    row = width * layout.channels * layout.depth
    if step < row:
        raise ValueError(f"step: expected at least {row} bytes for {width} px of {pixels.encoding}, got {step}")
    if len(pixels.data) != height * step:
        raise ValueError(f"data: expected {height * step} bytes by height and step, got {len(pixels.data)}")
    rows: NDArray[Any] = np.frombuffer(pixels.data, np.uint8).reshape(height, step)[:, :row].copy()
    values: Any = rows if layout.depth == 1 else rows.view(">u2" if pixels.is_big_endian else "<u2").astype(np.uint16)
    if layout.bayer is not None:
        values = cv2.cvtColor(values, layout.bayer)
    return to_grey(np.asarray(values).reshape(height, width, layout.channels), order=layout.order)
