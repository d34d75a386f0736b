"""Lamp pairs: two lights beside each other, alike in size and brightness, may be the two headlamps of one vehicle."""

from __future__ import annotations

from foreglow import _native
from foreglow.geometry import Floats

SPACING_M = 1.3
SPACING_LOG_SIGMA = 0.1
"""Headlamps of cars are 1.2 to 1.5 m apart, seen from ahead; relative, with what the boxes' centres add."""


def pair_spacings_rad(centres: Floats, sizes: Floats, contrasts: Floats) -> Floats:
    """How far each box is from its partner, shape (N,), radians; NaN without one.

    Partners are at like height, of like size and brightness, and each is the other's best; how like is in
    `native/src/lamp_pairs.cpp`.

    Args:
        centres: Shape (N, 2), to the left and upwards, radians.
        sizes: Shape (N, 2), widths and heights, radians.
        contrasts: Shape (N,), brightness over the surroundings, any unit, positive.
    """
    return _native.pair_spacings(centres, sizes, contrasts)
