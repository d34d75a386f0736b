"""Lamp pairs: two lights side by side, alike in size and brightness, may be the two headlamps of one vehicle.

Near ones have a box each. From some 80 m on, both are in one box, in which a sharp camera still tells them apart.
"""

from __future__ import annotations

import foreglow._native as _native
from foreglow.geometry import Floats
from foreglow.types import Boxes, Image
from foreglow.types.arrays import with_adjacent_columns

SPACING_M = 1.3
SPACING_LOG_SIGMA = 0.1
"""Distance between a car's headlamps, seen from ahead: 1.2 to 1.5 m; and its relative spread, together with the error
of the boxes' centres."""

NEAREST_TWINS_M = 80.0
"""Two lights of one box are a pair from here on. Nearer headlamps have a box each, unless they are seen from the side:
then they seem further away than they are."""


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


def twin_columns_px(image: Image, boxes_xyxy_px: Boxes) -> Floats:
    """Where the left and the right light of each box are, shape (N, 2), pixels; NaN unless there are just two.

    They are side by side, alike in brightness, with a darker place in between: `native/src/twin_lights.cpp` has the
    limits.

    Args:
        image: The frame's pixels.
        boxes_xyxy_px: Shape (N, 4).
    """
    return _native.twin_lights(with_adjacent_columns(image), boxes_xyxy_px)
