"""A matrix headlamp: a low beam and LEDs above it, each with its own level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from foreglow.config import FrozenModel
from foreglow.geometry import Floats
from foreglow.numbers import checked_floats, checked_whole
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.resampling import MAX_CELLS, ROWS_AT_ONCE, bilinear, check_kept
from foreglow.types.arrays import check_kind, checked_array
from foreglow.wording import shortened

NUM_LEDS = 84
"""LEDs of a built-in lamp: 3 rows of 28."""

STEPS_ACROSS = 3.0
"""Least number of table steps over half the width or height of a generated LED's light."""

MAX_AZIMUTH_DEG = 45.0
"""Furthest that a lamp's LED shines to a side; the matrix light of headlamps is narrower."""

FINEST_STEP_DEG = 0.05
"""Smallest table step; finer structure of LEDs from files is lost."""

MAX_LED_CELLS = 64_000_000
"""Cells of all LEDs of a lamp, 256 MB: a thousand LEDs with a table of 250 by 250 each."""

MIN_ROW_STEP_DEG = 0.1
"""Least angle between rows; those of radians, of rows up to 5 degrees apart, are closer."""

MAX_LEDS = 1024
"""LEDs of a lamp: the guard's tables take 0.6 MB for each, whatever its own table."""

RowElevation: TypeAlias = Annotated[float, Field(strict=True, ge=-5, le=10)]
Width: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=90)]
HalfWidth: TypeAlias = Annotated[float, Field(strict=True, ge=FINEST_STEP_DEG, le=90)]
Candela: TypeAlias = Annotated[float, Field(strict=True, ge=0, le=1e6)]


@dataclass(frozen=True, slots=True, eq=False)
class MatrixLamp:
    """One matrix headlamp, in the lamp's frame: x along its axis, y left, z up.

    LED `row * num_columns + column`: row 0 is the lowest, column 0 the one furthest to the right.

    Attributes:
        base: The low beam, which shines whatever the levels are.
        columns: The columns of the low beam's table that the LEDs reach.
        rows: The rows of that table that they reach.
        leds_cd: Shape (L, E, A), float32, candela at level 1, on those rows and columns; 0 outside them.
        azimuths_deg: Shape (L,), middle of each LED's light, positive to the left.
        elevations_deg: Shape (L,), middle of each LED's light, positive upwards.
        num_columns: LEDs in a row.

    Raises:
        ValueError: If a field is of another type or shape, or an intensity is negative or not finite.
    """

    base: IntensityTable
    columns: slice
    rows: slice
    leds_cd: NDArray[np.float32]
    azimuths_deg: Floats
    elevations_deg: Floats
    num_columns: int

    def __post_init__(self) -> None:
        for name, kind in (("base", IntensityTable), ("columns", slice), ("rows", slice)):
            check_kind(f"MatrixLamp.{name}", getattr(self, name), kind)
        reached = self.base.intensities_cd[self.rows, self.columns].shape
        leds_cd = checked_array("MatrixLamp.leds_cd", self.leds_cd, np.dtype(np.float32), (None, *reached))
        if not leds_cd.size or not 0 <= leds_cd.min() <= leds_cd.max() < np.inf:
            raise ValueError("MatrixLamp.leds_cd: expected finite intensities of at least 0, of one LED or more")
        num_columns = checked_whole("MatrixLamp.num_columns", self.num_columns, 1)
        if len(leds_cd) % num_columns:
            raise ValueError(f"MatrixLamp.num_columns: expected whole rows of {len(leds_cd)}, got {self.num_columns}")
        for name in ("azimuths_deg", "elevations_deg"):
            angles = checked_floats(f"MatrixLamp.{name}", getattr(self, name))
            if angles.shape != (len(leds_cd),) or not np.isfinite(angles).all():
                raise ValueError(f"MatrixLamp.{name}: expected {len(leds_cd)} finite angles, got {shortened(angles)}")
            angles.flags.writeable = False
            object.__setattr__(self, name, angles)

    @property
    def num_leds(self) -> int:
        """L, the number of LEDs."""
        return len(self.leds_cd)

    def table(self, levels: ArrayLike) -> IntensityTable:
        """The lamp's intensity with the LEDs at `levels`, shape (L,), each 0..1.

        Raises:
            ValueError: If there are not L levels, or one is outside 0..1.
        """
        levels = checked_floats("levels", levels).astype(np.float32)
        if levels.shape != (self.num_leds,) or not ((levels >= 0) & (levels <= 1)).all():
            raise ValueError(f"levels: expected {self.num_leds} numbers from 0 to 1, got {shortened(levels)}")
        intensities = self.base.intensities_cd.copy()
        intensities[self.rows, self.columns] += np.tensordot(levels, self.leds_cd, 1)
        return IntensityTable(self.base.azimuths_deg, self.base.elevations_deg, intensities)


