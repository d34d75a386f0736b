"""Peaks of an image by topographic persistence: hills that are separated by valleys, not every ripple."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Summits, highest first.

    Attributes:
        rows: Shape (N,), intp.
        columns: Shape (N,), intp.
        heights: Shape (N,), float64.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    heights: Floats

    def __len__(self) -> int:
        return len(self.heights)


def find_peaks(field: NDArray[np.float32], floor: float, saddle: float) -> Peaks:
    """The peaks of `field` above `floor` that are hills of their own.

    While the water falls from the highest summit to `floor`, islands (8 neighbours) rise and grow together. Where
    two islands meet, the lower summit counts if the water is then below `saddle` times its height, and is a ripple of
    the higher summit otherwise. Each pixel climbs to its steepest neighbour until it is on a summit; two summits are
    joined by the highest pair of neighbours on either side. That is exact, and needs a loop only over the pairs of
    summits. Of equal pixels the first in reading order counts as the higher.

    Args:
        field: Shape (H, W), finite.
        floor: Pixels at or below are ignored; not negative.
        saddle: 0 keeps only the highest summit of each island, 1 keeps nearly all summits.

    Source: Edelsbrunner, Letscher, Zomorodian, Topological persistence and simplification, 2002.

    >>> find_peaks(np.array([[9, 1, 8, 7, 8.5]], np.float32), 0.0, 0.5).columns
    array([0, 4])
    """
    padded = np.full((field.shape[0] + 2, field.shape[1] + 2), -np.inf, np.float32)
    padded[1:-1, 1:-1] = np.where(field > floor, field, -np.inf)
    stride, flat = padded.shape[1], padded.ravel()
    pixels = np.flatnonzero(flat > -np.inf)
    heights = flat[pixels]
    numbers = np.full(flat.size, -1, np.int32)
    numbers[pixels] = np.arange(len(pixels), dtype=np.int32)

    summit_of = numbers[pixels + _steepest_steps(flat, pixels, stride)]
    while not np.array_equal(summit_of, higher := summit_of[summit_of]):
        summit_of = higher
    summits = np.flatnonzero(summit_of == np.arange(len(pixels)))
    basin_of_summit = np.zeros(len(pixels), np.int32)
    basin_of_summit[summits] = np.arange(len(summits))
    basins = basin_of_summit[summit_of]

    passes, pass_heights = _passes(basins, heights, numbers, pixels, stride)
    kept = summits[_kept_summits(heights[summits], passes, pass_heights, saddle)]
    # Stable: summits are in reading order, which breaks ties.
    kept = kept[np.argsort(-heights[kept], kind="stable")]
    rows, columns = np.divmod(pixels[kept], stride)
    return Peaks(rows - 1, columns - 1, heights[kept].astype(np.float64))


def area_above_half_px(field: NDArray[np.float32], row: int, column: int) -> int:
    """Pixels around (row, column), joined by 8 neighbours, that reach half of its height."""
    mask = np.zeros((field.shape[0] + 2, field.shape[1] + 2), np.uint8)
    flags = 8 | cv2.FLOODFILL_FIXED_RANGE | cv2.FLOODFILL_MASK_ONLY
    half = float(field[row, column]) / 2
    return int(cv2.floodFill(field, mask, (column, row), 0, half, np.inf, flags)[0])


def _steepest_steps(flat: NDArray[np.float32], pixels: NDArray[np.intp], stride: int) -> NDArray[np.intp]:
    """The step from each pixel to the highest of itself and its neighbours; of equal pixels the first."""
    steps = np.zeros(len(pixels), np.intp)
    best = np.full(len(pixels), -np.inf, np.float32)
    for step in (-stride - 1, -stride, -stride + 1, -1, 0, 1, stride - 1, stride, stride + 1):
        neighbours = flat[pixels + step]
        np.copyto(steps, step, where=neighbours > best)
        np.maximum(best, neighbours, out=best)
    return steps


def _passes(
    basins: NDArray[np.int32],
    heights: NDArray[np.float32],
    numbers: NDArray[np.int32],
    pixels: NDArray[np.intp],
    stride: int,
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """The highest pass between each two basins that touch: basins, shape (M, 2), and heights, highest first."""
    pairs: list[NDArray[np.intp]] = []
    lows: list[NDArray[np.float32]] = []
    for step in (1, stride - 1, stride, stride + 1):
        others = numbers[pixels + step]
        border = np.flatnonzero((others >= 0) & (basins[others] != basins))
        beyond = others[border]
        pairs.append(np.sort(np.stack([basins[border], basins[beyond]], -1).astype(np.intp), axis=-1))
        lows.append(np.minimum(heights[border], heights[beyond]))
    pair, low = np.concatenate(pairs), np.concatenate(lows)
    order = np.argsort(-low, kind="stable")
    _, firsts = np.unique(pair[order, 0] * (len(heights) + 1) + pair[order, 1], return_index=True)
    kept = order[np.sort(firsts)]
    return pair[kept], low[kept]


def _kept_summits(
    heights: NDArray[np.float32], passes: NDArray[np.intp], pass_heights: NDArray[np.float32], saddle: float
) -> NDArray[np.bool_]:
    """Which summits are more than ripples of a higher summit."""
    is_kept = [True] * len(heights)
    higher = list(range(len(heights)))

    def island_of(summit: int) -> int:
        while higher[summit] != summit:
            higher[summit] = higher[higher[summit]]
            summit = higher[summit]
        return summit

    levels = heights.tolist()
    for (first, second), level in zip(passes.tolist(), pass_heights.tolist(), strict=True):
        top, low = island_of(first), island_of(second)
        if top == low:
            continue
        if (levels[low], -low) > (levels[top], -top):
            top, low = low, top
        higher[low] = top
        is_kept[low] = level < saddle * levels[low]
    return np.array(is_kept, bool)
