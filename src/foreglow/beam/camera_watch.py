"""Whether a camera works: its image is not frozen, not saturated and not black."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.faults import GuardFault
from foreglow.config import GuardConfig
from foreglow.types import Image

NUM_SAMPLES = 1200
"""About so many pixels of an image are sampled, on a grid."""


class CameraWatch:
    """Checks a sample of each image's pixels. A real sensor's noise makes no two samples alike."""

    def __init__(self, config: GuardConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forgets the images so far."""
        self._fingerprint: int | None = None
        self._num_same = 0

    def faults(self, image: Image) -> list[GuardFault]:
        """What is wrong with the next image."""
        step = max(1, math.isqrt(image.size // NUM_SAMPLES))
        sample: NDArray[Any] = np.ascontiguousarray(image[step // 2 :: step, step // 2 :: step])
        fingerprint = zlib.crc32(sample.data)
        self._num_same = self._num_same + 1 if fingerprint == self._fingerprint else 1
        self._fingerprint = fingerprint
        white = self._config.white_level or np.iinfo(image.dtype).max
        faults = []
        if self._num_same > self._config.max_same_images:
            faults.append(GuardFault.FROZEN)
        if np.count_nonzero(sample >= white) > self._config.max_saturated * sample.size:
            faults.append(GuardFault.SATURATED)
        if np.maximum.reduce(sample, axis=None) <= self._config.min_bright * white:
            faults.append(GuardFault.BLACK)
        return faults
