"""How much an image differs from the one before: what a camera that sees, a frozen one and a damaged one tell apart.

A camera that moves changes every image. A frozen one does not, but an encoder behind it does, a little: it refines the
same picture for a few frames, and again at each key frame. A damaged stream changes the image in squares of the
encoder's grid, repeats rows, or leaves a part of the image as it was. None of these measures knows a codec; all of them
are counted on means, lines and samples of the image, never on all of its pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import foreglow._native as _native
from foreglow.types import Image
from foreglow.types.arrays import with_adjacent_columns

GRID_PX = 16
"""Video encoders code squares of this size (H.264's macroblock; H.265's and MJPEG's units are multiples or halves)."""


@dataclass(frozen=True, slots=True)
class ImageChange:
    """What differs between two images, in grey levels, of which the greatest value of a pixel has 255.

    Attributes:
        strongest: Change of the mean that one block of 8x8 pixels in 1,000 exceeds, of those in the middle of the image
            (`image_pieces.BORDER_SHARE`).
        share_changed: Share of the sampled pixels, one of each block, that are not the same as before.
        num_bright: Of the same samples, those that were bright some images ago.
        share_stuck: Estimated share of the samples that do not change at all, while new noise changes a share of the
            others each time, whatever share: `1 - c d / b` of the shares that changed now, before, and both times. Of
            all samples and of the bright ones, the lesser: the dark may be without noise. Negative by chance.
        share_textured: Share of the samples that differ from the pixel beside them: there is noise, or an edge. Where
            the dark has no noise, it has no texture.
        share_stuck_texture: `share_stuck` of the textured samples.
        share_same_long: Share of the textured samples that have not changed for 36 images.
        share_filled: Share of the samples that are as before and of one grey level, where nearly all samples of that
            level are as before that were bright; of all samples and of the bright ones, the lesser.
        contrast: How much brighter the bright samples are than the others, in the mean of those not as before.
        tile_shares: Shape (8, 8), the same share in each tile of the image; 1 where a tile has no such pixel.
        share_repeated: Share of the rows, every seventh of them, that are the same as the row below. Noise makes no two
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
    num_bright: int
    share_stuck: float
    share_textured: float
    share_stuck_texture: float
    share_same_long: float
    share_filled: float
    contrast: float
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

    def keep(self) -> None:
        """Makes the latest image one that, after two others, says which samples are bright: those above the mean."""
        self._comparer.keep()

    def reset(self) -> None:
        """Forgets the image before, and those that say what is bright."""
        self._comparer.reset()

    def compare(self, image: Image, top: int) -> ImageChange | None:
        """What has changed since the image before; None for the first, and where the size or the type is another.

        `top` is the greatest value that a pixel may have.
        """
        change = self._comparer.compare(with_adjacent_columns(image), top)
        if change is None:
            return None
        num_new = change.num_edges - change.num_other_edges
        return ImageChange(
            strongest=change.strongest,
            share_changed=change.num_changed / change.num_samples,
            num_bright=change.num_bright,
            share_stuck=change.share_stuck,
            share_textured=change.num_textured / change.num_samples,
            share_stuck_texture=change.share_stuck_texture,
            share_same_long=change.share_same_long,
            share_filled=change.share_filled,
            contrast=change.contrast,
            tile_shares=change.tiles,
            share_repeated=change.num_repeated_rows / max(1, change.num_rows),
            share_flat_rows=change.share_flat_rows,
            share_flat_pieces=change.share_flat_pieces,
            pair_ratios=change.pair_ratios,
            share_new_edges=num_new / max(1, image.size // GRID_PX**2),
            edge_deviations=num_new / math.sqrt(max(1, change.num_edges + change.num_other_edges)),
        )
