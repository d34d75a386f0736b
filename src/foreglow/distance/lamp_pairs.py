"""Lamp pairs: two lights side by side, alike in size and brightness, may be the two headlamps of one vehicle."""

from __future__ import annotations

import foreglow._native as _native
from foreglow.geometry import Floats

SPACING_M = 1.3
SPACING_LOG_SIGMA = 0.1
"""Distance between a car's headlamps, seen from ahead: 1.2 to 1.5 m; and its relative spread, together with the error
of the boxes' centres."""


def pair_spacings_rad(centres: Floats, sizes: Floats, contrasts: Floats) -> Floats:
    """Angle between each box and its partner, shape (N,), radians; NaN without one.

    Partners have similar height, size and brightness, and each is the other's best match; `native/src/lamp_pairs.cpp`
    has the limits.

    Args:
        centres: Shape (N, 2), azimuth to the left and elevation, radians.
        sizes: Shape (N, 2), widths and heights, radians.
        contrasts: Shape (N,), brightness over the surroundings, any unit, positive.
    """
    return _native.pair_spacings(centres, sizes, contrasts)
