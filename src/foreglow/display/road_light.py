"""The light of matrix headlamps on the road, seen from above."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.overlay import Picture
from foreglow.photometry import Headlamps

AHEAD_M = 120.0
"""From the vehicle's origin to the upper border of the map."""

ASIDE_M = 25.0
"""From its middle to the left and right border."""

CELLS = (120, 200)
"""Rows and columns of the map's own grid: 1 m along the road, 0.25 m across."""

DARKEST_LX, BRIGHTEST_LX = 0.05, 200.0
"""Ends of the logarithmic colour scale."""

TICKS_LX = (0.1, 1.0, 10.0, 100.0)

CHUNK = 4000
"""Points whose light is computed at once."""


class RoadLight:
    """What a pair of headlamps shines on the places of a level plane, with all that does not change worked out once.

    The illuminance is that of a surface that faces the lamps, as everywhere in Foreglow.
    """

    def __init__(self, headlamps: Headlamps, height_m: float = 0.0) -> None:
        """The light in the plane z = `height_m`: 0 is the road; at drivers' eyes, 1.2, low beam hides no gap."""
        rows, columns = CELLS
        ahead = AHEAD_M * (1.0 - (np.arange(rows) + 0.5) / rows)
        left = ASIDE_M * (1.0 - 2.0 * (np.arange(columns) + 0.5) / columns)
        x, y = np.meshgrid(ahead, left, indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, height_m)], axis=1)
        base, leds = [], []
        for first in range(0, len(points), CHUNK):
            base_lx, leds_lx = headlamps.illuminance_lx(points[first : first + CHUNK])
            base.append(base_lx)
            leds.append(leds_lx.reshape(len(base_lx), -1).astype(np.float32))
        self._base_lx = np.concatenate(base).astype(np.float32)
        self._leds_lx = np.concatenate(leds)

    def illuminance_lx(self, levels: NDArray[np.float64]) -> NDArray[np.float32]:
        """Shape `CELLS`: furthest row first, from left to right as the driver sees it; `levels` has shape (2, L)."""
        lit = self._leds_lx @ levels.ravel().astype(np.float32)
        return (self._base_lx + lit).reshape(CELLS)

    def picture(self, levels: NDArray[np.float64], width_px: int, height_px: int) -> Picture:
        """The map in colour; `colours` says which stands for what."""
        shares = _share(np.maximum(self.illuminance_lx(levels), 1e-6))
        smooth = cv2.resize(shares, (width_px, height_px), interpolation=cv2.INTER_LINEAR)
        return colours(np.asarray(smooth, np.float32))


def colours(shares: NDArray[np.float32]) -> Picture:
    """The colours of places on the scale, shape (height, width), 0 (`DARKEST_LX`) to 1 (`BRIGHTEST_LX`)."""
    values = np.rint(255.0 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(values, cv2.COLORMAP_INFERNO), np.uint8)


def place_on_scale(lux: float) -> float:
    """Where an illuminance lies on the colour scale, 0 to 1 within it.

    >>> place_on_scale(DARKEST_LX), place_on_scale(BRIGHTEST_LX)
    (0.0, 1.0)
    """
    return float(_share(np.array(lux, np.float64)))


def _share(lux: NDArray[np.float32] | NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(np.log(lux / DARKEST_LX) / np.log(BRIGHTEST_LX / DARKEST_LX), np.float32)
