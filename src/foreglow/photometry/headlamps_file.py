"""A car's headlamps in a TOML file: their positions, their aim, and the files or the grid of their LEDs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from foreglow.config import FrozenModel, read_toml, validated
from foreglow.files import checked_path
from foreglow.geometry import Pose, rotation
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
from foreglow.photometry.headlamps import Headlamp, Headlamps
from foreglow.photometry.ies import read_ies
from foreglow.photometry.intensity import IntensityTable
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

SHIPPED = Path(__file__).with_name("headlamps.toml")
"""The headlamps of the simulated car."""

READERS = {".ies": read_ies, ".ldt": read_ldt}
"""Readers of photometric files by their endings."""

FileName: TypeAlias = Annotated[Path, Field(strict=False)]
"""Name of an IES or EULUMDAT file, relative to the TOML file's folder."""

Side: TypeAlias = Literal["left", "right"]


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
    return _shipped() if path is None else _read(checked_path(path))


def read_lamp_file(path: Path | str) -> IntensityTable:
    """The lamp in the IES (LM-63) or EULUMDAT file `path`, by its suffix, in the lamp's frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the suffix is neither `.ies` nor `.ldt`, or the file is broken; the message names the path.
    """
    path = checked_path(path)
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
    name = f"{path}: {side}.base" if lamp.base else f"{path}: {side}.pitch_deg"  # the built-in one shines ahead
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
