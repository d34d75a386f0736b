"""Where a track, or a vehicle, is in its life."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from foreglow.wording import shortened


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    """Not yet plausible: must not be acted on."""
    CONFIRMED = 1
    """Plausible, and detected in this frame."""
    COASTING = 2
    """Plausible, but not detected in this frame: predicted."""


def check_states(field: str, states: NDArray[np.int64]) -> None:
    """Checks that each of `states`, shape (N,), is a `TrackState`.

    Raises:
        ValueError: If one is not; the message begins with `field`.
    """
    if len(states) and not (states.min() >= _FIRST and states.max() <= _LAST):
        raise ValueError(f"{field}: expected numbers from {_FIRST} to {_LAST}, got {shortened(states)}")


_FIRST, _LAST = int(min(TrackState)), int(max(TrackState))
