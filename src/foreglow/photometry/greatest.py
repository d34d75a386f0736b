"""The most that LEDs shine anywhere within each cell of a grid of directions, whatever the light between its corners.

A lamp's light is bilinear between the nodes of its table, so that within any part of one of the table's cells it is at
most the greatest at the part's four corners. Cells are divided until a part is no larger than `MAX_PART_DEG`; the bound
of a cell of the grid is the greatest of all parts that reach into it. So no peak between the grid's nodes is missed,
and the bound is too great by no more than what is shone a part further away.
"""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.photometry.matrix import MatrixLamp

MAX_PART_DEG = 0.2

_MARGIN_DEG, _ROUNDING_DEG = 1e-4, 1e-9
"""A side of a part is curved by less than the first, once the lamp is turned. Else it only touches, but for rounding, a
cell whose edge is at its own."""


def greatest_cd(
    lamp: MatrixLamp, vehicle_from_lamp: Floats, azimuths_deg: Floats, elevations_deg: Floats
) -> NDArray[np.float32]:
    """Upper bounds on the intensity of each LED at level 1, shape (E - 1, A - 1, L), cd.

    Args:
        lamp: The lamp.
        vehicle_from_lamp: Shape (3, 3), its rotation.
        azimuths_deg: Shape (A,), the growing edges of the grid's cells, in the vehicle's frame, from -180 to 180.
        elevations_deg: Shape (E,), the same for elevations, from -90 to 90.
    """
    columns_deg, rows_deg = (
        _with_ends(grid[part])
        for grid, part in ((lamp.base.azimuths_deg, lamp.columns), (lamp.base.elevations_deg, lamp.rows))
    )
    num_across, num_up = (
        max(1, int(np.ceil((grid[1] - grid[0]) / MAX_PART_DEG - 1e-6))) for grid in (columns_deg, rows_deg)
    )
    fine_deg = _between(columns_deg, num_across)
    shape = len(elevations_deg) - 1, len(azimuths_deg) - 1
    found = np.zeros((shape[0] * shape[1], lamp.num_leds), np.float32)
    dark = np.zeros(lamp.leds_cd.shape[::2], np.float32)  # beyond the first and the last row
    for number, ends_deg in enumerate(pairwise(rows_deg)):
        below, above = (
            lamp.leds_cd[:, row] if 0 <= row < lamp.leds_cd.shape[1] else dark for row in (number - 1, number)
        )
        leds = np.flatnonzero((below.max(axis=1) > 0) | (above.max(axis=1) > 0))
        if len(leds):
            nodes = np.pad(
                np.stack([below[leds].T, above[leds].T]).astype(np.float64), ((0, 0), (1, 1), (0, 0))
            )  # (2, columns, leds)
            parts = _greatest_of_four(_between(_between(nodes, num_up).swapaxes(0, 1), num_across).swapaxes(0, 1))
            spans = _spans_deg(fine_deg, _between(np.array(ends_deg), num_up), vehicle_from_lamp)
            _raise(found, leds, parts, _cells(spans[0], azimuths_deg), _cells(spans[1], elevations_deg), shape[1])
    return found.reshape(*shape, lamp.num_leds)


def _with_ends(grid_deg: Floats) -> Floats:
    """A grid in equal steps with a step more at either end, where there is no light."""
    step = grid_deg[1] - grid_deg[0]
    return np.concatenate([[grid_deg[0] - step], grid_deg, [grid_deg[-1] + step]])


def _between(nodes: Floats, num: int) -> Floats:
    """Along the first axis, `num` equal steps from each node to the next."""
    shares = (np.arange(num) / num).reshape(1, -1, *[1] * (nodes.ndim - 1))
    steps = nodes[:-1, np.newaxis] * (1.0 - shares) + nodes[1:, np.newaxis] * shares
    return np.concatenate([steps.reshape(-1, *nodes.shape[1:]), nodes[-1:]])


def _greatest_of_four(nodes: Floats) -> Floats:
    """The maxima of neighbours along the first two axes."""
    rows = np.maximum(nodes[1:], nodes[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


def _spans_deg(azimuths_deg: Floats, elevations_deg: Floats, vehicle_from_lamp: Floats) -> tuple[Floats, Floats]:
    """Least and greatest azimuth and elevation, each of shape (2, E - 1, A - 1), of parts in the vehicle's frame."""
    elevations, azimuths = np.meshgrid(np.radians(elevations_deg), np.radians(azimuths_deg), indexing="ij")
    across = np.cos(elevations)
    directions = np.stack([across * np.cos(azimuths), across * np.sin(azimuths), np.sin(elevations)], axis=-1)
    x, y, z = np.moveaxis(directions @ vehicle_from_lamp.T, -1, 0)
    turned = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    margin = -_ROUNDING_DEG if np.array_equal(vehicle_from_lamp, np.eye(3)) else _MARGIN_DEG
    first, second = (
        np.stack([-_greatest_of_four(-each) - margin, _greatest_of_four(each) + margin]) for each in turned
    )
    return first, second


def _cells(spans_deg: Floats, edges_deg: Floats) -> NDArray[np.intp]:
    """The first and the last cell of a grid that each span touches."""
    cells: NDArray[np.intp] = np.searchsorted(edges_deg, spans_deg, side="right") - 1
    return np.clip(cells, 0, len(edges_deg) - 2)


def _raise(
    found: NDArray[np.float32],
    leds: NDArray[np.intp],
    parts: Floats,
    columns: NDArray[np.intp],
    rows: NDArray[np.intp],
    num_columns: int,
) -> None:
    """Raises `found`, shape (cells, L), to what `parts`, shape (E, A, leds), have in the cells that they touch."""
    greatest = parts.reshape(-1, len(leds)).astype(np.float32)
    (first_row, last_row), (first_column, last_column) = rows.reshape(2, -1), columns.reshape(2, -1)
    ups, acrosses = int((last_row - first_row).max()) + 1, int((last_column - first_column).max()) + 1
    for up, across in product(range(ups), range(acrosses)):
        cells = np.minimum(first_row + up, last_row) * num_columns + np.minimum(first_column + across, last_column)
        order = np.argsort(cells, kind="stable")
        touched, starts = np.unique(cells[order], return_index=True)
        raised = np.maximum.reduceat(greatest[order], starts, axis=0)
        block = np.ix_(touched, leds)
        found[block] = np.maximum(found[block], raised)
