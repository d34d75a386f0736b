"""Reader of IES files (ANSI/IES LM-63, 1986 to 2019): measured lamps as intensity tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.number_fields import NumberFields, read_lamp_text
from foreglow.photometry.resampling import Type, resampled

TYPES: dict[float, Type] = {1.0: "C", 2.0: "B", 3.0: "A"}
"""Photometric types by their number in the file."""

C_SPANS_DEG = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0))
"""First and last horizontal angle of a type C file; in all but 0 to 360, the rest follows from symmetry."""


def read_ies(path: Path) -> IntensityTable:
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
        ValueError: If it is not LM-63, ends early, has a word that is not a number, a tilt other than NONE, too few
            angles, or angles that do not grow; the message names path, line or field, and what was expected.

    Source: ANSI/IES LM-63-2019 and its older editions, after public descriptions of the format.
    """
    lines = read_lamp_text(path).splitlines()
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
    verticals = _angles(path, fields, num_verticals, "vertical angles", at_least=2)
    horizontals = _angles(path, fields, num_horizontals, "horizontal angles", at_least=1 if kind == "C" else 2)
    if kind == "A" and max(np.abs(verticals).max() - 90, np.abs(horizontals).max() - 180) > 0:
        raise ValueError(f"{path}: angles: expected vertical ones within 90 degrees and horizontal ones within 180")
    candela = fields.take(num_verticals * num_horizontals, "candela values")
    # In the edition of 2019, the second factor has become a code for the origin of the file.
    candela = candela * multiplier * ballast * (1.0 if "LM-63-2019" in lines[0] else second_ballast)
    if not (candela >= 0).all():
        raise ValueError(f"{path}: candela values: expected at least 0, got {candela.min():g}")
    span = (float(horizontals[0]), float(horizontals[-1]))
    if kind == "C" and span not in C_SPANS_DEG:
        raise ValueError(f"{path}: horizontal angles: expected a span of {C_SPANS_DEG}, got {span}")
    return resampled(kind, verticals, horizontals, candela.reshape(num_horizontals, num_verticals).T)


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


def _angles(path: Path, fields: NumberFields, num: int, field: str, at_least: int) -> Floats:
    if num < at_least:
        raise ValueError(f"{path}: {field}: expected at least {at_least}, got {num}")
    angles = fields.take(num, field)
    if not ((np.diff(angles) > 0).all() and (np.abs(angles) <= 360).all()):
        raise ValueError(f"{path}: {field}: expected growing angles within 360 degrees")
    return angles
