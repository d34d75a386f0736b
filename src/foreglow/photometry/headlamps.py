"""A car's headlamps, read from a TOML file: their positions, their aim, and the light of each LED."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from foreglow.config import FrozenModel, read_toml, validated
from foreglow.geometry import Floats, Pose, rotation
from foreglow.photometry.aim import (
    MIN_ASIDE_M,
    Aside,
    Forward,
    Height,
    Pitch,
    Turn,
    Yaw,
    check_base_aim,
    check_led_aim,
    check_led_order,
)
from foreglow.photometry.greatest import greatest_cd
from foreglow.photometry.ies import read_ies
from foreglow.photometry.intensity import IntensityTable, squares_m2
from foreglow.photometry.lamps import low_beam
from foreglow.photometry.ldt import read_ldt
from foreglow.photometry.matrix import MAX_LED_CELLS, LedGrid, MatrixLamp, grid_lamp, measured_lamp
from foreglow.wording import check_one_of

MIN_BEAM_CD = 1000.0
"""The least peak of a low beam, and of all LEDs of a lamp together; real ones have ten to forty times as much."""

MIN_LED_CD = 1.0
"""The least peak of an LED: the bundled ones that look furthest aside have some 2,500 cd."""

MAX_LED_RATIO = 100.0
"""Between the peak of an LED of a file and the median of all: of the bundled LEDs at most 4; kcd for cd make 1000."""

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


SHIPPED = Path(__file__).with_name("headlamps.toml")
"""The headlamps of the simulated car."""

READERS = {".ies": read_ies, ".ldt": read_ldt}
"""Readers of photometric files by their endings."""

FileName: TypeAlias = Annotated[Path, Field(strict=False)]
"""Name of an IES or EULUMDAT file, relative to the TOML file's folder."""

Side: TypeAlias = Literal["left", "right"]


@dataclass(frozen=True, slots=True, eq=False)
class Headlamp:
    """One headlamp.

    Attributes:
        vehicle_from_lamp: Its position and the direction of its axis.
        matrix: Its light, in its own frame.
    """

    vehicle_from_lamp: Pose
    matrix: MatrixLamp


@dataclass(frozen=True, slots=True, eq=False)
class Headlamps:
    """A pair of matrix headlamps with the same number L of LEDs.

    Attributes:
        name: A description.
        left: The left lamp.
        right: The right lamp.

    Raises:
        ValueError: If the lamps have different numbers of LEDs or of columns.
    """

    name: str
    left: Headlamp
    right: Headlamp
    _lookup: PairLookup = field(init=False, repr=False)
    _turned: Floats = field(init=False, repr=False)
    _positions_lamp_m: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
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
        """
        return self._lookup.towards(self._along_lamps(directions))

    def greatest_cd(
        self, azimuths_deg: Floats, elevations_deg: Floats
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Upper bounds on what the LEDs of the left and the right lamp shine at level 1, in each cell of a grid.

        Args:
            azimuths_deg: Shape (A,), growing edges of the cells, from -180 to 180, in the vehicle's frame.
            elevations_deg: Shape (E,), the same for elevations, from -90 to 90.

        Returns:
            Shape (E - 1, A - 1, L) each, float32, cd: `intensities_cd` is nowhere greater in a cell.
        """
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
            ValueError: If a point is where a lamp is.
        """
        offsets = self._along_lamps(points_vehicle) - self._positions_lamp_m
        base_cd, leds_cd = self._lookup.towards(offsets)
        per_square_m = 1.0 / squares_m2(offsets)
        leds_cd *= per_square_m[..., np.newaxis]
        return np.asarray((base_cd * per_square_m).sum(-1)), leds_cd

    def _along_lamps(self, vectors: ArrayLike) -> Floats:
        """Vectors of the vehicle's frame, shape (P, 3), in the frames of both lamps, shape (P, 2, 3)."""
        return (np.asarray(vectors, np.float64) @ self._turned).reshape(-1, 2, 3)


