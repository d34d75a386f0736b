"""How much each LED shines, at most, anywhere in a span of directions."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats, Pose

STEP_DEG = 0.2
AZIMUTHS_DEG = np.arange(-45.0, 45.0 + STEP_DEG / 2, STEP_DEG)
ELEVATIONS_DEG = np.arange(-10.0, 15.0 + STEP_DEG / 2, STEP_DEG)
"""The LEDs have to shine within these; a spread of light above the low beam is smaller."""

DARK_CD = 1.0
"""Less than this at the edges of the grid is taken as nothing."""

MAX_NUM_CELLS = 8
"""Along each axis; a larger span is looked up in larger cells."""

NUM_LEVELS = 7
"""Of the table, each with cells twice as large as the one before."""


class Lamp(Protocol):
    """Where a lamp is."""

    @property
    def vehicle_from_lamp(self) -> Pose:
        """Its place and aim."""
        ...


class Lamps(Protocol):
    """The two lamps, as far as the guard has to know them."""

    @property
    def left(self) -> Lamp:
        """The left lamp."""
        ...

    @property
    def right(self) -> Lamp:
        """The right lamp."""
        ...

    def __hash__(self) -> int: ...

    def intensities_cd(self, directions: Floats, /) -> tuple[Floats, Floats]:
        """Towards directions in the vehicle's frame, shape (P, 3): low beam (P, 2), and LEDs at level 1 (P, 2, L)."""
        ...


class LedBounds:
    """Upper bounds of the LEDs' intensities over spans of azimuth and elevation.

    A table of directions is made once; a cell holds the greatest of its four corners. A span is bounded by the cells
    that it touches, at most 8 x 8 of them: so it is grown by up to a cell to either side.

    Attributes:
        num_leds: LEDs of each lamp.
    """

    def __init__(self, lamps: Lamps) -> None:
        """Makes the table.

        Raises:
            ValueError: If an LED shines beyond its directions.
        """
        corners = np.stack([_row(lamps, elevation_deg) for elevation_deg in ELEVATIONS_DEG])  # (E, A, 2, L)
        edges = (corners[0], corners[-1], corners[:, 0], corners[:, -1])
        if max(float(edge.max()) for edge in edges) > DARK_CD:
            raise ValueError(
                f"lamps: expected LEDs that shine within {AZIMUTHS_DEG[-1]:.0f} degrees to the sides and "
                f"{ELEVATIONS_DEG[0]:.0f} to {ELEVATIONS_DEG[-1]:.0f} degrees in height"
            )
        self.num_leds = corners.shape[-1]
        self._tables = [_greatest_of_four(corners)]
        for _ in range(NUM_LEVELS - 1):
            self._tables.append(_halved(self._tables[-1]))

    def towards(self, spans_rad: Floats) -> NDArray[np.float32]:
        """The bounds in cd, shape (M, 2, L), of spans as `Sightlines.spans_rad` makes them, shape (M, 2, 4)."""
        bounds = np.zeros((len(spans_rad), 2, self.num_leds), np.float32)
        table = self._tables[0]
        first = np.array([AZIMUTHS_DEG[0], AZIMUTHS_DEG[0], ELEVATIONS_DEG[0], ELEVATIONS_DEG[0]])
        last = np.array([table.shape[1], table.shape[1], table.shape[0], table.shape[0]]) - 1
        places = np.floor((np.degrees(spans_rad) - first) / STEP_DEG)
        cells = np.minimum(np.maximum(places, 0), last).astype(np.intp).tolist()
        for number, spans in enumerate(cells):
            for lamp, (a1, a2, e1, e2) in enumerate(spans):
                level = 0
                while max((a2 >> level) - (a1 >> level), (e2 >> level) - (e1 >> level)) >= MAX_NUM_CELLS:
                    level += 1
                rows, columns = slice(e1 >> level, (e2 >> level) + 1), slice(a1 >> level, (a2 >> level) + 1)
                np.maximum.reduce(self._tables[level][rows, columns, lamp], axis=(0, 1), out=bounds[number, lamp])
        return bounds


@lru_cache(maxsize=4)
def led_bounds(lamps: Lamps) -> LedBounds:
    """The bounds of `lamps`, made once: guards of the same lamps share them."""
    return LedBounds(lamps)


def _row(lamps: Lamps, elevation_deg: float) -> NDArray[np.float32]:
    """Intensities of all LEDs along the azimuths, shape (A, 2, L)."""
    azimuths, elevation = np.radians(AZIMUTHS_DEG), np.radians(elevation_deg)
    across = np.cos(elevation)
    directions = np.stack(
        [across * np.cos(azimuths), across * np.sin(azimuths), np.full_like(azimuths, np.sin(elevation))], -1
    )
    return lamps.intensities_cd(directions)[1].astype(np.float32)


def _greatest_of_four(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Of neighbours along the first two axes."""
    rows = np.maximum(table[1:], table[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


def _halved(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """The greatest of 2 x 2 cells along the first two axes; the last ones may stand alone."""
    rows = np.maximum.reduceat(table, np.arange(0, table.shape[0], 2), axis=0)
    return np.maximum.reduceat(rows, np.arange(0, table.shape[1], 2), axis=1)
