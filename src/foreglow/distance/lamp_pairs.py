"""Lamp pairs: two lights beside each other, alike in size and brightness, may be the two headlamps of one vehicle."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats

SPACING_M = 1.3
SPACING_LOG_SIGMA = 0.1
"""Headlamps of cars are 1.2 to 1.5 m apart, seen from ahead; relative, with what the boxes' centres add."""

MAX_CONTRAST_RATIO = 1.5
MAX_SIZE_RATIO = 2.2
"""Product of the ratios of widths and of heights."""

MAX_RISE = 0.35
MAX_SPACING = 16.0
"""Difference of height and distance, in heights of the lower box."""

MIN_SPACING = 0.8
"""In widths of the wider box: what overlaps more is one light."""


def pair_spacings_rad(centres: Floats, sizes: Floats, contrasts: Floats) -> Floats:
    """How far each box is from its partner, shape (N,), radians; NaN without one.

    Partners are at like height, of like size and brightness, and each is the other's best.

    Args:
        centres: Shape (N, 2), to the left and upwards, radians.
        sizes: Shape (N, 2), widths and heights, radians.
        contrasts: Shape (N,), brightness over the surroundings, any unit, positive.
    """
    spacings = np.full(len(centres), np.nan)
    if len(centres) < 2:
        return spacings
    across, rise = (np.abs(column[:, None] - column) for column in centres.T)
    widths, heights = sizes[:, 0], np.minimum(sizes[:, 1, None], sizes[:, 1])
    logs = np.log(np.column_stack([sizes, contrasts]))
    unlike = np.abs(logs[:, None] - logs)
    size_ratio = unlike[..., 0] + unlike[..., 1]
    is_pair = (
        (rise < MAX_RISE * heights)
        & (size_ratio < np.log(MAX_SIZE_RATIO))
        & (unlike[..., 2] < np.log(MAX_CONTRAST_RATIO))
        & (across > MIN_SPACING * np.maximum(widths[:, None], widths))
        & (across < MAX_SPACING * heights)
    )
    # Nearer partners first: beyond them may be another vehicle.
    costs = np.where(is_pair, rise / heights + size_ratio + 0.03 * across / heights, np.inf)
    partners = costs.argmin(axis=1)
    rows = np.arange(len(centres))
    is_mutual = (partners[partners] == rows) & np.isfinite(costs[rows, partners])
    spacings[is_mutual] = across[rows, partners][is_mutual]
    return spacings