class LedGrid(FrozenModel):
    """LEDs in rows and columns whose light is a smooth function of the angles.

    Each LED is a super-Gaussian, exp(-|angle / half width| ^ edge_exponent), in azimuth and in elevation: flat in the
    middle and steep at the edges.

    Attributes:
        num_columns: LEDs in a row.
        pitch_deg: Distance between columns.
        row_elevations_deg: Middle of each row, the lowest first.
        row_peaks_cd: Peak intensity of each row on the lamp's axis, whatever the columns' turn; to the sides it falls
            off as a Gaussian.
        side_sigma_deg: Standard deviation of that Gaussian.
        everywhere_cd: Constant that is added to the peak of every LED.
        half_width_deg: Angle from the middle of a column at which its light has fallen to 1 / e.
        half_height_deg: The same for a row.
        edge_exponent: Steepness of the edges; 2 is a Gaussian.
        reach_width_deg: Angle from the middle of a column at which its light is cut off.
        reach_height_deg: The same for a row.
    """

    num_columns: Annotated[int, Field(ge=1, le=512)]
    pitch_deg: Width
    row_elevations_deg: Annotated[tuple[RowElevation, ...], Field(strict=False, min_length=1, max_length=64)]
    row_peaks_cd: Annotated[tuple[Candela, ...], Field(strict=False)]
    side_sigma_deg: Annotated[float, Field(strict=True, ge=0.001, le=90)]
    everywhere_cd: Candela
    half_width_deg: HalfWidth
    half_height_deg: HalfWidth
    edge_exponent: Annotated[float, Field(ge=1, le=16)]
    reach_width_deg: Width
    reach_height_deg: Width

    @model_validator(mode="after")
    def _check(self) -> LedGrid:
        elevations, peaks = self.row_elevations_deg, self.row_peaks_cd
        _check_num_leds(self.num_columns * len(elevations), "num_columns")
        if list(elevations) != sorted(set(elevations)):
            raise ValueError(f"row_elevations_deg: expected growing numbers, got {list(elevations)}")
        if len(elevations) > 1 and min(np.diff(elevations)) < MIN_ROW_STEP_DEG - 1e-9:
            raise ValueError(
                f"row_elevations_deg: expected rows at least {MIN_ROW_STEP_DEG:g} degrees apart, got "
                f"{list(elevations)}; are these radians?"
            )
        if len(peaks) != len(elevations):
            raise ValueError(f"row_peaks_cd: expected one for each of {len(elevations)} rows, got {len(peaks)}")
        for side in ("width", "height"):
            reach_deg, half_deg = getattr(self, f"reach_{side}_deg"), getattr(self, f"half_{side}_deg")
            if reach_deg < half_deg:
                raise ValueError(
                    f"reach_{side}_deg: expected at least half_{side}_deg, {half_deg:g}, got {reach_deg:g}"
                )
        return self


