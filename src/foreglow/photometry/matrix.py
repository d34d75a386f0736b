"""A matrix headlamp: a low beam and 84 LEDs above it, each with its own level."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.lamps import low_beam

NUM_ROWS = 3
NUM_COLUMNS = 28
NUM_LEDS = NUM_ROWS * NUM_COLUMNS

PITCH_DEG = 1.2
"""Between the columns of a lamp; the two lamps are turned by a quarter of it against each other, so that they mesh."""

ROW_ELEVATIONS_DEG = (0.1, 1.5, 3.0)
ROW_PEAKS_CD = (38_000.0, 24_000.0, 9_000.0)
"""Of the column on the axis. Three rows of 28, the lowest the brightest, are the layout of a production lamp."""


@dataclass(frozen=True, slots=True, eq=False)
class MatrixLamp:
    """One matrix headlamp.

    LED `row * 28 + column`: row 0 is the lowest, column 0 the one furthest to the right.

    Attributes:
        base: What shines at any level: the low beam.
        columns: Which columns of the base's table the LEDs reach.
        rows: Which rows of the base's table they reach.
        leds_cd: Shape (84, E, A), float32, candela at level 1, on those rows and columns; 0 outside them.
        azimuths_deg: Shape (84,), middle of each LED's light, positive to the left.
        elevations_deg: Shape (84,), middle of each LED's light, positive upwards.
    """

    base: IntensityTable
    columns: slice
    rows: slice
    leds_cd: NDArray[np.float32]
    azimuths_deg: Floats
    elevations_deg: Floats

    def table(self, levels: ArrayLike) -> IntensityTable:
        """The lamp's intensity with the LEDs at `levels`, shape (84,), each 0..1; linear in them.

        Raises:
            ValueError: If there are not 84 levels, or one is outside 0..1.
        """
        levels = np.asarray(levels, np.float32)
        if levels.shape != (NUM_LEDS,) or not ((levels >= 0) & (levels <= 1)).all():
            raise ValueError(f"levels: expected {NUM_LEDS} numbers from 0 to 1, got {levels!r}")
        intensities = self.base.intensities_cd.copy()
        intensities[self.rows, self.columns] += np.tensordot(levels, self.leds_cd, 1)
        return IntensityTable(self.base.azimuths_deg, self.base.elevations_deg, intensities)


@cache
def matrix_beam(side: Literal["left", "right"]) -> MatrixLamp:
    """The left or right lamp of 2 x 84 LEDs: 3 rows of 28 columns, 34 degrees wide, above the low beam."""
    base = low_beam()
    towards_left = 0.25 * PITCH_DEG if side == "left" else -0.25 * PITCH_DEG
    column_azimuths = (np.arange(NUM_COLUMNS) - (NUM_COLUMNS - 1) / 2) * PITCH_DEG + towards_left
    columns = _reached(base.azimuths_deg, column_azimuths[0] - 2 * PITCH_DEG, column_azimuths[-1] + 2 * PITCH_DEG)
    rows = _reached(base.elevations_deg, ROW_ELEVATIONS_DEG[0] - 2.5, ROW_ELEVATIONS_DEG[-1] + 2.5)
    # Super-Gaussians: flat in the middle, steep at the edges, and gapless where neighbours meet at half their peak.
    across = np.exp(-(np.abs((base.azimuths_deg[columns] - column_azimuths[:, np.newaxis]) / 0.75) ** 2.6))
    heights = base.elevations_deg[rows] - np.array(ROW_ELEVATIONS_DEG)[:, np.newaxis]
    along = np.exp(-(np.abs(heights / 0.85) ** 2.6))
    peaks = np.outer(ROW_PEAKS_CD, np.exp(-0.5 * (column_azimuths / 6.5) ** 2)) + 2_500.0
    leds = np.einsum("rc,re,ca->rcea", peaks, along, across).reshape(NUM_LEDS, along.shape[1], across.shape[1])
    leds = leds.astype(np.float32)
    leds.flags.writeable = False
    azimuths = np.tile(column_azimuths, NUM_ROWS)
    return MatrixLamp(base, columns, rows, leds, azimuths, np.repeat(ROW_ELEVATIONS_DEG, NUM_COLUMNS))


def _reached(grid_deg: Floats, first_deg: float, last_deg: float) -> slice:
    """The part of a growing grid between two angles."""
    return slice(int(np.searchsorted(grid_deg, first_deg)), int(np.searchsorted(grid_deg, last_deg)) + 1)
