"""Drawing the surroundings of a road: open land, forest, rock and walls, a village, and rows of street lamps."""

from __future__ import annotations

import functools
from typing import Literal, TypeAlias

from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.surroundings import (
    House,
    Rail,
    Side,
    Sign,
    SignKind,
    Span,
    StreetLamp,
    SurroundingsSpec,
    Verge,
    Wall,
    Woods,
)
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


Style: TypeAlias = Literal["open", "forest", "rocky", "village"]
SIDES: tuple[Side, Side] = ("left", "right")


def draw_surroundings(
    draw: Draw, style: Style, length_m: float, bends: tuple[tuple[float, float, float], ...]
) -> SurroundingsSpec:
    """The surroundings of a road of `length_m`.

    Args:
        draw: Random numbers.
        style: The kind of land.
        length_m: Length of the road.
        bends: Begin, end and signed curvature of each bend: chevrons and rails stand on its outer side, banks and
            bushes block the view on its inner side.
    """
    bends = tuple(bend for bend in bends if bend[0] < length_m - 40.0)
    snow = draw.uniform(0.3, 1.0) if draw.chance(0.15) else 0.0
    inner: Side | None = None if not bends else ("left" if bends[0][2] > 0 else "right")
    verges = {side: _verge(draw, style, snow, is_inner=side == inner) for side in SIDES}
    return SurroundingsSpec(
        left=verges["left"],
        right=verges["right"],
        rails=() if style == "village" else _rails(draw, length_m, bends),
        walls=_walls(draw, style, length_m),
        signs=_signs(draw, style, length_m, bends),
        woods=_woods(draw, style, length_m, inner),
        houses=_houses(draw, style, length_m),
        street_lamps=_street_lamps(draw, style, length_m),
        delineator_spacing_m=0.0 if style == "village" else draw.choice([25.0, 50.0, 50.0, 0.0]),
        num_bushes=draw.choice([0, 0, 15, 40]),
    )


def _verge(draw: Draw, style: Style, snow: float, *, is_inner: bool) -> Verge:
    if style == "village":
        return Verge(bank_m=0.0, ditch_m=0.0, ground="pavement", snow=snow / 2, grass_per_m2=0.0)
    hides = draw.chance(0.5 if is_inner else 0.35)
    bank = draw.uniform(1.5, 6.0) if hides else draw.uniform(-1.5, 1.2)
    return Verge(
        bank_m=bank,
        bank_offset_m=draw.uniform(1.5, 5.0),
        ditch_m=draw.choice([0.0, 0.2, 0.5]),
        ground=draw.choice(["grass_ground", "grass_ground", "soil", "gravel"]),
        snow=snow,
        grass_height_m=draw.uniform(0.06, 0.2),
        grass_per_m2=draw.choice([0.0, 5.0, 15.0, 30.0]) * (1.0 - snow),
    )


def _rails(draw: Draw, length_m: float, bends: tuple[tuple[float, float, float], ...]) -> tuple[Rail, ...]:
    rails = []
    for start, end, curvature in bends:
        outer: Side = "right" if curvature > 0 else "left"
        if draw.chance(0.6):
            rails.append(_rail(draw, outer, start - draw.uniform(10.0, 60.0), end + draw.uniform(10.0, 60.0), length_m))
        if draw.chance(0.2):
            rails.append(_rail(draw, SIDES[outer == "left"], start, end, length_m))
    if not bends:
        rails += [
            _rail(draw, side, draw.uniform(0.0, 0.4) * length_m, draw.uniform(0.5, 1.0) * length_m, length_m)
            for side in SIDES
            if draw.chance(0.4)
        ]
    return tuple(rails)


def _rail(draw: Draw, side: Side, start_m: float, end_m: float, length_m: float) -> Rail:
    span = (round(max(start_m, 2.0), 1), round(min(end_m, length_m - 2.0), 1))
    return Rail(side=side, span_m=span, offset_m=draw.uniform(0.5, 1.2), post_spacing_m=draw.choice([2.0, 4.0]))


def _walls(draw: Draw, style: Style, length_m: float) -> tuple[Wall, ...]:
    chances: dict[Style, float] = {"open": 0.1, "forest": 0.05, "rocky": 0.8, "village": 0.6}
    walls = []
    for side in SIDES:
        if draw.chance(chances[style]):
            start = draw.uniform(0.0, 0.7) * length_m
            end = min(start + draw.uniform(20.0, 150.0), length_m - 2.0)
            material: Literal["concrete", "brick", "plaster", "rock"]
            material = draw.choice(
                ["rock", "rock", "concrete"] if style == "rocky" else ["concrete", "brick", "plaster"]
            )
            height = draw.uniform(1.5, 5.0) if material == "rock" else draw.uniform(0.6, 2.2)
            span = (round(start, 1), round(end, 1))
            walls.append(
                Wall(side=side, span_m=span, offset_m=draw.uniform(1.8, 6.0), height_m=height, material=material)
            )
    return tuple(walls)


