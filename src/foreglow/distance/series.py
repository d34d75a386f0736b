"""Ranges of one light over several frames: the paper's five-frame mean and median."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats

NUM_FRAMES = 5
"""Source: Ewecker et al., arXiv 2107.11302, distance estimation over a track."""

Reduce: TypeAlias = Callable[[Floats], Any]

SERIES: dict[str, Reduce] = {"mean of five frames": np.mean, "median of five frames": np.median}
"""What is made of the latest ranges, by name."""


def over_frames(frames: NDArray[np.int64], ranges_m: Floats, reduce: Reduce, num_frames: int = NUM_FRAMES) -> Floats:
    """What `reduce` makes of the ranges in each frame and the `num_frames` - 1 before it, shape (N,).

    Nothing is moved to the time of the latest frame: an approaching light is nearer than the mean of its past.

    Args:
        frames: Shape (N,), numbers of the frames in which the light has a box, ascending; frames may be missing.
        ranges_m: Shape (N,), its ranges; NaN ones are left out, and where all are, so is the result.
        reduce: From some ranges to one.
        num_frames: How many frames of the camera, with or without a range, the window has.

    >>> over_frames(np.array([0, 1, 7]), np.array([50.0, 40.0, 20.0]), np.mean).tolist()
    [50.0, 45.0, 20.0]
    """
    begins = np.searchsorted(frames, frames - num_frames, side="right")
    results = np.full(len(frames), np.nan)
    for place, begin in enumerate(begins):
        window = ranges_m[begin : place + 1]
        known = window[~np.isnan(window)]
        if len(known):
            results[place] = reduce(known)
    return results
