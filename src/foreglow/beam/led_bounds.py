"""Upper bounds on what each LED shines anywhere within a span of directions: a pyramid of maxima.

Units: degrees inside, radians in the interface, candela at level 1; azimuth to the left, elevation upwards, in the
vehicle's frame. For a lamp and an LED, I(e, a) is its intensity on a grid of directions 0.2 degrees apart. The table of
level 0 bounds each cell of the grid by its corners; every further level has cells twice as large:

    T0[i, j] = max(I[i, j], I[i, j + 1], I[i + 1, j], I[i + 1, j + 1])                                          (1)
    Tn[i, j] = max(T(n-1)[2i, 2j], T(n-1)[2i, 2j + 1], T(n-1)[2i + 1, 2j], T(n-1)[2i + 1, 2j + 1])              (2)

The bound over a span of azimuths and elevations is the maximum of all cells that it touches, on the finest level n on
which it touches at most 8 cells along either axis:

    B = max of Tn[i, j] over e1 >> n <= i <= e2 >> n, a1 >> n <= j <= a2 >> n                                   (3)

with the cells e1 .. e2 and a1 .. a2 that the span touches on level 0. So the span is enlarged by less than a cell to
each side, and the cost does not grow with it. (1) holds for light that is bilinear between directions of the grid; a
peak that is narrower than 0.2 degrees could exceed it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats, Pose

STEP_DEG = 0.2
AZIMUTHS_DEG = np.arange(-45.0, 45.0 + STEP_DEG / 2, STEP_DEG)
ELEVATIONS_DEG = np.arange(-10.0, 15.0 + STEP_DEG / 2, STEP_DEG)
"""The grid. LEDs must not shine beyond it; the matrix light of headlamps is narrower. `photometry.aim` has these limits
as well: the guard does not rely on what reads the lamps."""

DARK_CD = 1.0
"""Up to this intensity, an LED counts as dark: at the edges of the grid all do, within it none."""

MAX_NUM_CELLS = 8
"""Greatest number of cells along each axis in (3)."""

NUM_LEVELS = 7
"""Levels of the pyramid."""


class Lamp(Protocol):
    """A lamp with its pose."""

    @property
    def vehicle_from_lamp(self) -> Pose:
        """Position and aim."""
        ...


class Lamps(Protocol):
    """What the guard needs to know of the two lamps."""

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
        """Intensities towards directions in the vehicle's frame, shape (P, 3).

        Of the low beam, shape (P, 2), and of the LEDs at level 1, shape (P, 2, L).
        """
        ...


class LedBounds:
    """Upper bounds of the LEDs' intensities over spans of azimuth and elevation.

    Attributes:
        num_leds: LEDs of each lamp.
    """

    def __init__(self, lamps: Lamps) -> None:
        """Makes the tables.

        Raises:
            ValueError: If an LED shines beyond the grid, or is dark all over it: it would never be dimmed.
        """
        corners = np.stack([_row(lamps, elevation_deg) for elevation_deg in ELEVATIONS_DEG])  # (E, A, 2, L)
        edges = (corners[0], corners[-1], corners[:, 0], corners[:, -1])
        if max(float(edge.max()) for edge in edges) > DARK_CD:
            raise ValueError(
                f"lamps: expected LEDs that shine within {AZIMUTHS_DEG[-1]:.0f} degrees to the sides and "
                f"{ELEVATIONS_DEG[0]:.0f} to {ELEVATIONS_DEG[-1]:.0f} degrees in height"
            )
        dark = np.argwhere(corners.max(axis=(0, 1)) < DARK_CD)
        if len(dark):
            lamp, led = dark[0]
            raise ValueError(
                f"lamps: LED {led} of the {('left', 'right')[lamp]} one: expected at least {DARK_CD:g} cd within "
                f"{AZIMUTHS_DEG[-1]:.0f} degrees to the sides and {ELEVATIONS_DEG[0]:.0f} to {ELEVATIONS_DEG[-1]:.0f} "
                "degrees in height, found less"
            )
        self.num_leds = corners.shape[-1]
        tables = [_greatest_of_four(corners)]
        for _ in range(NUM_LEVELS - 1):
            tables.append(_halved(tables[-1]))
        # By level and lamp, each of shape (E, A, L): what (3) reads lies side by side.
        self._tables = [[np.ascontiguousarray(table[:, :, lamp]) for lamp in range(2)] for table in tables]
        num_rows, num_columns = tables[0].shape[:2]
        self._firsts_deg = np.repeat([AZIMUTHS_DEG[0], ELEVATIONS_DEG[0]], 2)
        self._last_cells = np.repeat([num_columns - 1, num_rows - 1], 2)

    def towards(self, spans_rad: Floats) -> NDArray[np.float32]:
        """The bounds in cd, shape (M, 2, L), of spans as `Sightlines.spans_rad` makes them, shape (M, 2, 4)."""
        bounds = np.zeros((len(spans_rad), 2, self.num_leds), np.float32)
        steps = np.floor((np.degrees(spans_rad) - self._firsts_deg) / STEP_DEG)
        cells = np.minimum(np.maximum(steps, 0), self._last_cells).astype(np.intp).tolist()
        for index, spans in enumerate(cells):
            for lamp, (a1, a2, e1, e2) in enumerate(spans):
                level = 0
                while max((a2 >> level) - (a1 >> level), (e2 >> level) - (e1 >> level)) >= MAX_NUM_CELLS:
                    level += 1
                rows, columns = slice(e1 >> level, (e2 >> level) + 1), slice(a1 >> level, (a2 >> level) + 1)
                touched = self._tables[level][lamp][rows, columns]
                np.maximum.reduce(touched, axis=(0, 1), out=bounds[index, lamp])  # (3)
        return bounds


@lru_cache(maxsize=4)
def led_bounds(lamps: Lamps) -> LedBounds:
    """The bounds of `lamps`; guards of the same lamps share them."""
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
    """Equation (1): the maxima of neighbours along the first two axes."""
    rows = np.maximum(table[1:], table[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


def _halved(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Equation (2): the maxima of 2 x 2 cells along the first two axes; at the end there may be fewer."""
    rows = table[::2].copy()
    np.maximum(rows[: table.shape[0] // 2], table[1::2], out=rows[: table.shape[0] // 2])
    cells = rows[:, ::2].copy()
    np.maximum(cells[:, : table.shape[1] // 2], rows[:, 1::2], out=cells[:, : table.shape[1] // 2])
    return cells