def _signs(
    draw: Draw, style: Style, length_m: float, bends: tuple[tuple[float, float, float], ...]
) -> tuple[Sign, ...]:
    signs = []
    for start, end, curvature in bends:
        if draw.chance(0.45):
            outer: Side = "right" if curvature > 0 else "left"
            kind: SignKind = "chevron_left" if curvature > 0 else "chevron_right"
            spacing = draw.uniform(9.0, 16.0)
            signs += [
                Sign(side=outer, s_m=round(start + number * spacing, 1), kind=kind, height_m=1.0, offset_m=1.5)
                for number in range(draw.integer(2, 6))
                if start + number * spacing < min(end, length_m - 5.0)
            ]
    kinds: tuple[SignKind, ...] = ("round", "triangle", "rectangle", "rectangle", "post_marker")
    for _ in range(draw.integer(0, 6 if style == "village" else 4)):
        faces_oncoming = draw.chance(0.35)
        side: Side = "left" if faces_oncoming else draw.choice(["right", "right", "right", "left"])
        signs.append(
            Sign(
                side=side,
                s_m=round(draw.uniform(15.0, length_m - 5.0), 1),
                kind=draw.choice(kinds),
                offset_m=draw.uniform(0.8, 2.5),
                height_m=draw.uniform(1.2, 2.2),
                size_m=draw.uniform(0.5, 0.9),
                faces_oncoming=faces_oncoming,
            )
        )
    return tuple(signs)


def _woods(draw: Draw, style: Style, length_m: float, inner: Side | None) -> tuple[Woods, ...]:
    chances: dict[Style, float] = {"open": 0.25, "forest": 1.0, "rocky": 0.4, "village": 0.1}
    woods = []
    for side in SIDES:
        if not draw.chance(chances[style]):
            continue
        is_row = style != "forest" and draw.chance(0.5)
        start = 0.0 if style == "forest" else draw.uniform(0.0, 0.6) * length_m
        end = length_m if style == "forest" else min(start + draw.uniform(60.0, 250.0), length_m)
        woods.append(
            Woods(
                side=side,
                span_m=(round(start, 1), round(end, 1)),
                offset_m=draw.uniform(3.0, 6.0) if side == inner else draw.uniform(4.0, 12.0),
                depth_m=0.0 if is_row else draw.uniform(12.0, 30.0),
                spacing_m=draw.uniform(6.0, 15.0) if is_row else draw.uniform(3.5, 6.0),
                leaves=draw.choice([0.0, 0.2, 0.6, 1.0]),
                height_m=draw.uniform(7.0, 18.0),
                has_undergrowth=not is_row and draw.chance(0.7),
            )
        )
    return tuple(woods)


def _houses(draw: Draw, style: Style, length_m: float) -> tuple[House, ...]:
    houses: list[House] = []
    if style == "village":
        for side in SIDES:
            s_m = draw.uniform(5.0, 25.0)
            while s_m < length_m - 10.0:
                houses.append(_house(draw, side, s_m, draw.uniform(2.5, 7.0)))
                s_m += draw.uniform(14.0, 35.0)
    else:
        houses = [
            _house(draw, draw.choice(SIDES), draw.uniform(0.2, 1.0) * (length_m - 10.0), draw.uniform(15.0, 45.0))
            for _ in range(draw.choice([0, 0, 1, 2]))
        ]
    return tuple(houses)


def _house(draw: Draw, side: Side, s_m: float, offset_m: float) -> House:
    return House(
        side=side,
        s_m=round(s_m, 1),
        offset_m=offset_m,
        size_m=(draw.uniform(8.0, 16.0), draw.uniform(7.0, 11.0), draw.uniform(3.0, 7.0)),
        num_lit_windows=draw.choice([0, 0, 1, 2, 4]),
        window_cd_m2=draw.log_uniform(3.0, 60.0),
        yaw_deg=draw.normal(0.0, 6.0),
    )


def _street_lamps(draw: Draw, style: Style, length_m: float) -> tuple[StreetLamp, ...]:
    if style != "village":
        return tuple(
            StreetLamp(
                side=draw.choice(SIDES),
                s_m=round(draw.uniform(40.0, length_m - 5.0), 1),
                offset_m=draw.uniform(3.0, 15.0),
            )
            for _ in range(draw.choice([0, 0, 0, 1]))
        )
    side, height, intensity = draw.choice(SIDES), draw.uniform(5.0, 8.0), draw.log_uniform(400.0, 1500.0)
    first, spacing = draw.uniform(5.0, 30.0), draw.uniform(28.0, 45.0)
    return tuple(
        StreetLamp(side=side, s_m=round(first + number * spacing, 1), height_m=height, intensity_cd=intensity)
        for number in range(int((length_m - 5.0 - first) // spacing) + 1)
        if draw.chance(0.85)
    )
