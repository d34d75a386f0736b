"""From the ranges of a box's pixels to the range of the box: the paper's heuristics.

`maximum`, `minimum`, `mean` and `median` use 3 x 3 sample points instead of every pixel (`all_pixels`), evenly spread
from the centre of the first pixel to that of the last one along both axes. Ranges change smoothly over a box: the
extremes of GP are at these points; an extreme of PSD may lie between them and be off by a few per cent in boxes of 20
pixels; mean and median weigh the rim a little more than all pixels would.

Source: Ewecker et al., arXiv 2107.11302, distance estimation (the heuristics; the sample points are ours).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import Boxes

Reduction: TypeAlias = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""From ranges and sigmas at the sample points, shape (N, K), to those of the boxes, shape (N,); NaN where all are."""


@dataclass(frozen=True, slots=True, eq=False)
class Heuristic:
    """A rule that gives a box one range.

    Attributes:
        shares: Shape (K, 2), the sample points: (0, 0) is the centre of the upper left pixel, (1, 1) that of the lower
            right one.
        reduce: Makes one range out of theirs.
    """

    shares: Floats
    reduce: Reduction

    @property
    def is_sampled(self) -> bool:
        """Whether it goes by a sample of the box's pixels, in place of all of them."""
        return len(self.shares) > 1

    def pixels(self, boxes_xyxy_px: Boxes) -> Floats:
        """The sample points of the boxes, shape (N, K, 2), columns x and y, full-frame pixels.

        >>> HEURISTICS["lowest"].pixels(np.array([[10, 20, 13, 24]], np.int32)).tolist()
        [[[11.5, 23.5]]]
        """
        corners = boxes_xyxy_px.astype(np.float64)
        first, last = corners[:, None, :2] + 0.5, corners[:, None, 2:] - 0.5
        return np.asarray(first + self.shares * (last - first))


def all_pixels(box_xyxy_px: Sequence[int]) -> Floats:
    """The centres of all pixels of a box, shape (1, K, 2), columns x and y.

    >>> all_pixels((10, 20, 12, 21)).tolist()
    [[[10.5, 20.5], [11.5, 20.5]]]
    """
    x1, y1, x2, y2 = box_xyxy_px
    grid = np.meshgrid(np.arange(x1, x2) + 0.5, np.arange(y1, y2) + 0.5)
    return np.stack(grid, -1).reshape(1, -1, 2)


def only(ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    """Range and sigma of the only sample point."""
    return ranges_m[:, 0], sigmas_m[:, 0]


def at_maximum(ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    """Range and sigma of the farthest sample point."""
    return _at(np.where(np.isnan(ranges_m), -np.inf, ranges_m).argmax(axis=1), ranges_m, sigmas_m)


def at_minimum(ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    """Range and sigma of the nearest sample point."""
    return _at(np.where(np.isnan(ranges_m), np.inf, ranges_m).argmin(axis=1), ranges_m, sigmas_m)


def mean(ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    """Means over the sample points with a range; their errors are the same, so sigmas do not shrink."""
    is_known = ~np.isnan(ranges_m)
    num = is_known.sum(axis=1)
    sums = np.where(is_known, ranges_m, 0.0).sum(axis=1), np.where(is_known, sigmas_m, 0.0).sum(axis=1)
    divisor = np.maximum(num, 1)
    return np.where(num > 0, sums[0] / divisor, np.nan), np.where(num > 0, sums[1] / divisor, np.inf)


def median(ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    """Range and sigma of the middle sample point, or the means of the two middle ones."""
    order = ranges_m.argsort(axis=1)  # NaN comes last
    num = (~np.isnan(ranges_m)).sum(axis=1)
    rows = np.arange(len(order))
    lower, upper = order[rows, np.maximum(num - 1, 0) // 2], order[rows, num // 2 % order.shape[1]]
    upper = np.where(num > 0, upper, lower)
    return (
        (ranges_m[rows, lower] + ranges_m[rows, upper]) / 2,
        (sigmas_m[rows, lower] + sigmas_m[rows, upper]) / 2,
    )


def _at(columns: np.ndarray, ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
    rows = np.arange(len(columns))
    return ranges_m[rows, columns], sigmas_m[rows, columns]


_STEPS = np.linspace(0.0, 1.0, 3)
_GRID = np.stack(np.meshgrid(_STEPS, _STEPS), -1).reshape(-1, 2)

HEURISTICS: dict[str, Heuristic] = {
    "centre": Heuristic(np.array([[0.5, 0.5]]), only),
    "maximum": Heuristic(_GRID, at_maximum),
    "minimum": Heuristic(_GRID, at_minimum),
    "lowest": Heuristic(np.array([[0.5, 1.0]]), only),
    "mean": Heuristic(_GRID, mean),
    "median": Heuristic(_GRID, median),
}
"""All heuristics by name, the paper's six."""
