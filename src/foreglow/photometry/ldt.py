"""Reader of EULUMDAT files (.ldt): measured lamps as intensity tables.

This reader is our own: of the libraries on PyPI, `eulumdat-py` 1.0 (MIT, pure Python) fits our licence but has no
types, reads empty numbers as 0, accepts NaN and takes files that end early for whole ones; `eulumdat` has to be
built with Rust. The checks around either would be longer than the reader.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.files import checked_path
from foreglow.geometry import Floats
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.number_fields import NumberFields, read_lamp_text, scaled_candela
from foreglow.photometry.resampling import resampled

SYMMETRY_LINE, GAMMAS_LINE, FACTOR_LINE, TILT_LINE, SETS_LINE, FLUX_LINE = 3, 6, 24, 25, 26, 29
"""Numbers of the lines, from 1, that hold these fields; the number of C planes is in the line after the symmetry."""

NUM_LAMP_LINES = 6
"""Lines of each set of lamps."""

NUM_DIRECT_RATIOS = 10

PARTS = {0: 1, 1: 1, 2: 2, 3: 4, 4: 4}
"""The number of half-planes is a multiple of this, by symmetry Isym."""

SPANS_DEG = {1: (0.0, 0.0), 2: (0.0, 180.0), 3: (270.0, 450.0), 4: (0.0, 90.0)}
"""First and last half-plane in the file, by symmetry Isym; without symmetry all of them are there."""


def read_ldt(path: Path | str) -> IntensityTable:
    """The lamp in the EULUMDAT file `path`, in the lamp's frame: x along its axis, y left, z up.

    The axis x is gamma 0; the half-plane C 0 lies towards z, C 90 towards y, as in IES files of type C: nose down
    (pitch -90 degrees), C 0 points along the road and C 90 to its left. Half-planes that the file leaves out for
    symmetry are added. Intensities, which the file has in cd for 1000 lm, are multiplied by the flux of the first set
    of lamps and by the file's conversion factor; outside the file's angles they are 0.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it ends early or goes on, has a word that is not a number, an unknown symmetry, counts that do
            not fit it, too few angles or angles that do not grow, an intensity that is negative or that of no lamp, or
            was measured with the lamp tilted; the message names path, line or field, and what was expected.

    Source: Stockmar, EULUMDAT, 1990 and 1998, after public descriptions of the format.
    """
    path = checked_path(path)
    lines = read_lamp_text(path).split("\n")
    fields = NumberFields(path, [(number, line.strip()) for number, line in enumerate(lines, 1)])
    fields.seek(SYMMETRY_LINE - 1)
    symmetry = fields.whole("symmetry Isym", 0)
    if symmetry not in PARTS:
        raise ValueError(f"{path}: line {SYMMETRY_LINE}: symmetry Isym: expected 0, 1, 2, 3 or 4, got {symmetry}")
    num_planes = fields.whole("number of C planes", 1)
    if num_planes % PARTS[symmetry]:
        raise ValueError(
            f"{path}: line {SYMMETRY_LINE + 1}: number of C planes: expected a multiple of {PARTS[symmetry]} with "
            f"Isym = {symmetry}, got {num_planes}"
        )
    fields.seek(GAMMAS_LINE - 1)
    num_gammas = fields.whole("number of intensities in each C plane", 2)
    fields.seek(FACTOR_LINE - 1)
    factor = float(fields.take(1, "conversion factor")[0])
    tilt = lines[TILT_LINE - 1].strip() if len(lines) >= TILT_LINE else ""
    fields.seek(TILT_LINE - 1)
    if tilt and (tilt_deg := float(fields.take(1, "tilt during measurement")[0])):
        expected = "tilt during measurement: expected 0, angles from the lamp's own axis"
        raise ValueError(f"{path}: line {TILT_LINE}: {expected}, got {tilt_deg:g} degrees")
    fields.seek(SETS_LINE - 1)
    num_sets = fields.whole("number of sets of lamps", 1)
    fields.seek(FLUX_LINE - 1)
    flux_lm = float(fields.take(1, "total luminous flux of the lamps")[0])
    if not (factor > 0 and flux_lm > 0):
        raise ValueError(
            f"{path}: lines {FACTOR_LINE}, {FLUX_LINE}: conversion factor, total luminous flux: expected positive "
            f"numbers, got {factor:g} and {flux_lm:g}"
        )
    fields.seek(SETS_LINE + NUM_LAMP_LINES * num_sets + NUM_DIRECT_RATIOS)
    planes = _stored_planes(path, fields.take(num_planes, "angles C"), symmetry)
    gammas = fields.take(num_gammas, "angles gamma")
    if not ((np.diff(gammas) > 0).all() and gammas[0] >= 0 and gammas[-1] <= 180):
        raise ValueError(f"{path}: angles gamma: expected growing angles within 0 to 180 degrees")
    values = fields.take(len(planes) * num_gammas, "intensities")
    fields.end(f"{len(planes)} x {num_gammas} intensities")
    values = scaled_candela(values, factor * flux_lm / 1000.0, f"{path}: intensities")
    candela = values.reshape(len(planes), num_gammas).T
    if symmetry == 0:  # the first plane closes the circle
        planes, candela = np.append(planes, 360.0), np.hstack([candela, candela[:, :1]])
    elif symmetry == 3:  # the same on the other side of the plane of symmetry: 90 to 270
        planes, candela = 540.0 - planes[::-1], candela[:, ::-1]
    return resampled("C", gammas, planes, candela, f"{path}")


def _stored_planes(path: Path, planes: Floats, symmetry: int) -> Floats:
    """The half-planes whose intensities are in the file, degrees, growing; beyond 360 after a full turn."""
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
