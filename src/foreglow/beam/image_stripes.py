"""Whether an image consists of stripes, such as where every second row is stuck or black, by rows that differ in turn.

Neighbouring rows of a camera change alike. If some are stuck, or are filled, those change that are not, and an encoder
of blocks blurs that, but does not hide it. The same holds for columns. Bands of 32 adjacent rows and columns are looked
at, 16 of each.
"""

from __future__ import annotations

import numpy as np

import foreglow._native as _native
from foreglow.geometry import Floats
from foreglow.types import Image
from foreglow.types.arrays import with_adjacent_columns


class ImageStripes:
    """Compares the changes of neighbouring rows, and of neighbouring columns, of which it keeps some pixels only."""

    def __init__(self) -> None:
        self._stripes = _native.ImageStripes()

    def reset(self) -> None:
        """Forgets the image before."""
        self._stripes.reset()

    def update(self, image: Image, top: int) -> Floats | None:
        """How much rows and columns differ in turn in the next image; None for the first, and at another size or type.

        Args:
            image: Shape (H, W).
            top: The greatest value that a pixel may have.

        Returns:
            Shape (2, 7), by rows and by columns. The first six: the median difference of the changes of two that are 1,
            2, 3, 4, 6 and 8 px apart, relative to the sum of these changes, 0 to 1; of stripes as wide as that, one
            changes and the other does not. The last: how much neighbours differ over how much the next but one do, near
            1 for noise, and less for all that a lens shows.
        """
        found = self._stripes.update(with_adjacent_columns(image), top)
        return None if found is None else np.array(found)
