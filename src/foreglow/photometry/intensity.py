"""Tables of luminous intensity over directions, and the illuminance that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats, Pose
from foreglow.numbers import checked_floats, checked_points
from foreglow.types.arrays import check_kind

NEAREST_M = 1e-6
"""Nearer to a lamp, which is a point here, illuminance would grow without limit."""


@dataclass(frozen=True, slots=True, eq=False)
class IntensityTable:
    """Luminous intensity over directions, in the lamp's frame: x along its axis, y left, z up.

    Attributes:
        azimuths_deg: Shape (A,), growing in equal steps, positive to the left: atan2(y, x).
        elevations_deg: Shape (E,), growing in equal steps, positive upwards: atan2(z, hypot(x, y)).
        intensities_cd: Shape (E, A), float32, candela; 0 outside the table.

    Raises:
        ValueError: If a grid is not growing in equal steps, the shapes differ, or a value is negative or not finite.
    """

    azimuths_deg: Floats
    elevations_deg: Floats
    intensities_cd: NDArray[np.float32]

    def __post_init__(self) -> None:
        for name in ("azimuths_deg", "elevations_deg"):
            grid = checked_floats(f"IntensityTable.{name}", getattr(self, name))
            steps = np.diff(grid) if grid.ndim == 1 and len(grid) > 1 and np.isfinite(grid).all() else np.zeros(1)
            if not np.allclose(steps, steps[0], atol=1e-6) or steps[0] <= 0:
                raise ValueError(f"IntensityTable.{name}: expected at least two angles growing in equal steps")
            grid.flags.writeable = False  # all users of a built-in lamp have the same table
            object.__setattr__(self, name, grid)
        is_table = isinstance(self.intensities_cd, np.ndarray) and self.intensities_cd.dtype == np.float32
        given = (
            self.intensities_cd if is_table else checked_floats("IntensityTable.intensities_cd", self.intensities_cd)
        )
        with np.errstate(over="ignore"):  # what is infinite then is refused
            table = np.array(given, np.float32)
        if table.shape != (len(self.elevations_deg), len(self.azimuths_deg)):
            raise ValueError(
                f"IntensityTable.intensities_cd: expected shape "
                f"({len(self.elevations_deg)}, {len(self.azimuths_deg)}), got {table.shape}"
            )
        if not (np.isfinite(table).all() and (table >= 0).all()):
            raise ValueError("IntensityTable.intensities_cd: expected finite values of at least 0")
        table.flags.writeable = False
        object.__setattr__(self, "intensities_cd", table)

    @property
    def mirrored(self) -> IntensityTable:
        """The lamp's mirror image, left for right: a low beam for left-hand traffic, for example."""
        return IntensityTable(-self.azimuths_deg[::-1], self.elevations_deg, self.intensities_cd[:, ::-1])

    @property
    def flux_lm(self) -> float:
        """Luminous flux, the integral of the intensity over the solid angle, lm."""
        steps = np.radians([grid[1] - grid[0] for grid in (self.azimuths_deg, self.elevations_deg)])
        rings = np.cos(np.radians(self.elevations_deg)) * self.intensities_cd.sum(axis=1, dtype=np.float64)
        return float(rings.sum() * steps.prod())

    def towards(self, directions: ArrayLike) -> Floats:
        """Intensity in cd, shape (...), towards `directions` of shape (..., 3) in the lamp's frame; bilinear.

        Raises:
            ValueError: If they are no finite numbers of that shape: others would be in the dark.
        """
        x, y, z = np.moveaxis(checked_points("directions", directions, 3, is_finite=True), -1, 0)
        columns = (np.degrees(np.arctan2(y, x)) - self.azimuths_deg[0]) / (self.azimuths_deg[1] - self.azimuths_deg[0])
        elevations = np.degrees(np.arctan2(z, np.hypot(x, y)))
        rows = (elevations - self.elevations_deg[0]) / (self.elevations_deg[1] - self.elevations_deg[0])
        num_rows, num_columns = self.intensities_cd.shape
        is_inside = (columns >= 0) & (columns <= num_columns - 1) & (rows >= 0) & (rows <= num_rows - 1)
        column = np.clip(np.floor(columns), 0, num_columns - 2).astype(np.intp)
        row = np.clip(np.floor(rows), 0, num_rows - 2).astype(np.intp)
        u, v = np.clip(columns - column, 0, 1), np.clip(rows - row, 0, 1)
        table = self.intensities_cd
        upper = table[row, column] * (1 - u) + table[row, column + 1] * u
        lower = table[row + 1, column] * (1 - u) + table[row + 1, column + 1] * u
        return np.asarray(np.where(is_inside, upper * (1 - v) + lower * v, 0.0))

    @property
    def luminous_flux_lm(self) -> float:
        """Integral of the intensity over the table's solid angle, lumen; trapezoidal rule."""
        elevations = np.radians(self.elevations_deg)
        over_azimuth = np.trapezoid(self.intensities_cd.astype(np.float64), np.radians(self.azimuths_deg), axis=1)
        return float(np.trapezoid(over_azimuth * np.cos(elevations), elevations))


def illuminance_lx(table: IntensityTable, world_from_lamp: Pose, points_world: ArrayLike) -> Floats:
    """Illuminance in lx, shape (...), at points of shape (..., 3) facing the lamp, with nothing in between.

    Raises:
        ValueError: If an argument is of another type or shape, or a point is not finite, or nearer to the lamp than
            `NEAREST_M`.
    """
    check_kind("table", table, IntensityTable)
    check_kind("world_from_lamp", world_from_lamp, Pose)
    points = world_from_lamp.to_body(checked_points("points_world", points_world, 3, is_finite=True))
    return np.asarray(table.towards(points) / squares_m2(points))


def squares_m2(offsets: Floats) -> Floats:
    """Squares of distances, shape (...), to points at `offsets`, shape (..., 3), from a lamp.

    Raises:
        ValueError: If one is nearer than `NEAREST_M`.
    """
    squares = np.sum(offsets * offsets, -1)
    if (squares < NEAREST_M * NEAREST_M).any():
        raise ValueError(f"points: expected points at least {NEAREST_M:g} m away from the lamp, got one where it is")
    return np.asarray(squares)
