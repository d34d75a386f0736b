"""Reader of IES files (ANSI/IES LM-63, 1986 to 2019): measured lamps as intensity tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.resampling import Type, resampled

TYPES: dict[float, Type] = {1.0: "C", 2.0: "B", 3.0: "A"}
"""Photometric types by their number in the file."""

C_SPANS_DEG = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0))
"""First and last horizontal angle of a type C file; all but 0 to 360 leave out what symmetry gives."""


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
        ValueError: If it is not LM-63, ends early, holds something that is no number, a tilt other than NONE, too few
            angles, or angles that do not grow; the message names path, line or field, and what was expected.

    Source: ANSI/IES LM-63-2019 and its older editions, after public descriptions of the format.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such IES file")
    lines = path.read_text(encoding="latin-1").splitlines()
    numbers = _Numbers(path, lines)
    multiplier = numbers.take(3, "number of lamps, lumens, multiplier")[2]
    num_verticals = numbers.count("number of vertical angles")
    num_horizontals = numbers.count("number of horizontal angles")
    type_number = float(numbers.take(1, "photometric type")[0])
    if type_number not in TYPES:
        raise ValueError(f"{path}: photometric type: expected 1 (C), 2 (B) or 3 (A), got {type_number:g}")
    numbers.take(4, "units and size")
    ballast, second_ballast = numbers.take(3, "ballast factors and watts")[:2]
    verticals = numbers.angles(num_verticals, "vertical angles", at_least=2)
    horizontals = numbers.angles(num_horizontals, "horizontal angles", at_least=1 if TYPES[type_number] == "C" else 2)
    candela = numbers.take(num_verticals * num_horizontals, "candela values")
    # The edition of 2019 turned the second factor into a code for where the file came from.
    candela = candela * multiplier * ballast * (1.0 if "LM-63-2019" in lines[0] else second_ballast)
    if not (candela >= 0).all():
        raise ValueError(f"{path}: candela values: expected at least 0, got {candela.min():g}")
    span = (float(horizontals[0]), float(horizontals[-1]))
    if TYPES[type_number] == "C" and span not in C_SPANS_DEG:
        raise ValueError(f"{path}: horizontal angles: expected a span of {C_SPANS_DEG}, got {span}")
    return resampled(TYPES[type_number], verticals, horizontals, candela.reshape(num_horizontals, num_verticals).T)


class _Numbers:
    """The numbers after the line TILT=NONE, taken in the order of the file."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        tilts = [place for place, line in enumerate(lines) if line.strip().upper().startswith("TILT")]
        if not tilts:
            raise ValueError(f"{path}: expected an IES file (LM-63) with a line TILT=NONE, found no such line")
        tilt = lines[tilts[0]].partition("=")[2].strip()
        if tilt.upper() != "NONE":
            raise ValueError(f"{path}: line {tilts[0] + 1}: expected TILT=NONE, got TILT={tilt}")
        self._path = path
        self._words = [
            (number, word)
            for number, line in enumerate(lines[tilts[0] + 1 :], tilts[0] + 2)
            for word in line.replace(",", " ").split()
        ]
        self._num_taken = 0

    def take(self, num: int, field: str) -> Floats:
        """The next `num` numbers, which are the file's `field`."""
        words = self._words[self._num_taken : self._num_taken + num]
        if len(words) < num:
            raise ValueError(f"{self._path}: {field}: expected {num} numbers, the file ends after {len(words)}")
        self._num_taken += num
        values = np.empty(num)
        for place, (line, word) in enumerate(words):
            try:
                values[place] = float(word)
            except ValueError:
                raise ValueError(f"{self._path}: line {line}: {field}: expected a number, got {word!r}") from None
        return values

    def count(self, field: str) -> int:
        """A whole number of at least 1."""
        value = float(self.take(1, field)[0])
        if value < 1 or not value.is_integer():
            raise ValueError(f"{self._path}: {field}: expected a whole number of at least 1, got {value:g}")
        return int(value)

    def angles(self, num: int, field: str, at_least: int) -> Floats:
        """Growing angles, degrees."""
        if num < at_least:
            raise ValueError(f"{self._path}: {field}: expected at least {at_least}, got {num}")
        angles = self.take(num, field)
        if not ((np.diff(angles) > 0).all() and (np.abs(angles) <= 360).all()):
            raise ValueError(f"{self._path}: {field}: expected growing angles within 360 degrees")
        return angles
