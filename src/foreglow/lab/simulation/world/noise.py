"""Smooth random fields over a plane, for uneven ground and plants that grow in patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats

NUM_CELLS = 64
"""Number of cells after which a field repeats."""

_DEVIATION = 0.74
"""Standard deviation of a value between random grid points of deviation 1, with smooth steps between them."""


class Noise:
    """Sum of random fields, each with half the wavelength and half the amplitude of the previous one.

    Mean 0 and standard deviation about 1; it repeats after `NUM_CELLS` times the scale.
    """

    def __init__(self, rng: np.random.Generator, scale_m: float, num_octaves: int = 3) -> None:
        """Draws the field; `scale_m` is the size of its largest features."""
        self._grids = rng.standard_normal((num_octaves, NUM_CELLS, NUM_CELLS))
        self._shifts = rng.uniform(0, NUM_CELLS, (num_octaves, 2))
        self._scale_m = scale_m

    def __call__(self, x_m: ArrayLike, y_m: ArrayLike) -> Floats:
        """The field at points of any shape."""
        x, y = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
        total, amplitudes = np.zeros(x.shape), 0.5 ** np.arange(len(self._grids))
        for octave, (grid, shift, amplitude) in enumerate(zip(self._grids, self._shifts, amplitudes, strict=True)):
            total += amplitude * _between(grid, x * 2**octave / self._scale_m, y * 2**octave / self._scale_m, shift)
        return np.asarray(total / (_DEVIATION * np.sqrt(np.sum(amplitudes**2))))


def _between(grid: Floats, x: Floats, y: Floats, shift: Floats) -> Floats:
    """`grid` at (x, y) + shift, with smooth steps between its points."""
    column, row = np.floor(x + shift[0]), np.floor(y + shift[1])
    u, v = x + shift[0] - column, y + shift[1] - row
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    c0, r0 = column.astype(np.intp) % NUM_CELLS, row.astype(np.intp) % NUM_CELLS
    c1, r1 = (c0 + 1) % NUM_CELLS, (r0 + 1) % NUM_CELLS
    lower = grid[r0, c0] * (1 - u) + grid[r0, c1] * u
    upper = grid[r1, c0] * (1 - u) + grid[r1, c1] * u
    return np.asarray(lower * (1 - v) + upper * v)


def smooth_step(x: ArrayLike) -> Floats:
    """0 below 0, 1 above 1, and a smooth rise in between.

    >>> smooth_step([-1.0, 0.5, 2.0]).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(np.asarray(x, np.float64), 0.0, 1.0)
    return np.asarray(u * u * (3 - 2 * u))