class LampDescription(FrozenModel):
    """One lamp in the TOML file.

    Attributes:
        position_m: Its position in the vehicle: forward of the rear axle, left of the middle, above the road.
        yaw_deg: Aim to the left.
        pitch_deg: Aim upwards; 0 for a lamp aimed by the book, since the cut-off lies below the axis in its table.
        base: File of the low beam; by default the built-in one.
        led_files: Files of the LEDs instead of the grid: a list for each row, the lowest first, each from right to
            left.
        turn_deg: Angle by which the grid's columns are turned to the left of the lamp's axis.
    """

    position_m: Annotated[tuple[Forward, Aside, Height], Field(strict=False)]
    yaw_deg: Yaw = 0.0
    pitch_deg: Pitch = 0.0
    base: FileName | None = None
    led_files: Annotated[
        tuple[Annotated[tuple[FileName, ...], Field(strict=False, min_length=1)], ...] | None,
        Field(strict=False, min_length=1),
    ] = None
    turn_deg: Turn = 0.0

    @model_validator(mode="after")
    def _check(self) -> LampDescription:
        if self.led_files is not None and len({len(row) for row in self.led_files}) > 1:
            raise ValueError(f"led_files: expected rows of one length, got {[len(row) for row in self.led_files]}")
        if self.led_files is not None and self.turn_deg:
            raise ValueError(f"turn_deg: expected only with [grid], got {self.turn_deg:g} beside led_files")
        return self


class HeadlampsDescription(FrozenModel):
    """The TOML file of `read_headlamps`.

    Attributes:
        name: A description of the headlamps.
        left: The left lamp.
        right: The right lamp.
        grid: The LEDs of both lamps, if they are generated.
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    left: LampDescription
    right: LampDescription
    grid: LedGrid | None = None

    @model_validator(mode="after")
    def _check(self) -> HeadlampsDescription:
        for side, lamp, sign in (("left", self.left, 1), ("right", self.right, -1)):
            y_m = lamp.position_m[1]
            if sign * y_m < MIN_ASIDE_M:
                limit = f"at least {MIN_ASIDE_M:g}" if sign > 0 else f"at most {-MIN_ASIDE_M:g}"
                raise ValueError(
                    f"{side}.position_m.1: expected {limit} m, on the {side} of the car (y is to the left), got {y_m:g}"
                )
        return self


def read_headlamps(path: Path | str | None = None) -> Headlamps:
    """The headlamps in the TOML file `path`; without a path the built-in ones, which are the simulated car's.

    Raises:
        FileNotFoundError: If the file, or a file that it names, does not exist.
        ValueError: If it is not TOML, a field is unknown, missing or out of range, the lamps do not match, or a file
            that it names is broken; the message names path, field and what was expected.
    """
    return _shipped() if path is None else _read(Path(path))


def read_lamp_file(path: Path | str) -> IntensityTable:
    """The lamp in the IES (LM-63) or EULUMDAT file `path`, by its suffix, in the lamp's frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the suffix is neither `.ies` nor `.ldt`, or the file is broken; the message names the path.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a file whose name ends in {' or '.join(READERS)}")
    return reader(path)


def matrix_beam(side: Side) -> MatrixLamp:
    """The light of the built-in left or right lamp: 3 rows of 28 LEDs, 34 degrees wide, above the low beam.

    Raises:
        ValueError: If there is no such side.
    """
    check_one_of(side, Side, "side")
    return _shipped().left.matrix if side == "left" else _shipped().right.matrix


@cache
def _shipped() -> Headlamps:
    return _read(SHIPPED)


def _read(path: Path) -> Headlamps:
    given = validated(HeadlampsDescription, read_toml(path), str(path))
    left, right = _lamp(path, "left", given.left, given.grid), _lamp(path, "right", given.right, given.grid)
    try:
        return Headlamps(given.name, left, right)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _lamp(path: Path, side: Side, lamp: LampDescription, grid: LedGrid | None) -> Headlamp:
    aim = rotation(float(np.radians(lamp.yaw_deg)), float(np.radians(lamp.pitch_deg)))
    made = Headlamp(Pose(np.array(lamp.position_m), aim), _matrix(path, side, lamp, grid))
    name = f"{path}: {side}.base"
    try:
        check_base_aim(made.matrix.base, made.vehicle_from_lamp)
        name = f"{path}: grid, as {side} aims it" if lamp.led_files is None else f"{path}: {side}.led_files"
        check_led_aim(made.matrix, made.vehicle_from_lamp)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    return made


