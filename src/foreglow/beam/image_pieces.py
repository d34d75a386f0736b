"""Whether an image shows anything, whether it moves, and whether a part of it is noise or shows another part again.

Rows are cut into pieces. Where a lens is covered, all pieces are about alike, at whatever level the camera has its
black, or differ by noise that whole rows or columns have in common. Where a picture stands still, or is nothing but
noise, its pieces change by noise alone: by a Gaussian, whose 99.9th percentile is 4.9 times its median. What moves
changes a few pieces by far more than the others. No noise, however strong or new, can feign these two measures. A link
that has lost its bits, or a memory never written, gives noise far above that of any camera; one that is read twice
gives the same half image twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Floats
from foreglow.types import Image

PIECE_PX = 16

BORDER_SHARE = 8
"""One of so many rows, at the top and at the bottom each, is left out where an image is judged as a whole: there
recorders write time, speed and names into the image, also into that of a covered or frozen camera."""

SPOT_SHARE = 0.01
"""An image of which less than this share differs from the rest shows nothing: a reflection, a name, hot pixels."""

NOISE_RATIO = 7.0
"""Where the strong changes are less than so many times the median change, noise alone has changed the image. Measured:
a still picture under noise of 1 to 10 grey levels 3.5 to 6.3, also behind MJPEG, but above 7 behind H.264; the drive
that ships at least 26, raw and coded, and 12 under noise of 12 grey levels; two real videos of motorways 1,000."""

UNEVEN_RATIO, NUM_ALIKE, MIN_GROUPS, ALIKE_RATIO = 20.0, 64, 8, 6.5
"""The noise of light grows with it. So up to the first number, the changes are compared once more, each with the median
change of so many pieces of like brightness, if there are so many groups of them. Measured, the last number in mind: a
still picture under noise of light of any strength 4.1 to 5.9, also at 640x480; the drive that ships, raw, coded and
with noise added, at least 7.7, six simulated cameras 9."""

DRIFT_RATIO = 4.0
"""Where the median change is not so many times the median with its sign, the light has changed, or the exposure."""

STRONG_SHARE = 0.001
"""The share of pieces that change by more than the strong change."""

LEAST_NOISE = 1e-3
"""Median change, in shares of the greatest value, below which an encoder has removed the noise, or it was never new."""


MEDIAN_STEP = 0.954
"""The median of the difference of two values of Gaussian noise, in its standard deviations."""

NUM_ROUGH_PIECES, ROUGH_STEP = 8, 0.04
"""A piece of a row, one of so many, is rough where neighbouring pixels differ by more than this share of the greatest
value in the mean; Gaussian noise does so from 9 grey levels on."""

DARK = 0.1
"""Up to this share of the greatest value there may be no noise."""

NEAR_TOP = 0.9
"""A pixel is white from this share of the greatest value on: limited-range video ends at 235 of 255."""

WILD_STEP = 0.2
"""A piece is wild from this mean difference on: pixels of any value differ by a third in the mean, and in images of a
simulated dashcam with far too much gain by .15."""

TWICE_CONTRAST = 0.1
"""A row counts as shown twice from this difference of its pixels on, in shares of the greatest value: below, the colour
filters of a sensor may make a pattern without noise."""


MOST_IN_COMMON = 0.2
"""A contrast beyond this share of the greatest value is not one of noise that rows or columns have in common: of a
standard deviation of 8 grey levels, far above a camera's, it is .15."""

MAX_NOISE_CONTRAST = 0.07
"""Noise of single pixels makes no greater contrast, in shares of the greatest value."""

LEAST_ROWS = 6
"""With fewer rows or columns of pieces, next to nothing is left beside what they have in common."""


@dataclass(frozen=True, slots=True)
class PieceMeasures:
    """What the pieces of an image say.

    Attributes:
        contrast: The difference of the brightest and the darkest piece, in shares of the greatest value, but for one in
            a hundred at either end (`SPOT_SHARE`).
        noise: Standard deviation of the noise of a piece's mean, by how much neighbouring pieces differ in the median.
        own_contrast: The contrast of what is a piece's own, without the means of its row and of its column: noise that
            whole rows or columns have in common is gone then, what a lens shows is not. The whole contrast where
            that is more than `MOST_IN_COMMON`, or of fewer rows or columns than `LEAST_ROWS`.
        own_noise: The noise of the same, by neighbours in a row or in a column, whichever differ more; of a contrast
            beyond `MAX_NOISE_CONTRAST`, `noise`.
        is_noise: Whether noise alone has changed since the image before, at least in the `middle` rows, of which the
            other two are.
        share_rough: Share of the pieces whose neighbouring pixels differ as those of noise far above a camera's.
        share_wild: Share of those that do so by several times as much: no camera's noise is so strong.
        share_filled: Share of these pieces of which all pixels have one value, neither dark nor white.
        share_twice: Share of the rows whose right half is the left one, pixel by pixel.
        share_repeated_columns: Share of the columns that are the same as the one to their left, in each of the `middle`
            rows. Noise makes no two columns of a camera alike.
    """

    contrast: float
    noise: float
    own_contrast: float
    own_noise: float
    is_noise: bool
    share_rough: float
    share_wild: float
    share_filled: float
    share_twice: float
    share_repeated_columns: float


