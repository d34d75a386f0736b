"""Upper bounds on what each LED shines anywhere within a span of directions: a pyramid of maxima.

Units: degrees inside, radians in the interface, candela at level 1; azimuth to the left, elevation upwards, in the
vehicle's frame. For a lamp, an LED and each cell of a grid of directions 0.2 degrees apart, the lamps say the most that
is shone anywhere in it, T0; every further level has cells twice as large:

    Tn[i, j] = max(T(n-1)[2i, 2j], T(n-1)[2i, 2j + 1], T(n-1)[2i + 1, 2j], T(n-1)[2i + 1, 2j + 1])              (1)

The bound over a span of azimuths and elevations is the maximum of all cells that it touches, on the finest level n on
which it touches at most 8 cells along either axis:

    B = max of Tn[i, j] over e1 >> n <= i <= e2 >> n, a1 >> n <= j <= a2 >> n                                   (2)

with the cells e1 .. e2 and a1 .. a2 that the span touches on level 0. So the span is enlarged by less than a cell to
each side, and the cost does not grow with it. The first and the last cell of a row or a column hold all directions
beyond.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats, Pose

STEP_DEG = 0.2
ASIDE_DEG, LOWEST_DEG, HIGHEST_DEG = 45.0, -10.0, 15.0
"""LEDs must not shine beyond; the matrix light of headlamps is narrower. `photometry.aim` has these limits as well: the
guard does not rely on what reads the lamps."""

AZIMUTHS_DEG = np.arange(-ASIDE_DEG - STEP_DEG, ASIDE_DEG + 1.5 * STEP_DEG, STEP_DEG)
ELEVATIONS_DEG = np.arange(LOWEST_DEG - STEP_DEG, HIGHEST_DEG + 1.5 * STEP_DEG, STEP_DEG)
"""The grid, which ends a step beyond."""

DARK_CD = 1.0
"""Up to this intensity, an LED counts as dark: beyond the grid all do, within it none."""

MAX_NUM_CELLS = 8
"""Greatest number of cells along each axis in (2)."""

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

    def __hash__(self) -> int: ...

    @property
    def left(self) -> Lamp:
        """The left lamp."""
        ...

    @property
    def right(self) -> Lamp:
        """The right lamp."""
        ...

    def greatest_cd(
        self, azimuths_deg: Floats, elevations_deg: Floats, /
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """By the edges of cells, the most that the LEDs of the left and the right lamp shine in them at level 1.

        Shape (E - 1, A - 1, L) each; cd.
        """
        ...


class LedBounds:
    """The table of maxima for a pair of lamps."""

    def __init__(self, lamps: Lamps) -> None:
        """Makes the tables.

        Raises:
            ValueError: If an LED shines beyond the grid, or is dark all over it: it would never be dimmed.
        """
        greatest = lamps.greatest_cd(
            np.concatenate([[-180.0], AZIMUTHS_DEG, [180.0]]), np.concatenate([[-90.0], ELEVATIONS_DEG, [90.0]])
        )
        within = (
            f"within {ASIDE_DEG:.0f} degrees to the sides and {LOWEST_DEG:.0f} to {HIGHEST_DEG:.0f} degrees in height"
        )
        beyond = [edge for table in greatest for edge in (table[0], table[-1], table[:, 0], table[:, -1])]
        if max(float(edge.max()) for edge in beyond) > DARK_CD:
            raise ValueError(f"lamps: expected LEDs that shine {within}")
        dark = np.argwhere(np.stack([table.max(axis=(0, 1)) for table in greatest]) < DARK_CD)
        if len(dark):
            lamp, led = dark[0]
            raise ValueError(
                f"lamps: LED {led} of the {('left', 'right')[lamp]} one: expected at least {DARK_CD:g} cd {within}, "
                "found less"
            )
        num_rows, num_columns, self.num_leds = greatest[0].shape
        # By level and lamp, each of shape (E, A, L): what (2) reads lies side by side.
        self._tables = [list(greatest)]
        for _ in range(NUM_LEVELS - 1):
            self._tables.append([_halved(table) for table in self._tables[-1]])
        self._firsts_deg = np.repeat([AZIMUTHS_DEG[0], ELEVATIONS_DEG[0]], 2) - STEP_DEG
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
                np.maximum.reduce(touched, axis=(0, 1), out=bounds[index, lamp])  # (2)
        return bounds


@lru_cache(maxsize=4)
def led_bounds(lamps: Lamps) -> LedBounds:
    """The bounds of `lamps`; guards of the same lamps share them."""
    return LedBounds(lamps)


def _halved(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Equation (1): the maxima of 2 x 2 cells along the first two axes; at the end there may be fewer."""
    rows = table[::2].copy()
    np.maximum(rows[: table.shape[0] // 2], table[1::2], out=rows[: table.shape[0] // 2])
    cells = rows[:, ::2].copy()
    np.maximum(cells[:, : table.shape[1] // 2], rows[:, 1::2], out=cells[:, : table.shape[1] // 2])
    return cells
