"""Fast lookup of the light of two headlamps and all their LEDs in a few directions, as every frame's beam needs it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.photometry.matrix import MatrixLamp

MARGIN = 2
"""Width of the border of dark cells around the LEDs' tables; directions outside are looked up in it."""


class PairLookup:
    """The tables of a left and a right lamp with L LEDs each, laid out so that all LEDs of a cell lie side by side."""

    def __init__(self, left: MatrixLamp, right: MatrixLamp) -> None:
        lamps = (left, right)
        bases = [lamp.base for lamp in lamps]
        self._firsts_deg = np.array([[base.azimuths_deg[0], base.elevations_deg[0]] for base in bases])
        steps = [(base.azimuths_deg[1], base.elevations_deg[1]) for base in bases] - self._firsts_deg
        self._cells_per_rad = np.degrees(1.0 / steps)
        self._firsts = self._firsts_deg / steps
        self._last_cells = np.array([[len(base.azimuths_deg), len(base.elevations_deg)] for base in bases]) - 2
        tables = [base.intensities_cd[:, :, np.newaxis] for base in bases]
        leds = [np.pad(lamp.leds_cd.transpose(1, 2, 0), ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))) for lamp in lamps]
        self._base_cd = _Flat(tables)
        self._leds_cd = _Flat(leds)
        self._led_firsts = np.array([[lamp.columns.start, lamp.rows.start] for lamp in lamps]) - MARGIN
        self._led_last_cells = np.array([[table.shape[1], table.shape[0]] for table in leds]) - 2

    def towards(self, directions: Floats) -> tuple[Floats, Floats]:
        """Intensities of the low beams, shape (P, 2), and the LEDs at level 1, shape (P, 2, L), in cd; bilinear.

        Args:
            directions: Shape (P, 2, 3), of any length but 0, in the frames of the left and the right lamp.
        """
        x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
        angles = np.empty((*x.shape, 2))
        np.arctan2(y, x, out=angles[..., 0])
        np.arctan2(z, np.sqrt(x * x + y * y), out=angles[..., 1])
        coordinates = angles * self._cells_per_rad - self._firsts
        cells = np.minimum(np.maximum(np.floor(coordinates), 0), self._last_cells).astype(np.intp)
        shares = coordinates - cells
        is_inside = ((shares >= 0) & (shares <= 1)).all(-1)
        weights = np.empty((*x.shape, 4))
        right, above = shares[..., 0], shares[..., 1] * is_inside
        below = is_inside - above
        weights[..., 3] = above * right
        weights[..., 2] = above - weights[..., 3]
        weights[..., 1] = below * right
        weights[..., 0] = below - weights[..., 1]
        led_cells = np.minimum(np.maximum(cells - self._led_firsts, 0), self._led_last_cells)
        return self._base_cd.weighed(cells, weights)[..., 0], self._leds_cd.weighed(led_cells, weights)


class _Flat:
    """Two tables of shape (rows, columns, L) as one array of cells."""

    def __init__(self, tables: Sequence[NDArray[np.float32]]) -> None:
        rows, columns, num_leds = np.transpose([table.shape for table in tables])
        self._values = np.concatenate([table.reshape(-1, num_leds[0]) for table in tables])
        self._first_cells = np.array([0, rows[0] * columns[0]])
        self._num_columns = columns
        self._corners = np.stack([np.zeros_like(columns), np.ones_like(columns), columns, columns + 1], axis=-1)

    def weighed(self, cells: NDArray[np.intp], weights: Floats) -> Floats:
        """Weighted sums over the four corners of cells, shape (P, 2, L).

        Args:
            cells: Shape (P, 2, 2), column and row of each cell's lower right corner in each of the two tables.
            weights: Shape (P, 2, 4), of the corners: lower right, lower left, upper right, upper left.
        """
        firsts = cells[..., 1] * self._num_columns + cells[..., 0] + self._first_cells
        corners = self._values[firsts[..., np.newaxis] + self._corners]
        return np.asarray(np.einsum("psk,pskl->psl", weights, corners))
