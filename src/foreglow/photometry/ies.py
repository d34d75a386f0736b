"""Reader of IES files (ANSI/IES LM-63, 1986 to 2019): measured lamps as intensity tables."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from foreglow.files import checked_path
from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.number_fields import NumberFields, read_lamp_text, scaled_candela
from foreglow.photometry.resampling import Type, resampled

TYPES: dict[float, Type] = {1.0: "C", 2.0: "B", 3.0: "A"}
"""Photometric types by their number in the file."""

C_SPANS_DEG = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0))
"""First and last horizontal angle of a type C file; in all but 0 to 360, the rest follows from symmetry."""

REACHES_DEG: dict[Type, tuple[tuple[float, float], tuple[float, float]]] = {
    "A": ((-90.0, 90.0), (-180.0, 180.0)),
    "B": ((-180.0, 180.0), (-90.0, 90.0)),
    "C": ((0.0, 180.0), (0.0, 360.0)),
}
"""Least and largest vertical and horizontal angle of each type: light at others would be at no direction."""

_COMMA = re.compile(r"[+-]?\d+,\d+")
"""Two numbers, or one with a decimal comma."""


def read_ies(path: Path | str) -> IntensityTable:
    """The lamp in the IES file `path`, in the lamp's frame: x along its axis, y left, z up.

    * Type A (headlamps): vertical angles are elevations, horizontal ones azimuths, positive to the right as the lamp
      looks; the table's axis is the file's (0, 0).
    * Type B (floodlights): the vertical angle turns a plane up about the horizontal cross axis, the horizontal one
      points to the right within that plane.
    * Type C (luminaires): the axis x is straight down (vertical angle 0); the half-plane C 0 lies towards z, C 90
      towards y. Turned nose down (pitch -90 degrees) C 0 points along the road and C 90 to its left.

    Lamps given for one side of their plane of symmetry are completed. Intensities are multiplied by the file's
    multiplier and ballast factors; outside the file's angles they are 0.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not LM-63, ends early or goes on, has a word that is not a number, a tilt other than NONE,
            too few angles, angles that do not grow or are beyond those of its type, a factor that is not positive, or
            an intensity that is negative or that of no lamp; the message names path, line or field, and what was
            expected.

    Source: ANSI/IES LM-63-2019 and its older editions, after public descriptions of the format.
    """
    path = checked_path(path)
    lines = read_lamp_text(path).splitlines()
    try:
        return _read_lines(path, lines)
    except ValueError as error:
        raise ValueError(f"{error}{_comma_hint(lines)}") from None


def _read_lines(path: Path, lines: list[str]) -> IntensityTable:
    fields = NumberFields(path, _words(path, lines))
    multiplier = fields.take(3, "number of lamps, lumens, multiplier")[2]
    num_verticals = fields.whole("number of vertical angles", 1)
    num_horizontals = fields.whole("number of horizontal angles", 1)
    type_number = float(fields.take(1, "photometric type")[0])
    if type_number not in TYPES:
        raise ValueError(f"{path}: photometric type: expected 1 (C), 2 (B) or 3 (A), got {type_number:g}")
    kind = TYPES[type_number]
    fields.take(4, "units and size")
    ballast, second_ballast = fields.take(3, "ballast factors and watts")[:2]
    # In the edition of 2019, the second factor has become a code for the origin of the file.
    factors = [float(multiplier), float(ballast), 1.0 if "LM-63-2019" in lines[0] else float(second_ballast)]
    if not min(factors) > 0:
        got = ", ".join(f"{factor:g}" for factor in factors)
        raise ValueError(f"{path}: multiplier and ballast factors: expected positive numbers, got {got}")
    verticals_reach, horizontals_reach = REACHES_DEG[kind]
    verticals = _angles(path, fields, num_verticals, "vertical angles", verticals_reach, at_least=2)
    at_least = 1 if kind == "C" else 2
    horizontals = _angles(path, fields, num_horizontals, "horizontal angles", horizontals_reach, at_least=at_least)
    candela = fields.take(num_verticals * num_horizontals, "candela values")
    fields.end(f"{num_verticals} x {num_horizontals} candela values")
    candela = scaled_candela(candela, math.prod(factors), f"{path}: candela values")
    span = (float(horizontals[0]), float(horizontals[-1]))
    if kind == "C" and span not in C_SPANS_DEG:
        raise ValueError(f"{path}: horizontal angles: expected a span of {C_SPANS_DEG}, got {span}")
    return resampled(kind, verticals, horizontals, candela.reshape(num_horizontals, num_verticals).T, f"{path}")


def _comma_hint(lines: list[str]) -> str:
    """What to look for if a file cannot be read in which a comma, which separates numbers, may be a decimal point."""
    is_table = False
    for number, line in enumerate(lines, 1):
        suspect = next((word for word in line.split() if _COMMA.fullmatch(word)), None)
        if is_table and suspect is not None:
            return f"; line {number}: {suspect} counts as two numbers, as a comma separates: write a decimal point"
        is_table = is_table or line.strip().upper().startswith("TILT")
    return ""


def _words(path: Path, lines: list[str]) -> list[tuple[int, str]]:
    """The words after the line TILT=NONE, each with the number of its line."""
    tilts = [index for index, line in enumerate(lines) if line.strip().upper().startswith("TILT")]
    if not tilts:
        raise ValueError(f"{path}: expected an IES file (LM-63) with a line TILT=NONE, found no such line")
    tilt = lines[tilts[0]].partition("=")[2].strip()
    if tilt.upper() != "NONE":
        raise ValueError(f"{path}: line {tilts[0] + 1}: expected TILT=NONE, got TILT={tilt}")
    return [
        (number, word)
        for number, line in enumerate(lines[tilts[0] + 1 :], tilts[0] + 2)
        for word in line.replace(",", " ").split()
    ]


def _angles(
    path: Path, fields: NumberFields, num: int, field: str, reach_deg: tuple[float, float], at_least: int
) -> Floats:
    if num < at_least:
        raise ValueError(f"{path}: {field}: expected at least {at_least}, got {num}")
    angles, (first, last) = fields.take(num, field), reach_deg
    if not ((np.diff(angles) > 0).all() and first <= angles[0] and angles[-1] <= last):
        raise ValueError(f"{path}: {field}: expected growing angles within {first:g} to {last:g} degrees")
    return angles
