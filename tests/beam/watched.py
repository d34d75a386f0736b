"""What the camera watch is shown: the drive that ships, noise, and parts of old images."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import cv2
import numpy as np

from foreglow.datasets import open_source, shipped_drive
from foreglow.types import Image


def road_ahead() -> list[Image]:
    """The road ahead in the drive that ships, 480x320."""
    return [image.copy() for image in _road_ahead()]


@functools.cache
def _road_ahead() -> list[Image]:
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


def with_clock(images: Sequence[Image], *, is_at_top: bool = False) -> list[Image]:
    """The images with what a recorder writes into them: the time to the millisecond, and a speed."""
    written = [image.copy() for image in images]
    for number, image in enumerate(written):
        size = image.shape[0] / 640
        row = round(image.shape[0] * (0.06 if is_at_top else 0.98))
        text = f"2026-11-26 22:14:{number // 18:02d}.{number % 18 * 55:03d} {80 + number // 6 % 5} km/h"
        cv2.putText(image, text, (10, row), cv2.FONT_HERSHEY_SIMPLEX, size, 255, max(1, round(2 * size)))
    return written
