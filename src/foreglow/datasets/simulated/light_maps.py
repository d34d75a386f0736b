"""Whose light is where: an image of the light of each source, beside the shares of the proposals' boxes.

`simulation/S00001/light/010000.png` is a grey PNG of 8 bits: the six sources of `SOURCES` one below the other, each at
a quarter of the camera's width and height. A value g stands for 1e-4 (exp(g / 13) - 1) cd/m²: steps of 8 %, up to 3e4
cd/m². From these maps follow the shares of any box, to the accuracy of cells of 4x4 pixels, and targets for networks
that need no boxes.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.images import read_image
from foreglow.datasets.simulated.shares import SOURCES
from foreglow.types import Image

CELL_PX = 4
"""Pixels of the camera in each cell, along each axis."""

_DARKEST_CD_M2, _STEPS = 1e-4, 13.0


def reduced(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean light in each cell, shape (6, H // 4, W // 4), of light on the pixels, shape (6, H, W), cd/m²."""
    height, width = (size // CELL_PX for size in light.shape[1:])
    whole = light[:, : height * CELL_PX, : width * CELL_PX]
    return np.stack([cv2.resize(source, (width, height), interpolation=cv2.INTER_AREA) for source in whole])


def encoded(cells: NDArray[np.float32]) -> NDArray[np.uint8]:
    """What the file stores of the light in cells, shape (6, h, w), as one image of shape (6 h, w).

    >>> encoded(np.full((6, 1, 1), 1.0, np.float32))[:, 0].tolist()
    [120, 120, 120, 120, 120, 120]
    """
    grey = np.rint(_STEPS * np.log1p(np.maximum(cells, 0.0) / _DARKEST_CD_M2))
    return np.clip(grey, 0, 255).astype(np.uint8).reshape(-1, cells.shape[2])


def decoded(stored: Image) -> NDArray[np.float32]:
    """Light in cells, shape (6, h, w), cd/m², from the image that a file stores.

    Raises:
        ValueError: If its height is no multiple of six, or it has not 8 bits.
    """
    if stored.dtype != np.uint8 or stored.ndim != 2 or stored.shape[0] % len(SOURCES):
        raise ValueError(
            f"light map: expected a grey image of 8 bits and {len(SOURCES)} parts, got shape {stored.shape}"
        )
    light = _DARKEST_CD_M2 * np.expm1(stored.astype(np.float32) / np.float32(_STEPS))
    return np.asarray(light.reshape(len(SOURCES), -1, stored.shape[1]), np.float32)


def light_map_path(sequence: Path, image_id: int) -> Path:
    """The map of an image in the folder of its sequence's truth; only data sets with shares have it."""
    return sequence / "light" / f"{image_id:06d}.png"


def read_light_map(path: Path | str) -> NDArray[np.float32]:
    """Light in cells, shape (6, h, w), cd/m², in the order of `SOURCES`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a light map; the message names it.
    """
    try:
        return decoded(read_image(path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