class ImagePieces:
    """Compares the pieces of each image with each other, and with those of the image before."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets the image before."""
        self._before: Floats = np.zeros((0, 0))

    def update(self, rows: Image, top: int) -> PieceMeasures:
        """The measures of the next image.

        Args:
            rows: Some rows of the image, always the same ones.
            top: The greatest value of a pixel.
        """
        piece_px = min(PIECE_PX, rows.shape[1])
        width_px = rows.shape[1] // piece_px * piece_px
        # The sums are exact: a third of the time of means.
        pieces = rows[:, :width_px].astype(np.float32).reshape(len(rows), -1, piece_px)
        means = (pieces @ np.ones(piece_px, np.float32)).astype(np.float64) / piece_px / top
        before, self._before = self._before, means
        inner = middle(len(rows))
        is_noise = before.shape == means.shape and (_is_noise(means, before) or _is_noise(means[inner], before[inner]))
        means = means[inner]
        share_rough, share_wild, share_filled = _shares_of_steps(rows, top)
        contrast, noise = _contrast(means.ravel()), _noise(means)
        own_contrast, own_noise = contrast, noise
        if contrast <= MOST_IN_COMMON and min(means.shape) >= LEAST_ROWS:
            own = means - means.mean(axis=1, keepdims=True)
            own -= own.mean(axis=0)
            own_contrast = _contrast(own.ravel())
            if own_contrast <= MAX_NOISE_CONTRAST:
                own_noise = max(_noise(own), _noise(own.T))
        return PieceMeasures(
            contrast=contrast,
            noise=noise,
            own_contrast=own_contrast,
            own_noise=own_noise,
            is_noise=is_noise,
            share_rough=share_rough,
            share_wild=share_wild,
            share_filled=share_filled,
            share_twice=_share_twice(rows, top),
            share_repeated_columns=_share_repeated_columns(rows[inner]),
        )


def _is_noise(means: Floats, before: Floats) -> bool:
    """Whether the means of the pieces, shape (rows, pieces in a row), have changed as noise changes them."""
    signed = means - before
    changes = np.abs(signed).ravel()
    median, strong = _median_and_strong(changes)
    if not median > LEAST_NOISE or strong >= UNEVEN_RATIO * median:  # so it is where something moves
        return False
    if not median > DRIFT_RATIO * abs(np.median(signed)):
        return False
    return strong < NOISE_RATIO * median or _is_noise_of_light(changes, (means + before).ravel())


def _is_noise_of_light(changes: Floats, brightness: Floats) -> bool:
    """Whether changes of pieces, shape (N,), are alike among those of like brightness, shape (N,)."""
    num_groups = changes.size // NUM_ALIKE
    if num_groups < MIN_GROUPS:
        return False
    order = np.argsort(brightness)[-num_groups * NUM_ALIKE :]
    groups = changes[order].reshape(num_groups, NUM_ALIKE)
    medians = np.maximum(np.median(groups, axis=1, keepdims=True), LEAST_NOISE)
    return _median_and_strong((groups / medians).ravel())[1] < ALIKE_RATIO


def _median_and_strong(changes: Floats) -> tuple[float, float]:
    """The median of changes, shape (N,), and the change that `STRONG_SHARE` of them exceed."""
    half, strong = changes.size // 2, int((1.0 - STRONG_SHARE) * (changes.size - 1))
    found = np.partition(changes, (half, strong))
    return float(found[half]), float(found[strong])


def middle(num_rows: int) -> slice:
    """Which of an image's rows are not of its border."""
    num_left_out = num_rows // BORDER_SHARE
    return slice(num_left_out, num_rows - num_left_out)


def _contrast(means: Floats) -> float:
    num_left_out = int(SPOT_SHARE * means.size)
    ends = (num_left_out, means.size - 1 - num_left_out)
    darkest, brightest = np.partition(means, ends)[list(ends)]
    return float(brightest - darkest)


def _noise(means: Floats) -> float:
    steps = np.abs(np.diff(means, axis=1)).ravel()
    if not steps.size:
        return 0.0
    middle = steps.size // 2
    steps.partition(middle)
    return float(steps[middle]) / MEDIAN_STEP


def _shares_of_steps(rows: Image, top: int) -> tuple[float, float, float]:
    """Shares of the pieces whose neighbouring pixels differ by `ROUGH_STEP`, `WILD_STEP`, or, if grey, not at all."""
    piece_px = rows.shape[1] // NUM_ROUGH_PIECES
    if piece_px < 2:
        return 0.0, 0.0, 0.0
    pieces = rows[:, : NUM_ROUGH_PIECES * piece_px].reshape(len(rows), NUM_ROUGH_PIECES, piece_px)
    left, right = pieces[:, :, :-1], pieces[:, :, 1:]
    steps = np.maximum(left, right) - np.minimum(left, right)
    sums, values = steps.sum(axis=2, dtype=np.uint32), pieces[:, :, 0]
    is_filled = (sums == 0) & (values > DARK * top) & (values < NEAR_TOP * top)
    means = sums / (top * (piece_px - 1))
    num_rough, num_wild, num_filled = map(np.count_nonzero, (means > ROUGH_STEP, means > WILD_STEP, is_filled))
    return int(num_rough) / sums.size, int(num_wild) / sums.size, int(num_filled) / sums.size


def _share_twice(rows: Image, top: int) -> float:
    middle = rows.shape[1] // 2
    left, right = rows[:, :middle], rows[:, middle : 2 * middle]
    again = left[(left == right).all(axis=1)]
    if not again.size:
        return 0.0
    return int(np.count_nonzero(again.max(axis=1) - again.min(axis=1) > TWICE_CONTRAST * top)) / len(rows)


def _share_repeated_columns(rows: Image) -> float:
    is_other = (rows[:, 1:] != rows[:, :-1]).any(axis=0)
    return 1.0 - int(np.count_nonzero(is_other)) / is_other.size if is_other.size else 0.0
