"""How much an image differs from the one before: what a camera that sees, a frozen one and a damaged one tell apart.

A camera that moves changes every image. A frozen one does not, but an encoder behind it does, a little: it refines the
same picture for a few frames, and again at each key frame. A damaged stream changes the image in squares of the
encoder's grid, repeats rows, or leaves a part of the image as it was. None of these measures knows a codec; all of them
are counted on means and lines of the image, never on all of its pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import foreglow._native as _native
from foreglow.types import Image

GRID_PX = 16
"""Video encoders code squares of this size (H.264's macroblock; H.265's and MJPEG's units are multiples or halves)."""

NUM_PIECES = 8
"""Into so many pieces a row is cut, to see whether one is flat."""

NUM_COLUMNS = 160
"""About so many columns are compared from row to row."""


@dataclass(frozen=True, slots=True)
class ImageChange:
    """What differs between two images, in 8-bit grey levels whatever the type of the pixels.

    Attributes:
        strongest: Change of the mean that one block of 8x8 pixels in 1,000 exceeds.
        share_changed: Share of the sampled pixels, one of each block, that are not the same as before.
        tile_shares: Shape (8, 8), the same share in each tile of the image; 1 where a tile has no such pixel.
        share_repeated: Share of the rows, every eighth of them, that are the same as the row below. Noise makes no two
            rows of a camera alike, but where all is black.
        share_flat_rows: Share of the same rows in which all pixels have one value, as where a decoder fills in black.
        share_flat_pieces: The same, of eighths of these rows.
        pair_ratios: Shape (2, 2), how much the rows of a pair differ over how much neighbouring pairs do: by absolute
            and by squared differences, for pairs that begin with an even and with an odd row. Near 1 for any camera; a
            row that repeats the one above stays like it behind an encoder.
        share_new_edges: Edges of the encoder's grid that stand out in the change, less those of a grid shifted by half
            a square, over the number of squares. Negative by chance.
        edge_deviations: The same difference in standard deviations of what chance makes of it (Poisson's).
    """

    strongest: float
    share_changed: float
    tile_shares: NDArray[np.float64]
    share_repeated: float
    share_flat_rows: float
    share_flat_pieces: float
    pair_ratios: NDArray[np.float64]
    share_new_edges: float
    edge_deviations: float


class ImageComparer:
    """Compares each image with the one before, of which it keeps means and lines only."""

    def __init__(self) -> None:
        self._comparer = _native.ImageComparer()

    def reset(self) -> None:
        """Forgets the image before."""
        self._comparer.reset()

    def compare(self, image: Image) -> ImageChange | None:
        """What has changed since the image before; None for the first, and where the size or the type is another."""
        adjacent = image if image.strides[1] == image.itemsize else image.copy(order="C")
        change = self._comparer.compare(adjacent)
        if change is None:
            return None
        share_flat_rows, share_flat_pieces = _flat_shares(adjacent)
        num_new = change.num_edges - change.num_other_edges
        return ImageChange(
            strongest=change.strongest,
            share_changed=change.num_changed / change.num_samples,
            tile_shares=change.tiles,
            share_repeated=change.num_repeated_rows / max(1, change.num_rows),
            share_flat_rows=share_flat_rows,
            share_flat_pieces=share_flat_pieces,
            pair_ratios=_pair_ratios(adjacent),
            share_new_edges=num_new / max(1, image.size // GRID_PX**2),
            edge_deviations=num_new / math.sqrt(max(1, change.num_edges + change.num_other_edges)),
        )


def _flat_shares(image: Image) -> tuple[float, float]:
    """Shares of every eighth row, and of eighths of these rows, in which all pixels have one value."""
    rows, width = image[4::8], image.shape[1]
    if not len(rows):
        return 0.0, 0.0
    starts = np.arange(NUM_PIECES if width >= NUM_PIECES else 1) * width // NUM_PIECES
    greatest, least = np.maximum.reduceat(rows, starts, axis=1), np.minimum.reduceat(rows, starts, axis=1)
    is_flat_row = greatest.max(axis=1) == least.min(axis=1)
    return float(np.mean(is_flat_row)), float(np.mean(greatest == least))


def _pair_ratios(image: Image) -> NDArray[np.float64]:
    columns = image[:, :: max(1, image.shape[1] // NUM_COLUMNS)].astype(np.float32)
    steps = np.abs(np.diff(columns, axis=0))
    within, between = (np.array([part.sum(), np.vdot(part, part)]) + 1.0 for part in (steps[::2], steps[1::2]))
    return np.stack([within / between, between / within], axis=1)
