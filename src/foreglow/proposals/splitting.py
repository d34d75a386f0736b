"""Splitting blobs with several peaks of light, such as a lamp and its reflection on the road: the specification.

With a wide window and no limit on the area, large bright objects are found, but a near lamp and all the light around it
end up in one box. Here the pixels of a blob are flooded from the brightest down, as in a watershed. Where the floods
from two peaks meet at a saddle far below the lower peak, the parts stay separate and their boxes stop growing: the glow
further down belongs to neither lamp in particular. Levels are whole numbers, so that every back end decides alike.

Source: topographic persistence, as in Edelsbrunner, Letscher and Zomorodian, Discrete & Computational Geometry 28
(2002).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Extent: TypeAlias = tuple[int, int, int, int]
"""Half-open y1, x1, y2, x2 in working pixels."""

TOP_LEVEL = 1023


@dataclass(frozen=True, slots=True)
class SplitRule:
    """When a blob is split.

    Attributes:
        saddle: The highest saddle that still separates two peaks, as a share of the lower peak.
        min_area_px: A part needs at least this many pixels, and a box of at least this area.
        min_width_px: The box of a part is at least this wide.
    """

    saddle: float
    min_area_px: float
    min_width_px: float


@dataclass(slots=True, eq=False)
class _Part:
    """The pixels that have been flooded from one peak."""

    peak: int
    extent: Extent
    pixels: list[tuple[int, int]] = field(default_factory=list)
    is_closed: bool = False

    def take(self, pixels: list[tuple[int, int]], extent: Extent) -> None:
        """Adds pixels; the extent grows unless it is closed."""
        self.pixels += pixels
        if not self.is_closed:
            low, high = np.minimum(self.extent, extent), np.maximum(self.extent, extent)
            self.extent = int(low[0]), int(low[1]), int(high[2]), int(high[3])


def light_levels(sums: NDArray[np.int64], black: int, white: int) -> NDArray[np.int64]:
    """Light as whole numbers, from 0 at `black` to 1023 at `white`, smoothed by (1 2 1) / 4 along both axes.

    Args:
        sums: Shape (height, width), sums over blocks of the frame; borders are mirrored about the border pixel.
        black: The sum of a block without light.
        white: The sum of a block with full light.

    >>> light_levels(np.array([[0, 0, 0, 0], [0, 0, 16, 0], [0, 0, 0, 0]]), 0, 16).tolist()
    [[0, 127, 255, 255], [0, 127, 255, 255], [0, 127, 255, 255]]
    """
    from scipy import ndimage

    taps = np.array([1, 2, 1])  # whole numbers below 2^53 are exact in double precision
    smoothed = ndimage.correlate1d(ndimage.correlate1d(sums, taps, axis=1, mode="mirror"), taps, axis=0, mode="mirror")
    return np.asarray((smoothed - 16 * black) * TOP_LEVEL // (16 * (white - black)))


def split_blob(
    blob: Extent, binary: NDArray[np.bool_], levels: NDArray[np.int64], rule: SplitRule
) -> tuple[Extent, ...]:
    """The parts of `blob`, or `blob` alone if it is not split.

    All set pixels in the blob's box are visited from the highest level down, row by row where levels are equal. A pixel
    joins the part with the highest peak among its eight neighbours (the first of equals), or starts a new part. Every
    other part that it touches is merged into that one, unless it has `min_area_px` pixels already and the pixel's level
    is at most `saddle` times its peak: then the boxes of both are closed, and pixels that join later no longer enlarge
    them. Once the part with the highest peak is closed, parts of that size are never merged into it, since its box
    could not show them. The blob is split if at least two parts are large enough.

    Args:
        blob: Box of the blob.
        binary: Shape (height, width): which pixels are above the threshold.
        levels: Shape (height, width), from `light_levels`.
        rule: When to split.

    >>> row = np.array([[9, 9, 1, 5, 5]])
    >>> split_blob((0, 0, 1, 5), row > 0, row, SplitRule(0.5, 2, 1))
    ((0, 0, 1, 3), (0, 3, 1, 5))
    >>> split_blob((0, 0, 1, 5), row > 0, row, SplitRule(0.1, 2, 1))
    ((0, 0, 1, 5),)
    """
    y1, x1, y2, x2 = blob
    rows, columns = np.nonzero(binary[y1:y2, x1:x2])
    heights = levels[y1:y2, x1:x2][rows, columns]
    part_of: dict[tuple[int, int], _Part] = {}
    parts: list[_Part] = []  # in the order of their peaks
    for index in np.argsort(-heights, kind="stable"):
        y, x, level = int(rows[index]), int(columns[index]), int(heights[index])
        around = {part_of.get((y + dy, x + dx)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)}
        met = sorted((part for part in around if part is not None), key=parts.index)
        if not met:
            met = [_Part(level, (y, x, y + 1, x + 1))]
            parts.append(met[0])
        highest = max(met, key=lambda part: part.peak)  # the first of equals
        highest.take([(y, x)], (y, x, y + 1, x + 1))
        part_of[y, x] = highest
        for part in met:
            if part is highest:
                continue
            is_deep = highest.is_closed or level <= rule.saddle * part.peak
            if is_deep and len(part.pixels) >= rule.min_area_px:
                part.is_closed = highest.is_closed = True
                continue
            highest.take(part.pixels, part.extent)
            part_of.update(dict.fromkeys(part.pixels, highest))
            parts.remove(part)
    large = [part.extent for part in parts if _is_large(part.extent, rule)]
    if len(large) < 2:
        return (blob,)
    return tuple((y1 + top, x1 + left, y1 + bottom, x1 + right) for top, left, bottom, right in large)


def _is_large(extent: Extent, rule: SplitRule) -> bool:
    height_px, width_px = extent[2] - extent[0], extent[3] - extent[1]
    return width_px * height_px >= rule.min_area_px and width_px >= rule.min_width_px
