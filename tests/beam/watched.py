"""What the camera watch is shown: the drive that ships, noise, and parts of old images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foreglow.datasets import open_source, shipped_drive
from foreglow.types import Image


def road_ahead() -> list[Image]:
    """The road ahead in the drive that ships, 480x320."""
    return [frame.image[440:760, 400:880].copy() for frame in open_source(shipped_drive())]


def with_noise(images: Sequence[Image]) -> list[Image]:
    """The images with new noise: read-out's, and that of light."""
    rng = np.random.default_rng(0)
    return [np.clip(rng.normal(image, np.sqrt(0.8**2 + 0.02 * image)), 0, 255).astype(np.uint8) for image in images]


def part_of_an_old_image(images: Sequence[Image], old: Image, part: float) -> list[Image]:
    """The left part of the images is that of an old one."""
    stuck = [image.copy() for image in images]
    for image in stuck:
        image[:, : round(part * image.shape[1])] = old[:, : round(part * image.shape[1])]
    return stuck
