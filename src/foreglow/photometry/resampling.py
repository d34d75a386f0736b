"""Resampling of photometric files, whatever angles they use, to tables over azimuth and elevation."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable

Type: TypeAlias = Literal["A", "B", "C"]
"""Photometric types, by the axes about which the goniometer turns."""

FINEST_STEP_DEG: dict[Type, float] = {"A": 0.05, "B": 0.25, "C": 0.25}
COARSEST_STEP_DEG = 1.0
"""A table has the file's smallest step, limited to this interval; finer structure is lost."""

MAX_CELLS = 8_000_000
"""Cells of a table, 32 MB; over larger areas the finest step is longer: .09 degrees over the whole sphere."""

MAX_CELLS_A_VALUE = 10_000
"""Cells of a table for each of the file's values: a few, two of which are close, do not tell of fine structure."""

MIN_KEPT = 0.75
"""Least share of a peak that is left of it between the angles of a new table: whoever must not be dazzled is by the
peak. Three values over its upper half are enough."""

ROWS_AT_ONCE = 64
"""Rows of a table that are resampled together: what is needed in between takes 100 bytes a cell."""


def resampled(
    kind: Type, verticals: Floats, horizontals: Floats, candela: Floats, origin: str = "lamp"
) -> IntensityTable:
    """A file's intensities over azimuth and elevation in equal steps, in the lamp's frame; 0 outside the file's angles.

    `read_ies` explains the angles of each type.

    Args:
        kind: The photometric type.
        verticals: Shape (V,), growing, degrees; type C: gamma, from the axis.
        horizontals: Shape (H,), growing, degrees. Types A and B: if they begin at 0, they are mirrored to the left.
            Type C: angles of the half-planes, 0 alone, 0 to 90, 0 to 180, 90 to 270 or 0 to 360 degrees; symmetry gives
            the others.
        candela: Shape (V, H), at least 0.
        origin: What messages begin with.

    Raises:
        ValueError: If less than `MIN_KEPT` of the peak is left.
    """
    steps = np.concatenate([np.diff(verticals), np.diff(horizontals)])
    step = float(np.clip(steps.min(), FINEST_STEP_DEG[kind], COARSEST_STEP_DEG))
    if kind == "A":
        elevation_span = (verticals[0], verticals[-1])
        azimuth_span = (-horizontals[-1], horizontals[-1] if _is_one_sided(kind, horizontals) else -horizontals[0])
    else:
        reach = 90.0 if np.abs(verticals).max() <= 90.0 else 180.0
        elevation_span, azimuth_span = (-90.0, 90.0), (-reach, reach)
    spans_deg = [last - first for first, last in (azimuth_span, elevation_span)]
    area = spans_deg[0] * spans_deg[1]
    step = max(step, min(COARSEST_STEP_DEG, float(np.sqrt(area / (MAX_CELLS_A_VALUE * candela.size)))))
    step = max(step, float(np.sqrt(area / MAX_CELLS)))
    azimuths, elevations = (
        np.linspace(first, last, max(2, round((last - first) / step) + 1))
        for first, last in (azimuth_span, elevation_span)
    )
    table = np.empty((len(elevations), len(azimuths)), np.float32)
    for begin in range(0, len(elevations), ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        azimuth, elevation = np.meshgrid(azimuths, elevations[rows])
        vertical, horizontal = _file_angles(kind, azimuth, elevation, horizontals)
        table[rows] = bilinear(candela, verticals, horizontals, vertical, horizontal)
    check_kept(float(candela.max()), float(table.max()), (step, step), f"{origin}: type {kind}")
    return IntensityTable(azimuths, elevations, table)


def check_kept(peak_cd: float, kept_cd: float, steps_deg: tuple[float, float], origin: str) -> None:
    """Passes a new table, in such steps of azimuth and elevation, that has kept the peak of the one before.

    Raises:
        ValueError: If it has not; the message begins with `origin`.
    """
    if kept_cd < MIN_KEPT * peak_cd:
        steps = " x ".join(f"{step:.2g}" for step in steps_deg)
        raise ValueError(
            f"{origin}: expected light that a table in steps of {steps} degrees holds, got a peak of {peak_cd:.0f} cd, "
            f"of which {kept_cd:.0f} are left"
        )


def _file_angles(kind: Type, azimuth: Floats, elevation: Floats, horizontals: Floats) -> tuple[Floats, Floats]:
    """The file's vertical and horizontal angles of directions, degrees, within those that it has by symmetry."""
    x, y, z = _direction(azimuth, elevation)
    if kind == "A":
        vertical, horizontal = elevation, -azimuth
    elif kind == "B":
        vertical, horizontal = np.degrees(np.arctan2(z, x)), -np.degrees(np.arcsin(np.clip(y, -1.0, 1.0)))
    else:
        vertical, horizontal = np.degrees(np.arccos(np.clip(x, -1.0, 1.0))), np.degrees(np.arctan2(y, z)) % 360.0
        horizontal = _folded(horizontal, float(horizontals[0]), float(horizontals[-1]))
    if _is_one_sided(kind, horizontals):
        horizontal = np.abs(horizontal)
    return vertical, horizontal


def _is_one_sided(kind: Type, horizontals: Floats) -> bool:
    return kind != "C" and float(horizontals[0]) == 0.0


def _direction(azimuth_deg: Floats, elevation_deg: Floats) -> tuple[Floats, Floats, Floats]:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)


def _folded(around_deg: Floats, first_deg: float, last_deg: float) -> Floats:
    """C angles 0..360 mapped by symmetry to those in the file."""
    if first_deg == 90.0:  # the plane through C 90 and C 270 is one of symmetry
        return np.where(np.abs(around_deg - 180.0) <= 90.0, around_deg, (540.0 - around_deg) % 360.0)
    half = around_deg if last_deg == 360.0 else np.minimum(around_deg, 360.0 - around_deg)
    quarter = np.minimum(half, 180.0 - half) if last_deg <= 90.0 else half
    return quarter if last_deg > 0.0 else np.zeros_like(quarter)


def bilinear(
    candela: Floats, verticals: Floats, horizontals: Floats, vertical: Floats, horizontal: Floats
) -> NDArray[np.float32]:
    """Intensities at angles between those of a table, up to rounding; 0 outside.

    Args:
        candela: Shape (V, H).
        verticals: Shape (V,), growing, degrees.
        horizontals: Shape (H,), growing, degrees.
        vertical: Angles that are wanted, any shape, degrees.
        horizontal: The same shape, degrees.
    """
    rows = np.interp(vertical, verticals, np.arange(len(verticals)))
    columns = np.interp(horizontal, horizontals, np.arange(len(horizontals)))
    row, column = rows.astype(np.intp), columns.astype(np.intp)
    below, right = np.minimum(row + 1, len(verticals) - 1), np.minimum(column + 1, len(horizontals) - 1)
    v, u = rows - row, columns - column
    upper = candela[row, column] * (1.0 - u) + candela[row, right] * u
    lower = candela[below, column] * (1.0 - u) + candela[below, right] * u
    is_inside = (vertical >= verticals[0] - 1e-6) & (vertical <= verticals[-1] + 1e-6)
    is_inside &= (horizontal >= horizontals[0] - 1e-6) & (horizontal <= horizontals[-1] + 1e-6)
    return np.where(is_inside, upper * (1.0 - v) + lower * v, 0.0).astype(np.float32)
