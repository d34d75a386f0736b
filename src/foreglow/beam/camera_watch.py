"""Whether a camera sees: not frozen, not damaged, not saturated, not black."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from foreglow.beam.faults import GuardFault
from foreglow.beam.image_change import ImageChange, ImageComparer
from foreglow.beam.image_damage import FRESH_SHARE, NUM_RECENT, ImageDamage, ValueShares
from foreglow.beam.image_pieces import DARK, MAX_NOISE_CONTRAST, NEAR_TOP, ImagePieces, PieceMeasures, middle
from foreglow.beam.image_stripes import ImageStripes
from foreglow.beam.known_images import KnownImages
from foreglow.config import GuardConfig
from foreglow.types import Image

NUM_SAMPLES = 1200
"""About so many pixels of an image are sampled, on a grid, for how bright they are."""

BIT_DEPTHS = (8, 10, 12, 14, 16)
"""Depths of cameras; an image of uint16 has the least that holds the brightest pixel so far."""

MOST_OF_FEW_BITS = (1 << 14) - 1
"""Images of uint16 without brighter pixels may be of 10, 12 or 14 bits; then they are seen at the wrong scale, and
light is missed. Images that fill their type are not so dark: of 250 of simulated drives, none."""

EVERY_ROW = 17
"""One row of so many is cut into pieces: a prime number, for rows of both half images, or of each third or fourth."""

CONTRAST_SHARE = 0.5
"""An image is black, too, whatever its black level is, if its pieces differ by no more than this share of `min_bright`.
Measured, in shares of the greatest value: a covered lens with noise of 3 grey levels .014; two real videos of motorways
at least .15, the drive that ships .20, others that were simulated .11, and each at a quarter of the light .028."""

NOISE_CONTRAST = 9.0
"""So it is if they differ by no more than so many times the noise of their means, and than `MAX_NOISE_CONTRAST`:
pieces of nothing but noise are 4.8 times it apart, and those of moving images at least 17 times, also at a quarter
of the light and under noise of 6 grey levels. From noise of 9 on an image is damaged."""

OWN_CONTRAST_SHARE = 0.4
"""As `CONTRAST_SHARE`, of what pieces do not have in common with their row or their column, and so is their noise:
sensors have noise of whole rows and columns, by which the pieces of a covered lens differ as those of a scene may.
Measured, in shares of the greatest value: a covered lens under noise of rows and columns of 3 grey levels .014, behind
encoders up to .030; real videos at least .10, simulated images .08, and each at a quarter of the light .020. Of the
noise, covered lenses at most 5.5 times it, and moving images at least 15 times."""

STILL_SHARE = 0.4
"""An image is still if its strongest change is less than this share of the least of the recent ones. Measured on moving
cameras, two images in a row stay above .6 of it; frozen behind an encoder of 0.3 to 8 Mbit/s they are below .1."""

REFINED_AT_MOST_LEVELS = 8.0
"""But never if it is more than so many grey levels: an encoder refines a still picture by 6 at 0.3 Mbit/s."""

STILL_LEVELS, STAYS_STILL_LEVELS = 1.0, 2.0
"""An image is still in any case if its strongest change is no more than so many grey levels; the second number holds
after a still image, because of key frames."""

MIN_STILL_S = 0.045
"""A camera is not frozen before it was still for so long times `max_same_images`: those of 60 Hz may repeat images."""

NUM_FRESH = 3
"""The camera is alive where the noise is new in each of so many images: while it is frozen, more than `FRESH_SHARE` of
the samples change in single key frames only."""

LONGEST_STEP_NS = 200_000_000
"""Of a longer pause only so much counts: nothing is seen meanwhile, and a wrong time ends no fault."""

MOST_NOISE = 3
"""Images of nothing but new noise count up to so many, and others back: a single other one does not say that we see."""

NUM_UNKNOWN = 40
"""After so many images of another size or type all is found that shows from the first image on."""

NUM_RELEASED = 9
"""After so many still images in a row that changed by more than `STAYS_STILL_LEVELS`, the scene has become calmer."""


class CameraWatch:
    """Judges each image by how bright a sample of its pixels is, and by how it differs from the image before."""

    def __init__(self, config: GuardConfig) -> None:
        self._config = config
        self._comparer = ImageComparer()
        self._pieces = ImagePieces()
        self._stripes = ImageStripes()
        self._known_images = KnownImages()
        self._stillness = _Stillness(config.max_same_images)
        self._damage = ImageDamage()
        self.reset()

    def reset(self) -> None:
        """Forgets the images so far."""
        self._brightest = 0
        self._format: tuple[object, ...] | None = None
        self._num_unknown = 0
        self._before_ns: int | None = None
        self._time_ns = 0
        self._known_images.reset()
        self._comparer.reset()
        self._pieces.reset()
        self._stripes.reset()
        self._num_noise = 0
        self._stillness.reset()
        self._damage.reset()

    def faults(
        self, image: Image, timestamp_ns: int, *, is_moving: bool | None = None, is_damaged: bool = False
    ) -> list[GuardFault]:
        """What is wrong with the next image.

        Args:
            image: The image.
            timestamp_ns: When it was exposed.
            is_moving: Whether our vehicle is so fast that every image must differ; None where that is not known.
            is_damaged: Whether the source says that it is.
        """
        faults = []
        self._tick(timestamp_ns)
        if self._is_resized(image):
            faults.append(GuardFault.RESIZED)
        step = _prime(math.isqrt(image.size // NUM_SAMPLES))
        row, column = (min(step // 2, side - 1) for side in image.shape)
        grid = image[row::step, column::step]
        sample, brightest = grid.ravel(), int(grid[middle(len(grid))].max())
        self._brightest = max(self._brightest, int(sample.max()))
        white = self._config.white_level
        top = white or _top(image, self._brightest)
        num_white = np.count_nonzero(sample >= NEAR_TOP * top)
        is_saturated = num_white > self._config.max_saturated * sample.size
        rows = image[::EVERY_ROW]
        pieces = self._pieces.update(rows, top)
        greatest = white or int(np.iinfo(image.dtype).max)
        is_black = brightest <= self._config.min_bright * greatest
        is_black |= not white and image.dtype == np.uint16 and self._may_have_few_bits(image)
        is_black |= not is_saturated and self._shows_nothing(pieces)
        change = self._comparer.compare(image, greatest)
        stripes = self._stripes.update(image, greatest)
        known = self._known_images.update(rows)
        has_old_parts = self._damage.has_old_parts(known)
        is_frozen = self._stillness.update(
            change, self._time_ns, is_moving, is_repeated=known.is_repeated, has_old_parts=has_old_parts
        )
        if pieces.is_noise:
            self._num_noise = min(self._num_noise + 1, MOST_NOISE)
        elif not known.is_repeated:
            self._num_noise = max(self._num_noise - 1, 0)
        is_feigned = self._num_noise >= 2 and is_moving is True
        if is_frozen or is_feigned or (known.is_back and is_moving is not False):
            faults.append(GuardFault.FROZEN)
        if is_black or is_saturated:  # rows are alike, and nothing is new, without any damage
            self._damage.pass_over(self._time_ns / 1e9)
        else:
            values = ValueShares(_share_of_one_value(sample, top), int(num_white) / sample.size)
            is_still = self._stillness.is_still
            is_damaged |= self._damage.update(
                change, pieces, values, known, stripes, self._time_ns / 1e9, is_still=is_still, is_moving=is_moving
            )
            if not is_damaged:
                self._comparer.keep()
        if is_damaged:
            faults.append(GuardFault.DAMAGED)
        if is_saturated:
            faults.append(GuardFault.SATURATED)
        if is_black:
            faults.append(GuardFault.BLACK)
        return faults

    def _may_have_few_bits(self, image: Image) -> bool:
        """Whether no pixel of the images of uint16 so far says that they fill their type."""
        if self._brightest <= MOST_OF_FEW_BITS:
            self._brightest = max(self._brightest, int(image.max()))
        return self._brightest <= MOST_OF_FEW_BITS

    def _shows_nothing(self, pieces: PieceMeasures) -> bool:
        """Whether pieces differ by no more than noise makes them, be it their own or that of whole rows or columns."""
        return any(
            contrast <= max(share * self._config.min_bright, min(NOISE_CONTRAST * noise, MAX_NOISE_CONTRAST))
            for share, contrast, noise in (
                (CONTRAST_SHARE, pieces.contrast, pieces.noise),
                (OWN_CONTRAST_SHARE, pieces.own_contrast, pieces.own_noise),
            )
        )

    def _tick(self, timestamp_ns: int) -> None:
        """Moves our own clock on: by no more than is seen between two images, and never back."""
        elapsed_ns = 0 if self._before_ns is None else timestamp_ns - self._before_ns
        self._before_ns = timestamp_ns
        self._time_ns += min(max(elapsed_ns, 0), LONGEST_STEP_NS)

    def _is_resized(self, image: Image) -> bool:
        """Whether the images have had another size or type until now, or until just before."""
        before, self._format = self._format, (*image.shape, image.dtype)
        is_new = before is not None and before != self._format
        self._num_unknown = NUM_UNKNOWN if is_new else max(0, self._num_unknown - 1)
        return self._num_unknown > 0


class _Stillness:
    """Whether images stay as they are although they should not."""

    def __init__(self, max_same: int) -> None:
        self._max_same = max_same
        self.reset()

    def reset(self) -> None:
        self._recent: deque[float] = deque(maxlen=NUM_RECENT)
        self._fresh: deque[float] = deque(maxlen=NUM_FRESH)
        self._num_still = self._num_released = 0
        self._moved_ns = 0

    @property
    def is_still(self) -> bool:
        """Whether the latest image was like the one before."""
        return self._num_still > 0

    def update(
        self,
        change: ImageChange | None,
        timestamp_ns: int,
        is_moving: bool | None,
        *,
        is_repeated: bool,
        has_old_parts: bool,
    ) -> bool:
        """Whether the camera is frozen, by how the next image has changed, or as it repeats an earlier image.

        A camera that stands still is not called frozen where our vehicle is known to be slow, nor, where its speed is
        not known, as long as the noise is new: of an image that was there before it is not. A scene has not become
        calmer where a part of the image is an old one.
        """
        if change is None or timestamp_ns < self._moved_ns:
            self.reset()
            self._moved_ns = timestamp_ns
            return False
        if not is_repeated:
            self._fresh.append(change.share_changed)
        is_fresh = len(self._fresh) == NUM_FRESH and min(self._fresh) > FRESH_SHARE
        limit = STAYS_STILL_LEVELS if self._num_still else STILL_LEVELS
        if len(self._recent) == NUM_RECENT and not is_fresh:
            limit = max(limit, min(STILL_SHARE * min(self._recent), REFINED_AT_MOST_LEVELS))
        if not is_repeated and (change.strongest > limit or self._num_released == NUM_RELEASED):
            if change.strongest <= limit:
                self._recent.clear()
            self._recent.append(change.strongest)
            self._num_still = self._num_released = 0
            self._moved_ns = timestamp_ns
        else:
            self._num_still += 1
            is_calmer = change.strongest > STAYS_STILL_LEVELS and not has_old_parts
            self._num_released = self._num_released + 1 if is_calmer else 0
        is_long = timestamp_ns - self._moved_ns >= MIN_STILL_S * 1e9 * self._max_same
        is_frozen = self._num_still >= self._max_same and is_long
        return is_frozen and is_moving is not False and (is_moving is True or is_repeated or not is_fresh)


def _prime(number: int) -> int:
    """The first prime number from there on; 1 stays. Such a step comes to every phase of a pattern of rows."""
    while any(number % divisor == 0 for divisor in range(2, math.isqrt(number) + 1)):
        number += 1
    return max(1, number)


def _top(image: Image, brightest: int) -> int:
    """The greatest value that the camera can give; of uint16, by the brightest pixel so far."""
    if image.dtype == np.uint8:
        return 255
    return next(top for bits in BIT_DEPTHS if brightest <= (top := (1 << bits) - 1))


def _share_of_one_value(sample: Image, top: int) -> float:
    """Share of the samples with the value that most of those have that are neither dark nor white."""
    values = sample[(sample > DARK * top) & (sample < NEAR_TOP * top)]
    if values.size == 0:
        return 0.0
    return float(np.bincount(values).max()) / sample.size
