"""Whether a camera sees: not frozen, not damaged, not saturated, not black."""

from __future__ import annotations

import math
import statistics
import zlib
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.faults import GuardFault
from foreglow.beam.image_change import ImageChange, ImageComparer
from foreglow.config import GuardConfig
from foreglow.types import Image

NUM_SAMPLES = 1200
"""About so many pixels of an image are sampled, on a grid."""

CEILING_SHARE = 0.98
"""Pixels at least this bright, of the brightest one, are at the format's top if there are many of them."""

NUM_RECENT = 18
"""Images that say what is usual; a second of them at the paper's rate."""

STILL_SHARE, STILL_LEVELS = 0.4, 1.0
"""An image is still if its strongest change is less than this share of the least of the recent ones, or no more than
so many grey levels. Measured (`python -m benchmarks.image_faults`): moving, the least ratio is .57 in simulated drives;
frozen behind an encoder of 0.3 to 8 Mbit/s it is below .1, then at most 2 levels."""

REFINED_LEVELS = 2.0
"""What an encoder's refinement of a still picture changes, once it has begun to be still."""

MIN_STILL_S = 0.1
"""Nor is it frozen before it was still for so long: cameras of 60 Hz bring images twice."""

FRESH_SHARE = 0.3
"""Where more of the samples change from image to image than this, the noise is new: the camera lives."""

NUM_FRESH = 3
"""In so many images in a row."""

NUM_RELEASED = 5
"""After so many images with more change than refinement, what is usual is learnt anew: the scene has become calmer."""

NEW_EDGES_SHARE, EDGE_DEVIATIONS = 0.004, 5.0
"""More new edges on the encoder's grid than this are damage; both have to be exceeded."""

REPEATED_SHARE = 0.4
"""So many more repeated rows than usual are damage."""

ONE_VALUE_SHARE = 0.05
"""So many more samples than usual of one and the same value, and not a dark one, are damage: what a decoder fills in."""

STUCK_SHARE = 0.5
"""A band without any change is stuck if the bands that change do so by at least this share of what is usual."""

STUCK_LEVELS = 4.0
"""And if it usually changes by so many grey levels."""

DAMAGE_HOLD_S = 0.5
"""What was damaged once is taken for damaged as long: later images of a stream follow from it."""


