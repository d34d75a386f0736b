"""Text and lines of pictures that are drawn at any height."""

from __future__ import annotations

from typing import Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import ArrayLike

from foreglow.display.overlay import Colour, Picture

Anchor: TypeAlias = Literal["left", "middle", "right"]

REFERENCE_HEIGHT_PX = 1080
"""Sizes are given for pictures of this height."""

SUBPIXEL_BITS = 4

CAPITALS_PX = 21.0
"""Height of capitals of OpenCV's font at scale 1."""

SMALLEST_SCALE, BOLD_SCALE = 0.3, 0.8
"""Text is not made smaller than the one, and has bolder lines from the other on."""

SHARES_LEFT: dict[Anchor, float] = {"left": 0.0, "middle": 0.5, "right": 1.0}

_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Pen:
    """Draws with sizes in pixels of a picture of `REFERENCE_HEIGHT_PX` rows, scaled to the height at hand."""

    def __init__(self, height_px: int) -> None:
        self._unit = height_px / REFERENCE_HEIGHT_PX

    def px(self, size: float) -> int:
        """A size in pixels of the picture, at least 1."""
        return max(1, round(size * self._unit))

    def write(
        self, picture: Picture, text: str, at_px: tuple[float, float], colour: Colour, size: float = 14, **how: Anchor
    ) -> None:
        """Writes `text` on one line.

        Args:
            picture: Where to.
            text: ASCII.
            at_px: x and y of the baseline, picture pixels.
            colour: Of the text.
            size: Height of capitals.
            how: `anchor`: which end of the text lies at x; `left` where not given.
        """
        left_px = at_px[0] - SHARES_LEFT[how.get("anchor", "left")] * self.width_px(text, size)
        scale, line_px = self._scale(size)
        cv2.putText(picture, text, (round(left_px), round(at_px[1])), _FONT, scale, colour, line_px, cv2.LINE_AA)

    def width_px(self, text: str, size: float = 14) -> int:
        """How wide `write` makes `text`."""
        return int(cv2.getTextSize(text, _FONT, *self._scale(size))[0][0])

    def _scale(self, size: float) -> tuple[float, int]:
        """OpenCV's scale and line width for capitals of a height."""
        scale = max(SMALLEST_SCALE, size * self._unit / CAPITALS_PX)
        return scale, 1 if scale < BOLD_SCALE else 2

    def line(self, picture: Picture, points_px: ArrayLike, colour: Colour, width: float = 1.5) -> None:
        """Draws a line through points of shape (N, 2), x and y; it may leave the picture."""
        fine = np.clip(np.asarray(points_px, np.float64), -2e4, 2e4) * 2**SUBPIXEL_BITS
        path = [np.rint(fine).astype(np.int32).reshape(-1, 1, 2)]
        cv2.polylines(picture, path, False, colour, self.px(width), cv2.LINE_AA, SUBPIXEL_BITS)