def grid_lamp(base: IntensityTable, grid: LedGrid, turn_deg: float = 0.0) -> MatrixLamp:
    """A lamp with generated LEDs.

    Args:
        base: The low beam; its table is resampled if it is too coarse or too small for the LEDs.
        grid: The LEDs.
        turn_deg: Angle by which all columns are turned to the left of the lamp's axis.

    Raises:
        ValueError: If the middle of a column is further than `MAX_AZIMUTH_DEG` from the axis, or the tables are too
            large.
    """
    row_elevations = np.array(grid.row_elevations_deg, np.float64)
    column_azimuths = (
        np.arange(grid.num_columns, dtype=np.float64) - (grid.num_columns - 1) / 2
    ) * grid.pitch_deg + turn_deg
    furthest = max(column_azimuths, key=abs)
    if not abs(furthest) <= MAX_AZIMUTH_DEG:
        raise ValueError(
            f"num_columns: expected columns within {MAX_AZIMUTH_DEG:g} degrees of the axis, with pitch_deg and "
            f"turn_deg, got one at {furthest:g}"
        )
    base = _fine_enough(
        base,
        (column_azimuths[0] - grid.reach_width_deg, column_azimuths[-1] + grid.reach_width_deg),
        (row_elevations[0] - grid.reach_height_deg, row_elevations[-1] + grid.reach_height_deg),
        (grid.half_width_deg / STEPS_ACROSS, grid.half_height_deg / STEPS_ACROSS),
    )
    columns = _reached(base.azimuths_deg, column_azimuths, grid.reach_width_deg)
    rows = _reached(base.elevations_deg, row_elevations, grid.reach_height_deg)
    _check_num_cells(row_elevations.size * column_azimuths.size, rows, columns)
    across = _edged(base.azimuths_deg[columns] - column_azimuths[:, np.newaxis], grid.half_width_deg, grid)
    along = _edged(base.elevations_deg[rows] - row_elevations[:, np.newaxis], grid.half_height_deg, grid)
    to_the_side = np.exp(-0.5 * (column_azimuths / grid.side_sigma_deg) ** 2)
    peaks = np.outer(grid.row_peaks_cd, to_the_side) + grid.everywhere_cd
    leds = np.empty((*peaks.shape, along.shape[1], across.shape[1]), np.float32)
    for row, light in enumerate(leds):  # of all rows at once, there would be several times the memory
        light[:] = np.einsum("c,e,ca->cea", peaks[row], along[row], across)
    leds = leds.reshape(peaks.size, *leds.shape[2:])
    azimuths, elevations = np.tile(column_azimuths, len(row_elevations)), np.repeat(row_elevations, grid.num_columns)
    return MatrixLamp(base, columns, rows, _frozen(leds), azimuths, elevations, grid.num_columns)


def measured_lamp(base: IntensityTable, leds: Sequence[IntensityTable], num_columns: int) -> MatrixLamp:
    """A lamp with LEDs from tables, such as measured ones.

    Args:
        base: The low beam; its table is resampled if it is too coarse or too small for the LEDs.
        leds: One table for each LED at level 1, row by row from the lowest, within a row from right to left.
        num_columns: LEDs in a row.

    Raises:
        ValueError: If an LED is dark everywhere, or too fine for the table; the message has its number. If there are
            too many.
    """
    _check_num_leds(len(leds), "LEDs")
    for number, led in enumerate(leds):
        if not led.intensities_cd.any():
            raise ValueError(f"LED {number}: expected light in some direction, got 0 cd in all")
    azimuth_spans = np.array([_lit_span(led.azimuths_deg, led.intensities_cd.max(0)) for led in leds])
    elevation_spans = np.array([_lit_span(led.elevations_deg, led.intensities_cd.max(1)) for led in leds])
    base = _fine_enough(
        base,
        (azimuth_spans.min(), azimuth_spans.max()),
        (elevation_spans.min(), elevation_spans.max()),
        (
            max(FINEST_STEP_DEG, min(_step(led.azimuths_deg) for led in leds)),
            max(FINEST_STEP_DEG, min(_step(led.elevations_deg) for led in leds)),
        ),
    )
    columns = _reached(base.azimuths_deg, azimuth_spans, _step(base.azimuths_deg))
    rows = _reached(base.elevations_deg, elevation_spans, _step(base.elevations_deg))
    _check_num_cells(len(leds), rows, columns)
    azimuths, elevations = base.azimuths_deg[columns], base.elevations_deg[rows]
    tables = np.stack([_sampled(led, azimuths, elevations) for led in leds])
    steps_deg = _step(azimuths), _step(elevations)
    for number, (led, table) in enumerate(zip(leds, tables, strict=True)):
        check_kept(float(led.intensities_cd.max()), float(table.max()), steps_deg, f"LED {number}")
    left = np.array([np.average(azimuths, weights=table.sum(0)) for table in tables])
    up = np.array([np.average(elevations, weights=table.sum(1)) for table in tables])
    return MatrixLamp(base, columns, rows, _frozen(tables), left, up, num_columns)


def with_mirrored_base(lamp: MatrixLamp) -> MatrixLamp:
    """`lamp` with its low beam mirrored, left for right; its LEDs stay where they are."""
    old, mirrored = lamp.base.azimuths_deg, lamp.base.mirrored
    if np.array_equal(mirrored.azimuths_deg, old):
        return replace(lamp, base=mirrored)
    azimuths, elevations = _finer(old, (-old[-1], -old[0]), _step(old)), lamp.base.elevations_deg
    base = IntensityTable(azimuths, elevations, _sampled(mirrored, azimuths, elevations))
    num_before = round((old[0] - azimuths[0]) / _step(old))
    return replace(lamp, base=base, columns=slice(lamp.columns.start + num_before, lamp.columns.stop + num_before))


