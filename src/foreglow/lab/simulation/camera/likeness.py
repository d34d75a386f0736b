"""Which camera profile of the simulator a drive resembles, by cheap statistics of a few of its images.

`likeness.toml` has these statistics of every profile, measured once by `python -m benchmarks.camera_likeness`.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Mapping
from importlib.resources import as_file, files

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.config import read_toml
from foreglow.types import Frame, FrameResult, Image
from foreglow.types.white import full_scale

NUM_IMAGES = 12
"""Images of a run that are looked at, evenly spaced; of several sequences about as many, and at least one of each."""

STEP = 50
"""Frames between two of them where the number of frames is not known."""

FIGURES = ("width", "black", "middle", "bright", "clipped", "noise", "detail")
"""What is measured of an image, see `look_of`."""

LEAST_SPREADS = (0.4, 0.15, 0.3, 0.3, 0.5, 0.15, 0.15)
"""Least standard deviation of each figure over the drives of a camera: few drives show less than there is."""

MAX_DISTANCE = 2.0
"""Root mean square of a drive's deviations from the nearest profile, in standard deviations, above which the camera is
unknown. Of 70 drives, judged by the others of their camera, 69 are nearer."""

Look = NDArray[np.float64]
"""Shape (len(FIGURES),): the figures of an image, or their means over a drive."""


def look_of(image: Image) -> Look:
    """The figures of an image, all but the share on logarithmic scales.

    They are the width in pixels; the 2nd percentile, the median and the 99th percentile of the grey levels in 8 bits;
    the share of pixels at the upper end; the standard deviation against the mean of 3x3 pixels in the darker half; and
    the steepest steps between neighbours.
    """
    grey = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    smooth = cv2.blur(grey, (3, 3)).astype(np.int16)
    black, middle, bright = _percentiles(grey, 2, 50, 99)
    noise = float((grey - smooth)[grey <= middle].std())
    steps = np.abs(np.diff(grey.astype(np.int16), axis=1)).astype(np.uint8)
    clipped = float(np.mean(grey >= 250))
    (detail,) = _percentiles(steps, 99.5)
    levels = np.log2([image.shape[1], black + 1, middle + 1, bright + 1, clipped + 1e-5, noise + 0.1, detail + 1])
    return np.asarray(levels, np.float64)


def _percentiles(values: Image, *percents: float) -> NDArray[np.float64]:
    """As `numpy.percentile`, but from counts of the 256 values, which takes a fifth of its time.

    >>> _percentiles(np.array([[9, 1], [2, 4]], np.uint8), 0, 50, 75, 100)
    array([1.  , 3.  , 5.25, 9.  ])
    """
    numbers = np.bincount(values.ravel(), minlength=256).cumsum()
    places = np.array(percents) / 100 * (values.size - 1)
    low, high = (np.searchsorted(numbers, rounded, side="right") for rounded in (np.floor(places), np.ceil(places)))
    return low + (high - low) * (places % 1)


@functools.cache
def profile_looks() -> Mapping[str, tuple[Look, Look]]:
    """By profile, the mean look of its drives, and the standard deviation over them."""
    with as_file(files(__package__) / "likeness.toml") as path:
        stored = read_toml(path)
    return {name: (np.array(entry["means"]), np.array(entry["spreads"])) for name, entry in stored.items()}


def nearest_profile(look: Look, looks: Mapping[str, tuple[Look, Look]] | None = None) -> tuple[str, float]:
    """The profile that a drive's look is nearest to, and how far it is: 1 is as far as its own drives are."""
    found = {
        name: float(np.sqrt(np.mean(np.square((look - means) / np.maximum(spreads, LEAST_SPREADS)))))
        for name, (means, spreads) in (looks or profile_looks()).items()
    }
    return min(found.items(), key=lambda item: item[1])


class LookSink:
    """A result sink that looks at a few frames of each sequence of a run, in whatever process that is run."""

    def __init__(self, num_frames: int | None = None, white_level: int | None = None) -> None:
        """Takes the number of frames, if known, so that the images are spread over all, and the camera's white."""
        self._white_level = white_level
        self._step = STEP if num_frames is None else max(1, num_frames // NUM_IMAGES)
        self._num_frames: Counter[str] = Counter()  # by sequence
        self._looks: list[Look] = []
        self._brightest: list[int] = []  # of images of 16 bits

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Looks at every so manieth frame."""
        place, is_over = divmod(self._num_frames[frame.sequence], self._step)
        if not is_over and place < NUM_IMAGES:
            self._looks.append(look_of(full_scale(frame, self._white_level).image))
            if frame.image.dtype == np.uint16:
                self._brightest.append(int(frame.image.max()))
        self._num_frames[frame.sequence] += 1

    def add(self, other: LookSink) -> None:
        """Takes over what another one has seen of later sequences."""
        self._looks += other._looks
        self._brightest += other._brightest

    def close(self) -> None:
        """Nothing is left to do."""

    discard = close

    @property
    def brightest(self) -> int | None:
        """The greatest value of the images of 16 bits that were looked at; None if there were none."""
        return max(self._brightest, default=None)

    @property
    def profile(self) -> str | None:
        """The profile that the frames resemble; None if there is none, or no frame."""
        if not self._looks:
            return None
        name, distance = nearest_profile(np.mean(self._looks, axis=0))
        return name if distance <= MAX_DISTANCE else None
