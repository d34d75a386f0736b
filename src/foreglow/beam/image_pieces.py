"""Whether an image shows anything, and whether it moves: two measures that no noise, however strong or new, can feign.

Rows are cut into pieces. Where a lens is covered, all pieces are about alike, at whatever level the camera has its
black. Where a picture stands still, or is nothing but noise, its pieces change by noise alone: by a Gaussian, whose
99.9th percentile is 4.9 times its median. What moves changes a few pieces by far more than the others.
"""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import Image

PIECE_PX = 16

NOISE_RATIO = 7.0
"""Where the strong changes are less than so many times the median change, noise alone has changed the image. Measured:
a still picture under noise of 1 to 10 grey levels 3.5 to 6.3, also behind MJPEG, but above 7 behind H.264; the drive
that ships at least 26, raw and coded, and 12 under noise of 12 grey levels; two real videos of motorways 1,000."""

DRIFT_RATIO = 4.0
"""Where the median change is not so many times the median with its sign, the light has changed, or the exposure."""

STRONG_SHARE = 0.001
"""The share of pieces that change by more than the strong change."""

LEAST_NOISE = 1e-3
"""Median change, in shares of the greatest value, below which an encoder has removed the noise, or it was never new."""


class ImagePieces:
    """Compares the pieces of each image with each other, and with those of the image before."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets the image before."""
        self._before: Floats = np.zeros((0, 0))

    def update(self, rows: Image, top: int) -> tuple[float, bool]:
        """The contrast of the next image, and whether only its noise differs from the image before.

        Args:
            rows: Some rows of the image, always the same ones.
            top: The greatest value of a pixel.

        Returns:
            The difference of the brightest and the darkest piece, in shares of `top`; whether noise alone changed.
        """
        piece_px = min(PIECE_PX, rows.shape[1])
        width_px = rows.shape[1] // piece_px * piece_px
        means = rows[:, :width_px].reshape(len(rows), -1, piece_px).mean(axis=2) / top
        before, self._before = self._before, means
        is_noise = False
        if before.shape == means.shape:
            changes = (means - before).ravel()
            drift = abs(np.median(changes))
            changes = np.abs(changes)
            middle, strong = changes.size // 2, int((1.0 - STRONG_SHARE) * (changes.size - 1))
            changes.partition((middle, strong))
            is_noise = bool(
                changes[middle] > max(LEAST_NOISE, DRIFT_RATIO * drift)
                and changes[strong] < NOISE_RATIO * changes[middle]
            )
        return float(means.max() - means.min()), is_noise