class CameraWatch:
    """Judges each image by a sample of its pixels, and by how it differs from the one before."""

    def __init__(self, config: GuardConfig) -> None:
        self._config = config
        self._comparer = ImageComparer()
        self._stillness = _Stillness(config.max_same_images)
        self._damage = _Damage()
        self.reset()

    def reset(self) -> None:
        """Forgets the images so far."""
        self._fingerprint: int | None = None
        self._num_same = 0
        self._comparer.reset()
        self._stillness.reset()
        self._damage.reset()

    def faults(
        self, image: Image, timestamp_ns: int = 0, *, is_moving: bool | None = None, is_damaged: bool = False
    ) -> list[GuardFault]:
        """What is wrong with the next image.

        Args:
            image: The image.
            timestamp_ns: When it was exposed.
            is_moving: Whether our vehicle moves, as far as that is known.
            is_damaged: Whether the source says that it is.
        """
        step = max(1, math.isqrt(image.size // NUM_SAMPLES))
        sample: NDArray[Any] = np.ascontiguousarray(image[step // 2 :: step, step // 2 :: step])
        fingerprint = zlib.crc32(sample.data)
        self._num_same = self._num_same + 1 if fingerprint == self._fingerprint else 1
        self._fingerprint = fingerprint
        change = self._comparer.compare(image)
        is_still = self._stillness.update(change, timestamp_ns, is_moving)
        white = self._config.white_level or np.iinfo(image.dtype).max
        brightest = int(np.maximum.reduce(sample, axis=None))
        is_black = brightest <= self._config.min_bright * white
        faults = []
        if self._num_same > self._config.max_same_images or is_still:
            faults.append(GuardFault.FROZEN)
        if self._damage.update(image, sample, change, timestamp_ns) or is_damaged:
            faults.append(GuardFault.DAMAGED)
        num_bright = np.count_nonzero(sample >= min(white, CEILING_SHARE * brightest))
        if not is_black and num_bright > self._config.max_saturated * sample.size:
            faults.append(GuardFault.SATURATED)
        if is_black:
            faults.append(GuardFault.BLACK)
        return faults


class _Stillness:
    """Whether images stay as they are although the camera should move."""

    def __init__(self, max_still: int) -> None:
        self._max_still = max_still
        self.reset()

    def reset(self) -> None:
        self._recent: deque[float] = deque(maxlen=NUM_RECENT)
        self._fresh: deque[float] = deque(maxlen=NUM_FRESH)
        self._num_still = self._num_released = 0
        self._moved_ns: int | None = None

    def update(self, change: ImageChange | None, timestamp_ns: int, is_moving: bool | None) -> bool:
        """Whether the camera is frozen, by how the next image has changed."""
        if self._moved_ns is None or change is None or timestamp_ns < self._moved_ns:
            self._moved_ns = timestamp_ns
            return False
        self._fresh.append(change.share_changed)
        limit = STILL_SHARE * min(self._recent) if len(self._recent) == NUM_RECENT else 0.0
        limit = max(limit, REFINED_LEVELS if self._num_still else STILL_LEVELS)
        if change.strongest <= limit:
            self._num_still += 1
            self._num_released = self._num_released + 1 if change.strongest > REFINED_LEVELS else 0
        if change.strongest > limit or self._num_released >= NUM_RELEASED:
            self._num_still = self._num_released = 0
            self._moved_ns = timestamp_ns
            if change.strongest <= limit:
                self._recent.clear()
        if not self._num_still:
            self._recent.append(change.strongest)
            return False
        is_long = self._num_still >= self._max_still and timestamp_ns - self._moved_ns >= MIN_STILL_S * 1e9
        is_fresh = len(self._fresh) == NUM_FRESH and min(self._fresh) > FRESH_SHARE
        return is_long and is_moving is not False and (is_moving is True or not is_fresh)


class _Damage:
    """Whether an image has what no camera sees: new edges on an encoder's grid, repeated rows, filled or stuck parts."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._repeated: deque[float] = deque(maxlen=NUM_RECENT)
        self._one_value: deque[float] = deque(maxlen=NUM_RECENT)
        self._bands: deque[NDArray[np.float64]] = deque(maxlen=NUM_RECENT)
        self._until_ns: int | None = None

    def update(self, image: Image, sample: NDArray[Any], change: ImageChange | None, timestamp_ns: int) -> bool:
        """Whether the image is damaged, or one shortly before it was."""
        repeated, one_value = (0.0 if change is None else change.share_repeated), _share_of_one_value(sample)
        is_new = _rose(repeated, self._repeated, REPEATED_SHARE) or _rose(one_value, self._one_value, ONE_VALUE_SHARE)
        if change is not None:
            is_new |= change.share_new_edges > NEW_EDGES_SHARE and change.edge_deviations > EDGE_DEVIATIONS
            is_new |= self._has_stuck_part(change)
            self._bands.append(change.bands)
        self._repeated.append(repeated)
        self._one_value.append(one_value)
        if is_new:
            self._until_ns = timestamp_ns + round(DAMAGE_HOLD_S * 1e9)
        if self._until_ns is not None and not self._until_ns - DAMAGE_HOLD_S * 1e9 <= timestamp_ns <= self._until_ns:
            self._until_ns = None
        return self._until_ns is not None

    def _has_stuck_part(self, change: ImageChange) -> bool:
        if len(self._bands) < NUM_RECENT:
            return False
        usual = np.min(np.stack(self._bands), axis=0)
        is_stuck = (change.bands == 0) & (usual >= STUCK_LEVELS)
        is_moving = (usual >= STUCK_LEVELS) & (change.bands >= STUCK_SHARE * usual)
        return bool(is_stuck.any() and is_moving.any())


def _rose(share: float, recent: deque[float], by: float) -> bool:
    return len(recent) >= 2 and share > statistics.median(recent) + by


def _share_of_one_value(sample: NDArray[Any]) -> float:
    """Share of the samples with the value that most of those have that are neither dark nor at the top."""
    top = np.iinfo(sample.dtype).max
    values = sample[(sample > 0.1 * top) & (sample < 0.9 * top)]
    if values.size == 0:
        return 0.0
    return float(np.bincount(values.ravel()).max()) / sample.size
