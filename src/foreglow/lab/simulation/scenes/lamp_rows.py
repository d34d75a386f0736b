"""Rows of street lamps, by their luminous flux and mounting height."""

from __future__ import annotations

import functools

from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.surroundings import Side, Span, StreetLamp
from foreglow.photometry import street_lamp


@functools.cache
def _flux_of_1_cd_lm() -> float:
    return street_lamp().flux_lm


def intensity_cd(flux_lm: float) -> float:
    """Intensity straight down of a street lamp with this flux.

    >>> round(intensity_cd(10_000.0) / intensity_cd(5_000.0), 6)
    2.0
    """
    return float(f"{flux_lm / _flux_of_1_cd_lm():.5g}")


def lamp_row(
    draw: Draw, side: Side, span_m: Span, *, spacing_m: float, height_m: float, flux_lm: float, offset_m: float
) -> tuple[StreetLamp, ...]:
    """Lamps at equal distances along `span_m`; one in thirty is broken.

    Luminaires on streets have 2,500 to 9,000 lm at 5 to 9 m, on motorways 14,000 to 30,000 lm at 10 to 12 m, 30 to
    50 m apart, which gives the 0.5 to 2 cd/m^2 that EN 13201-2 asks of road classes M5 to M1.
    """
    lamps = []
    s_m = span_m[0] + draw.uniform(0.1, 0.9) * spacing_m
    while s_m < span_m[1] - 2.0:
        is_broken = draw.chance(1 / 30)
        lamps.append(
            StreetLamp(
                side=side,
                s_m=round(s_m, 1),
                offset_m=offset_m,
                height_m=height_m,
                intensity_cd=0.0 if is_broken else intensity_cd(flux_lm),
            )
        )
        s_m += spacing_m
    return tuple(lamps)
