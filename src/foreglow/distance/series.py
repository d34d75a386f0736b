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
"""Averages of the latest ranges, by name."""


def over_frames(frames: NDArray[np.int64], ranges_m: Floats, reduce: Reduce) -> Floats:
    """`reduce` applied to the ranges in each frame and the `NUM_FRAMES` - 1 before it, shape (N,).

    Earlier ranges are not predicted to the latest frame: an approaching light is nearer than their mean.

    Args:
        frames: Shape (N,), numbers of the frames in which the light has a box, ascending; frames may be missing.
        ranges_m: Shape (N,), its ranges; NaN is left out, and the result is NaN where all are.
        reduce: Makes one range out of several.

    >>> over_frames(np.array([0, 1, 7]), np.array([50.0, 40.0, 20.0]), np.mean).tolist()
    [50.0, 45.0, 20.0]
    """
    begins = np.searchsorted(frames, frames - NUM_FRAMES, side="right")
    results = np.full(len(frames), np.nan)
    for index, begin in enumerate(begins):
        window = ranges_m[begin : index + 1]
        known = window[~np.isnan(window)]
        if len(known):
            results[index] = reduce(known)
    return results
