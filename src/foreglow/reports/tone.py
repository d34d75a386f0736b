"""Makes night frames visible: grey values of any depth to 8 bits for the eye."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.types import Image

TARGET_MEDIAN = 0.12
"""Brightness that the median pixel of the first frame is lifted to, of 1; tuned by eye on dark and lit roads."""


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

        Display = ((v - black) / (white - black)) ^ gamma, where black is the 1st percentile of `image`; white is
        the full scale for 8 bits and, for 16 bits, the next power of two above the brightest pixel, since cameras
        fill 10 or 12 of the 16 bits; and gamma, between 0.45 and 1, lifts the median to `TARGET_MEDIAN`.
        """
        num_values = np.iinfo(image.dtype).max + 1
        black, median, highest = np.percentile(image, (1, 50, 100)).tolist()
        white = num_values - 1 if image.dtype == np.uint8 else 2 ** int(highest).bit_length() - 1
        span = max(1.0, white - black)
        relative = (median - black) / span
        gamma = float(np.clip(np.log(TARGET_MEDIAN) / np.log(relative), 0.45, 1.0)) if 0.0 < relative < 1.0 else 0.45
        values = np.clip((np.arange(num_values) - black) / span, 0.0, 1.0)
        return cls(np.rint(255.0 * values**gamma).astype(np.uint8))

    def apply(self, image: Image) -> NDArray[np.uint8]:
        """`image` as display values, same shape, uint8.

        Raises:
            ValueError: If the dtype is not that of the frame the curve was made for.
        """
        if np.iinfo(image.dtype).max + 1 != len(self.curve):
            raise ValueError(f"Frame.image: expected frames of one depth, got {image.dtype} after another")
        return np.asarray(self.curve[image])
