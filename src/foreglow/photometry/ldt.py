"""Reader of EULUMDAT files (.ldt): measured lamps as intensity tables.

A reader of our own: of the libraries on PyPI, `eulumdat-py` 1.0 (MIT, pure Python) fits our licence but has no types,
takes empty numbers for 0, lets NaN pass and returns a file that ends early without a word; `eulumdat` has to be built
with Rust. What would have to be checked around them is longer than the format.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.resampling import resampled

NUM_HEADER_LINES = 26
NUM_LAMP_LINES = 6
"""Lines of each set of lamps."""

NUM_DIRECT_RATIOS = 10

PARTS = {0: 1, 1: 1, 2: 2, 3: 4, 4: 4}
"""By symmetry Isym: the number of half-planes is a multiple of this."""

SPANS_DEG = {1: (0.0, 0.0), 2: (0.0, 180.0), 3: (270.0, 450.0), 4: (0.0, 90.0)}
"""By symmetry: first and last half-plane in the file; without symmetry all of them."""


def read_ldt(path: Path) -> IntensityTable:
    """The lamp in the EULUMDAT file `path`, in the lamp's frame: x along its axis, y left, z up.

    The axis x is gamma 0; the half-plane C 0 lies towards z, C 90 towards y, as in IES files of type C: nose down
    (pitch -90 degrees), C 0 points along the road and C 90 to its left. Half-planes that symmetry leaves out are
    completed. Intensities, which the file has in cd for 1000 lm, are multiplied by the flux of the first set of lamps
    and by the file's conversion factor; outside the file's angles they are 0. The tilt during the measurement is not
    undone.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it ends early, holds something that is no number, an unknown symmetry, counts that do not fit
            it, too few angles or angles that do not grow, or a negative intensity; the message names path, line or
            field, and what was expected.

    Source: Stockmar, EULUMDAT, 1990 and 1998, after public descriptions of the format.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such EULUMDAT file")
    lines = _Lines(path, path.read_text(encoding="latin-1").split("\n"))
    symmetry = lines.whole(3, "symmetry Isym", 0)
    if symmetry not in PARTS:
        raise ValueError(f"{path}: line 3: symmetry Isym: expected 0, 1, 2, 3 or 4, got {symmetry}")
    num_planes = lines.whole(4, "number of C planes", 1)
    num_gammas = lines.whole(6, "number of intensities in each C plane", 2)
    if num_planes % PARTS[symmetry]:
        raise ValueError(
            f"{path}: line 4: number of C planes: expected a multiple of {PARTS[symmetry]} with Isym = {symmetry}, "
            f"got {num_planes}"
        )
    factor = lines.number(24, "conversion factor")
    num_sets = lines.whole(NUM_HEADER_LINES, "number of sets of lamps", 1)
    flux_lm = lines.number(NUM_HEADER_LINES + 3, "total luminous flux of the lamps")
    if not (factor > 0 and flux_lm > 0):
        raise ValueError(
            f"{path}: lines 24, {NUM_HEADER_LINES + 3}: conversion factor, total luminous flux: expected positive "
            f"numbers, got {factor:g} and {flux_lm:g}"
        )
    first_angle = NUM_HEADER_LINES + NUM_LAMP_LINES * num_sets + NUM_DIRECT_RATIOS + 1
    planes = _stored_planes(path, lines.numbers(first_angle, num_planes, "angles C"), symmetry)
    gammas = lines.numbers(first_angle + num_planes, num_gammas, "angles gamma")
    if not ((np.diff(gammas) > 0).all() and gammas[0] >= 0 and gammas[-1] <= 180):
        raise ValueError(f"{path}: angles gamma: expected growing angles within 0 to 180 degrees")
    values = lines.numbers(first_angle + num_planes + num_gammas, len(planes) * num_gammas, "intensities")
    if not (values >= 0).all():
        raise ValueError(f"{path}: intensities: expected at least 0, got {values.min():g}")
    candela = values.reshape(len(planes), num_gammas).T * (factor * flux_lm / 1000.0)
    if symmetry == 0:  # the first plane closes the circle
        planes, candela = np.append(planes, 360.0), np.hstack([candela, candela[:, :1]])
    elif symmetry == 3:  # the same on the other side of the plane of symmetry: 90 to 270
        planes, candela = 540.0 - planes[::-1], candela[:, ::-1]
    return resampled("C", gammas, planes, candela)


class _Lines:
    """The file's lines, one value each, counted from 1."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        self._path = path
        self._lines = lines

    def number(self, line: int, field: str) -> float:
        """The finite number in a line; a decimal comma is a point."""
        if line > len(self._lines):
            raise ValueError(f"{self._path}: line {line}: {field}: expected a number, the file ends before")
        word = self._lines[line - 1].strip()
        try:
            value = float(word.replace(",", "."))
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"{self._path}: line {line}: {field}: expected a number, got {word!r}")
        return value

    def numbers(self, first_line: int, num: int, field: str) -> Floats:
        """The numbers in `num` lines."""
        if first_line + num - 1 > len(self._lines):
            found = max(0, len(self._lines) - first_line + 1)
            raise ValueError(f"{self._path}: {field}: expected {num} numbers, the file ends after {found}")
        return np.array([self.number(line, field) for line in range(first_line, first_line + num)])

    def whole(self, line: int, field: str, at_least: int) -> int:
        """The whole number in a line."""
        value = self.number(line, field)
        if not (value.is_integer() and value >= at_least):
            raise ValueError(
                f"{self._path}: line {line}: {field}: expected a whole number of at least {at_least}, got {value:g}"
            )
        return int(value)


def _stored_planes(path: Path, planes: Floats, symmetry: int) -> Floats:
    """Those of all half-planes, degrees, whose intensities are in the file, growing; beyond 360 after a full turn."""
    if not ((np.diff(planes) > 0).all() and planes[0] == 0 and planes[-1] < 360):
        raise ValueError(f"{path}: angles C: expected angles that grow from 0 to less than 360 degrees")
    if symmetry == 0:
        return planes
    half, quarter = len(planes) // 2, len(planes) // 4
    stored = {
        1: planes[:1],
        2: planes[: half + 1],
        3: np.concatenate([planes[3 * quarter :], planes[: quarter + 1] + 360.0]),
        4: planes[: quarter + 1],
    }[symmetry]
    if (stored[0], stored[-1]) != SPANS_DEG[symmetry]:
        raise ValueError(
            f"{path}: angles C: expected {SPANS_DEG[symmetry]} as first and last of those that Isym = {symmetry} "
            f"stores, got {(float(stored[0]), float(stored[-1]))}"
        )
    return stored
