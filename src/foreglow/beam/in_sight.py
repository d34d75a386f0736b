"""Which tracks are lamps in sight: those that the network takes for one, unless a lamp beside them is the surer one.

A lamp lights what is beside it, and some of that light looks half like a lamp: on a rail or on leaves close to the
lamp. As long as no lamp of the vehicle is surely in sight, such a track may be the lamp itself. Once one is, the others
of the same vehicle count as its light, unless they are as sure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.types import Tracks

SURE_DIRECT = 0.9
"""A track is surely a lamp if its probability of that is above this: chosen in decision 21."""


def lamps_in_sight(tracks: Tracks, min_direct: float) -> NDArray[np.bool_]:
    """Which of `tracks` are lamps in sight, front or rear, shape (M,); also those of which it is unknown.

    Args:
        tracks: The tracks of a frame.
        min_direct: A track is a lamp above this probability.
    """
    direct = tracks.direct_probabilities
    is_lamp = ~(direct <= min_direct)
    if tracks.vehicles is not None:
        is_sure = tracks.is_plausible & (direct > SURE_DIRECT)
        if is_sure.any():
            of_tracks = tracks.vehicles.of_tracks
            has_sure = (of_tracks[:, np.newaxis] == of_tracks[is_sure]).any(axis=1)
            is_lamp &= ~(direct <= SURE_DIRECT) | ~has_sure
    return np.asarray(is_lamp)
