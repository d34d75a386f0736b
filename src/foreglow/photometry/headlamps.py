"""A car's headlamps: where they are, how they are aimed, and the light of each of their LEDs in any direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats, Pose
from foreglow.numbers import checked_floats, checked_points
from foreglow.photometry.greatest import greatest_cd
from foreglow.photometry.intensity import squares_m2
from foreglow.photometry.matrix import MatrixLamp
from foreglow.types.arrays import check_kind
from foreglow.wording import shortened

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


@dataclass(frozen=True, slots=True, eq=False)
class Headlamp:
    """One headlamp.

    Attributes:
        vehicle_from_lamp: Its position and the direction of its axis.
        matrix: Its light, in its own frame.
    """

    vehicle_from_lamp: Pose
    matrix: MatrixLamp

    def __post_init__(self) -> None:
        check_kind("Headlamp.vehicle_from_lamp", self.vehicle_from_lamp, Pose)
        check_kind("Headlamp.matrix", self.matrix, MatrixLamp)


@dataclass(frozen=True, slots=True, eq=False)
class Headlamps:
    """A pair of matrix headlamps with the same number L of LEDs.

    Attributes:
        name: A description.
        left: The left lamp.
        right: The right lamp.

    Raises:
        ValueError: If a field is of another type, or the lamps have different numbers of LEDs or of columns.
    """

    name: str
    left: Headlamp
    right: Headlamp
    _lookup: PairLookup = field(init=False, repr=False)
    _turned: Floats = field(init=False, repr=False)
    _positions_lamp_m: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name, kind in (("name", str), ("left", Headlamp), ("right", Headlamp)):
            check_kind(f"Headlamps.{name}", getattr(self, name), kind)
        lamps = (self.left, self.right)
        layouts = [(lamp.matrix.num_leds, lamp.matrix.num_columns) for lamp in lamps]
        if layouts[0] != layouts[1]:
            raise ValueError(f"Headlamps: expected as many LEDs and columns left as right, got {layouts}")
        turned = np.hstack([lamp.vehicle_from_lamp.rotation for lamp in lamps])
        origins = [lamp.vehicle_from_lamp.position_m @ lamp.vehicle_from_lamp.rotation for lamp in lamps]
        object.__setattr__(self, "_lookup", PairLookup(self.left.matrix, self.right.matrix))
        object.__setattr__(self, "_turned", turned)
        object.__setattr__(self, "_positions_lamp_m", np.stack(origins))

    @property
    def num_leds(self) -> int:
        """L, LEDs of one lamp."""
        return self.left.matrix.num_leds

    @property
    def num_columns(self) -> int:
        """LEDs in a row of one lamp; LED `row * num_columns + column`, row 0 lowest, column 0 furthest right."""
        return self.left.matrix.num_columns

    def intensities_cd(self, directions: ArrayLike) -> tuple[Floats, Floats]:
        """Luminous intensities towards far points.

        Args:
            directions: Shape (P, 3), finite, of any length but 0, in the vehicle's frame; the lamps' positions do not
                matter.

        Returns:
            Intensities of the low beams, shape (P, 2), left and right, cd; and of the LEDs at level 1, shape
            (P, 2, L), cd. The total is low beam + levels * LEDs, summed over L.

        Raises:
            ValueError: If the directions are none of these.
        """
        vectors = _finite("directions", directions)
        if not vectors.any(axis=1).all():
            raise ValueError("directions: expected vectors of any length but 0, got one of length 0")
        return self._lookup.towards(self._along_lamps(vectors))

    def greatest_cd(
        self, azimuths_deg: Floats, elevations_deg: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Upper bounds on what the LEDs of the left and the right lamp shine at level 1, in each cell of a grid.

        Args:
            azimuths_deg: Shape (A,), growing edges of the cells, from -180 to 180, in the vehicle's frame.
            elevations_deg: Shape (E,), the same for elevations, from -90 to 90.

        Returns:
            Shape (E - 1, A - 1, L) each, float32, cd: `intensities_cd` is nowhere greater in a cell.

        Raises:
            ValueError: If the edges are not those of such a grid.
        """
        azimuths_deg = _edges_deg("azimuths_deg", azimuths_deg, 180.0)
        elevations_deg = _edges_deg("elevations_deg", elevations_deg, 90.0)
        left, right = (
            greatest_cd(lamp.matrix, lamp.vehicle_from_lamp.rotation, azimuths_deg, elevations_deg)
            for lamp in (self.left, self.right)
        )
        return left, right

    def illuminance_lx(self, points_vehicle: ArrayLike) -> tuple[Floats, Floats]:
        """Illuminance at points, on a plane that faces each lamp, with nothing in between.

        Args:
            points_vehicle: Shape (P, 3), metres, finite and away from the lamps, in the vehicle's frame.

        Returns:
            Illuminance by both low beams together, shape (P,), lx; and by each LED at level 1, shape (P, 2, L), lx. The
            total is low beams + levels * LEDs, summed over lamps and L.

        Raises:
            ValueError: If the points are none of these, or one is where a lamp is.
        """
        offsets = self._along_lamps(_finite("points_vehicle", points_vehicle)) - self._positions_lamp_m
        base_cd, leds_cd = self._lookup.towards(offsets)
        per_square_m = 1.0 / squares_m2(offsets)
        leds_cd *= per_square_m[..., np.newaxis]
        return np.asarray((base_cd * per_square_m).sum(-1)), leds_cd

    def _along_lamps(self, vectors: Floats) -> Floats:
        """Vectors of the vehicle's frame, shape (P, 3), in the frames of both lamps, shape (P, 2, 3)."""
        return (vectors @ self._turned).reshape(-1, 2, 3)


def _finite(field: str, vectors: ArrayLike) -> Floats:
    """Finite vectors of shape (P, 3): any others would be in the dark."""
    found = checked_points(field, vectors, 3, is_finite=True)
    if found.ndim != 2:
        raise ValueError(f"{field}: expected numbers of shape (P, 3), got shape {found.shape}")
    return found


def _edges_deg(field: str, edges_deg: ArrayLike, most_deg: float) -> Floats:
    """The growing edges of a grid's cells."""
    found = checked_floats(field, edges_deg)
    if (
        found.ndim != 1
        or len(found) < 2
        or not (np.diff(found) > 0).all()
        or not np.abs(found).max() <= most_deg + 1e-9
    ):
        expected = f"two or more growing angles from {-most_deg:g} to {most_deg:g} degrees"
        raise ValueError(f"{field}: expected {expected}, got {shortened(found)}")
    return found