def _check_num_leds(num_leds: int, field: str) -> None:
    if num_leds > MAX_LEDS:
        raise ValueError(f"{field}: expected at most {MAX_LEDS} LEDs in all rows, got {num_leds}")


def _check_num_cells(num_leds: int, rows: slice, columns: slice) -> None:
    num_cells = num_leds * (rows.stop - rows.start) * (columns.stop - columns.start)
    if num_cells > MAX_LED_CELLS:
        raise ValueError(
            f"LEDs: expected at most {MAX_LED_CELLS} cells in all tables, got {num_cells}: fewer LEDs, or coarser"
        )


def _edged(angles_deg: Floats, half_width_deg: float, grid: LedGrid) -> Floats:
    return np.asarray(np.exp(-(np.abs(angles_deg / half_width_deg) ** grid.edge_exponent)))


def _frozen(leds_cd: NDArray[np.float32] | Floats) -> NDArray[np.float32]:
    leds = leds_cd.astype(np.float32, copy=False)
    leds.flags.writeable = False
    return leds


def _fine_enough(
    table: IntensityTable,
    azimuth_span_deg: tuple[float, float],
    elevation_span_deg: tuple[float, float],
    steps_deg: tuple[float, float],
) -> IntensityTable:
    """`table`, resampled unless it covers both spans in steps that are small enough."""
    azimuths = _finer(table.azimuths_deg, azimuth_span_deg, steps_deg[0])
    elevations = _finer(table.elevations_deg, elevation_span_deg, steps_deg[1])
    if azimuths is table.azimuths_deg and elevations is table.elevations_deg:
        return table
    if len(azimuths) * len(elevations) > MAX_CELLS:
        raise ValueError(
            f"LEDs: expected a table of at most {MAX_CELLS} cells, got {len(azimuths)} x {len(elevations)}"
        )
    return IntensityTable(azimuths, elevations, _sampled(table, azimuths, elevations))


def _finer(grid_deg: Floats, span_deg: tuple[float, float], step_deg: float) -> Floats:
    """`grid_deg` if it covers the span in such steps; else a finer or longer grid that contains its angles.

    The old step is divided by a whole number, and the grid is continued beyond its ends.
    """
    old_step, (first, last) = _step(grid_deg), span_deg
    if old_step <= step_deg * (1.0 + 1e-6) and grid_deg[0] <= first and last <= grid_deg[-1]:
        return grid_deg
    step = old_step / max(1, np.ceil(old_step / step_deg - 1e-6))
    num_before, num_after = (max(0, np.ceil(gap / step)) for gap in (grid_deg[0] - first, last - grid_deg[-1]))
    first, last = grid_deg[0] - num_before * step, grid_deg[-1] + num_after * step
    num = round((last - first) / step) + 1
    if num > MAX_CELLS:
        raise ValueError(f"LEDs: expected a table of at most {MAX_CELLS} cells, got {num} angles: too fine a step")
    return np.linspace(first, last, num)


def _step(grid_deg: Floats) -> float:
    return float(grid_deg[-1] - grid_deg[0]) / (len(grid_deg) - 1)


def _sampled(table: IntensityTable, azimuths_deg: Floats, elevations_deg: Floats) -> NDArray[np.float32]:
    candela = table.intensities_cd.astype(np.float64)
    sampled = np.empty((len(elevations_deg), len(azimuths_deg)), np.float32)
    for begin in range(0, len(elevations_deg), ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        azimuth, elevation = np.meshgrid(azimuths_deg, elevations_deg[rows])
        sampled[rows] = bilinear(candela, table.elevations_deg, table.azimuths_deg, elevation, azimuth)
    return sampled


def _lit_span(grid_deg: Floats, candela: NDArray[np.float32]) -> tuple[float, float]:
    """From one step before the first lit angle to one step after the last, within the grid."""
    lit = np.flatnonzero(candela)
    return float(grid_deg[max(lit[0] - 1, 0)]), float(grid_deg[min(lit[-1] + 1, len(grid_deg) - 1)])


def _reached(grid_deg: Floats, angles_deg: Floats, reach_deg: float) -> slice:
    """The part of a growing grid within `reach_deg` of the angles, plus one step at its end."""
    first, last = np.min(angles_deg) - reach_deg, np.max(angles_deg) + reach_deg
    return slice(int(np.searchsorted(grid_deg, first)), min(int(np.searchsorted(grid_deg, last)) + 1, len(grid_deg)))
