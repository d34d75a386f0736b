"""How much an image differs from the one before: what a camera that sees, a frozen one and a damaged one tell apart.

A camera that moves changes every image. A frozen one does not, but an encoder behind it does, a little: it refines the
same picture for a few frames, and again at each key frame. A damaged stream changes the image in squares of the
encoder's grid, repeats rows, or leaves a part of the image as it was. None of these measures knows a codec; all of them
are counted on means and lines of the image, never on all of its pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.types import Image

BLOCK_PX = 8
"""Changes are those of the means of squares of this size: sensor noise and what an encoder does to it average out."""

GRID_PX = 16
"""Video encoders code squares of this size (H.264's macroblock; H.265's and MJPEG's units are multiples or halves)."""

EDGE_LEVELS = 10.0
"""An edge of such a square stands out if the change differs by this much across it, in the mean; 8-bit grey levels."""

NUM_BANDS = 8
"""A part of the image that stays as it was is looked for in horizontal bands."""

MIN_TEXTURE = 6
"""A row whose brightest and darkest sample differ by less, in 8-bit grey levels, has no texture that could repeat."""


@dataclass(frozen=True, slots=True)
class ImageChange:
    """What differs between two images, in 8-bit grey levels whatever the type of the pixels.

    Attributes:
        strongest: Change of the mean that one square of 1,000 exceeds.
        bands: Shape (NUM_BANDS,), greatest change in each horizontal band, the uppermost first.
        share_changed: Share of the samples that are not the same as before.
        share_new_edges: Edges of the encoder's grid that stand out in the change, less those of a grid shifted by half
            a square, over the number of squares. Negative by chance.
        edge_deviations: The same difference in standard deviations of what chance makes of it (Poisson's).
    """

    strongest: float
    bands: NDArray[np.float64]
    share_changed: float
    share_new_edges: float
    edge_deviations: float


class ImageComparer:
    """Compares each image with the one before, of which it keeps means and lines only."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets the image before."""
        self._before: _Digest | None = None

    def compare(self, image: Image) -> ImageChange | None:
        """What has changed since the image before; None for the first, and where the size or the type is another."""
        digest, before = _Digest.of(image), self._before
        self._before = digest
        if before is None or before.shape != digest.shape or before.levels != digest.levels:
            return None
        change = cv2.absdiff(digest.means, before.means)
        flat = np.sort(change, axis=None)
        bands = [float(band.max()) * digest.levels for band in np.array_split(change, NUM_BANDS) if band.size]
        num_on, num_off = (
            sum(_num_edges(now, then, digest.levels) for now, then in zip(lines, earlier, strict=True))
            for lines, earlier in ((digest.on_grid, before.on_grid), (digest.off_grid, before.off_grid))
        )
        num_squares = max(1, image.size // GRID_PX**2)
        return ImageChange(
            strongest=float(flat[-1 - flat.size // 1000]) * digest.levels,
            bands=np.array(bands + [0.0] * (NUM_BANDS - len(bands))),
            share_changed=float(np.count_nonzero(digest.samples != before.samples)) / digest.samples.size,
            share_new_edges=(num_on - num_off) / num_squares,
            edge_deviations=(num_on - num_off) / math.sqrt(max(1, num_on + num_off)),
        )


def share_of_repeated_rows(image: Image) -> float:
    """Share of the rows, every eighth of them, that have texture and are the same as the row below.

    Noise makes no two rows of a camera alike; a decoder that conceals a loss may copy rows.

    >>> rows = np.random.default_rng(0).integers(0, 256, (64, 32), np.uint8)
    >>> share_of_repeated_rows(rows), share_of_repeated_rows(np.repeat(rows[:1], 64, axis=0))
    (0.0, 1.0)
    """
    upper, lower = image[: image.shape[0] - 1 : BLOCK_PX], image[1::BLOCK_PX]
    lower = lower[: len(upper)]
    if not upper.size:
        return 0.0
    is_same = (upper[:, :: 2 * BLOCK_PX] == lower[:, :: 2 * BLOCK_PX]).all(axis=1)
    if not is_same.any():
        return 0.0
    upper, lower = upper[is_same], lower[is_same]
    texture = (upper.max(axis=1).astype(np.float64) - upper.min(axis=1)) * _levels(image)
    num = np.count_nonzero((upper == lower).all(axis=1) & (texture >= MIN_TEXTURE))
    return float(num) / len(is_same)


@dataclass(frozen=True, slots=True)
class _Digest:
    """What is kept of an image.

    Attributes:
        shape: Of the image.
        levels: 8-bit grey levels of one unit of its pixels.
        means: Of squares of `BLOCK_PX`.
        samples: One pixel of each.
        on_grid: Pixels before and behind the lines of the encoder's grid, the horizontal ones and the vertical ones.
        off_grid: The same of the grid that is shifted by half a square.
    """

    shape: tuple[int, ...]
    levels: float
    means: Image
    samples: Image
    on_grid: tuple[tuple[Image, Image], ...]
    off_grid: tuple[tuple[Image, Image], ...]

    @classmethod
    def of(cls, image: Image) -> _Digest:
        size = max(1, image.shape[1] // BLOCK_PX), max(1, image.shape[0] // BLOCK_PX)
        return cls(
            image.shape,
            _levels(image),
            cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA),
            image[BLOCK_PX // 2 :: BLOCK_PX, BLOCK_PX // 2 :: BLOCK_PX].copy(),
            _lines(image, GRID_PX),
            _lines(image, GRID_PX // 2),
        )


def _levels(image: Image) -> float:
    return 255.0 / float(np.iinfo(image.dtype).max)


def _lines(image: Image, first_px: int) -> tuple[tuple[Image, Image], ...]:
    """Pixels before and behind the lines of a grid, as rows: shape (lines, pixels); horizontal lines, vertical ones."""
    rows = slice(first_px - 1, image.shape[0] - 1, GRID_PX), slice(first_px, image.shape[0], GRID_PX)
    columns = slice(first_px - 1, image.shape[1] - 1, GRID_PX), slice(first_px, image.shape[1], GRID_PX)
    return (
        (image[rows[0]].copy(), image[rows[1]].copy()),
        (image[:, columns[0]].T.copy(), image[:, columns[1]].T.copy()),
    )


def _num_edges(now: tuple[Image, Image], then: tuple[Image, Image], levels: float) -> int:
    """Edges of squares across which the change differs by `EDGE_LEVELS`, in the mean along the edge."""
    num = now[0].shape[1] // GRID_PX
    if not now[0].size or not num:
        return 0
    sums = [
        line[:, : num * GRID_PX].reshape(len(line), num, GRID_PX).sum(axis=2, dtype=np.int32)
        for line in (now[1], now[0], then[1], then[0])
    ]
    jumps = (sums[0] - sums[1]) - (sums[2] - sums[3])
    return int(np.count_nonzero(np.abs(jumps) > EDGE_LEVELS * GRID_PX / levels))