def _matrix(path: Path, side: str, lamp: LampDescription, grid: LedGrid | None) -> MatrixLamp:
    base = low_beam() if lamp.base is None else _table(path, f"{side}.base", lamp.base)
    _check_bright(base.intensities_cd, f"{path}: {side}.base")
    if lamp.led_files is None:
        if grid is None:
            raise ValueError(f"{path}: {side}.led_files: missing, and there is no [grid] either")
        try:
            made = grid_lamp(base, grid, lamp.turn_deg)
        except ValueError as error:
            raise ValueError(f"{path}: grid: {error}") from error
        _check_leds(made, f"{path}: grid")
        return made
    if grid is not None:
        raise ValueError(f"{path}: {side}.led_files: expected either these or [grid], got both")
    leds, num_cells = [], 0
    for file in (file for row in lamp.led_files for file in row):
        leds.append(_table(path, f"{side}.led_files", file))
        num_cells += leds[-1].intensities_cd.size
        if num_cells > MAX_LED_CELLS:
            raise ValueError(f"{path}: {side}.led_files: expected at most {MAX_LED_CELLS} cells in all, got more")
    try:
        made = measured_lamp(base, leds, len(lamp.led_files[0]))
    except ValueError as error:
        raise ValueError(f"{path}: {side}.led_files: {error}") from error
    _check_leds(made, f"{path}: {side}.led_files")
    _check_units(made, f"{path}: {side}.led_files")
    try:
        check_led_order(made)
    except ValueError as error:
        raise ValueError(f"{path}: {side}.led_files: {error}") from error
    return made


def _check_leds(lamp: MatrixLamp, name: str) -> None:
    """Passes LEDs of which each shines, and that make a headlamp together: a guard that thinks them dark limits none.

    Raises:
        ValueError: If they do not; the message begins with `name`.
    """
    peaks_cd = lamp.leds_cd.max(axis=(1, 2))
    darkest = int(peaks_cd.argmin())
    if peaks_cd[darkest] < MIN_LED_CD:
        raise ValueError(
            f"{name}: LED {darkest}: expected at least {MIN_LED_CD:g} cd in some direction, got {peaks_cd[darkest]:g}"
        )
    _check_bright(lamp.leds_cd.sum(axis=0), f"{name}: all LEDs together")


def _check_units(lamp: MatrixLamp, name: str) -> None:
    """Passes LEDs of which none is so much darker or brighter than most that its file must be in another unit.

    Raises:
        ValueError: If one is; the message begins with `name`.
    """
    peaks_cd = lamp.leds_cd.max(axis=(1, 2))
    usual_cd = float(np.median(peaks_cd))
    for number, peak_cd in enumerate(peaks_cd.tolist()):
        if not usual_cd / MAX_LED_RATIO <= peak_cd <= usual_cd * MAX_LED_RATIO:
            raise ValueError(
                f"{name}: LED {number}: expected a peak of a {MAX_LED_RATIO:g}th to {MAX_LED_RATIO:g} times the median "
                f"of all LEDs, {usual_cd:g} cd, got {peak_cd:g}; is its file in another unit, such as kcd?"
            )


def _check_bright(intensities_cd: NDArray[np.floating], name: str) -> None:
    peak_cd = float(intensities_cd.max())
    if peak_cd < MIN_BEAM_CD:
        raise ValueError(f"{name}: expected at least {MIN_BEAM_CD:g} cd in some direction, got {peak_cd:g} cd")


def _table(path: Path, field_name: str, file: Path) -> IntensityTable:
    try:
        return read_lamp_file(path.parent / file)
    except ValueError as error:
        raise ValueError(f"{path}: {field_name}: {error}") from error
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: {field_name}: {error}") from error
