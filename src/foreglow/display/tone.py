"""Makes night frames visible: grey values of any depth to 8 bits for the eye."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.types import Image

BLACK_PERCENTILE = 10.0
"""What is as dark as this share of the first frame becomes black: the lower half of the night sky's noise."""

UPPER_PERCENTILE, UPPER_TARGET = 75.0, 0.3
"""This percentile of the first frame, the lit road, is lifted to this brightness, of 1; tuned by eye on dark and lit
roads, simulated and real."""

STRETCHES = np.geomspace(0.01, 30.0, 400)
"""Stretches to choose from; the first is a straight line, the last lifts the dark seven-fold."""


LEAST_BITS = 10
"""Of what cameras fill of 16 bits. A first frame that is black says less than this, and lamps come later."""


@dataclass(frozen=True, slots=True, eq=False)
class Tone:
    """A fixed curve from grey values to display values; one for a whole video, so that it does not flicker.

    Attributes:
        curve: Display value of every grey value, uint8, one entry for each value of the frames' dtype.
    """

    curve: NDArray[np.uint8]

    @classmethod
    def of(cls, image: Image) -> Tone:
        """The curve that suits `image` and frames like it.

        Display = asinh(k v) / asinh(k), straight where it is dark and logarithmic above, so that faint light is seen
        and lamps are not burnt out; v = (value - black) / (white - black). Black is a low percentile of `image`;
        white is the full scale for 8 bits and, for 16 bits, the next power of two above the brightest pixel, since
        cameras fill 10 or 12 of the 16 bits, and at least that of `LEAST_BITS`; k lifts a high percentile to
        `UPPER_TARGET` as far as `STRETCHES` go.

        Source of the curve: Lupton et al., Preparing red-green-blue images from CCD data, PASP 116 (2004), eq. 2.
        """
        num_values = np.iinfo(image.dtype).max + 1
        black, upper, highest = np.percentile(image, (BLACK_PERCENTILE, UPPER_PERCENTILE, 100.0)).tolist()
        num_bits = 8 if image.dtype == np.uint8 else max(LEAST_BITS, int(highest).bit_length())
        white = 2**num_bits - 1
        span = max(1.0, white - black)
        lifted = np.arcsinh(STRETCHES * (upper - black) / span) / np.arcsinh(STRETCHES)
        stretch = STRETCHES[min(int(np.searchsorted(lifted, UPPER_TARGET)), len(STRETCHES) - 1)]
        values = np.clip((np.arange(num_values) - black) / span, 0.0, 1.0)
        return cls(np.rint(255.0 * np.arcsinh(stretch * values) / np.arcsinh(stretch)).astype(np.uint8))

    def fits(self, image: Image) -> bool:
        """Whether the curve is for images of this depth."""
        return bool(np.iinfo(image.dtype).max + 1 == len(self.curve))

    def apply(self, image: Image) -> NDArray[np.uint8]:
        """`image` as display values, same shape, uint8.

        Raises:
            ValueError: If the dtype is not that of the frame the curve was made for.
        """
        if not self.fits(image):
            raise ValueError(f"Frame.image: expected frames of one depth, got {image.dtype} after another")
        if image.dtype == np.uint8:
            return np.asarray(cv2.LUT(image, self.curve), np.uint8)  # five times as quick as an index
        return np.asarray(self.curve[image])
