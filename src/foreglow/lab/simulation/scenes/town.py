"""Drawing a lit town street: lamps in rows, houses wall to wall, shops, billboards, traffic lights, much traffic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from foreglow.lab.simulation.scenes.assembly import Journey, assembled
from foreglow.lab.simulation.scenes.draw import Draw, draw_weather
from foreglow.lab.simulation.scenes.roadside import lamp_row
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.stream import TOWN, Braking, Kinds, Stream, drawn_kind, drawn_vehicle, slowed
from foreglow.lab.simulation.scenes.surroundings import (
    House,
    Panel,
    Side,
    Sign,
    Signal,
    StreetLamp,
    SurroundingsSpec,
    Verge,
)

START_M = 60.0
SIGHT_M = 320.0
SIDES: tuple[Side, Side] = ("left", "right")
PAVED = Verge(bank_m=0.0, bank_offset_m=12.0, ditch_m=0.0, ground="pavement", grass_per_m2=0.0)

PARKED: Kinds = {"car": 0.85, "van": 0.15}

SHOP_CD_M2 = (60.0, 400.0)
"""Luminances of shop windows; similar to published measurements in European high streets."""

BILLBOARD_CD_M2 = (60.0, 300.0)
"""Luminances of billboards at night. Source: ILP PLG 05, at most 300 cd/m^2 in towns (zone E3)."""

WINDOW_CD_M2 = (3.0, 100.0)
"""Luminances of windows of flats, from lamps behind curtains to bright kitchens."""

SIGNAL_CD = (80.0, 400.0)
"""Intensities of traffic lights on their axis; EN 12368, classes 1 to 3, dimmed or not."""

MAX_ONCOMING, MAX_AHEAD, MAX_PARKED = 7, 4, 12


@dataclass(frozen=True, slots=True)
class _Street:
    """A street and what it is like.

    Attributes:
        road: The carriageway, with parking lanes or without.
        has_parking: Whether cars may park.
        bustle: From 0, a suburb, to 1, a high street: more shops, light and traffic.
    """

    road: RoadSpec
    has_parking: bool
    bustle: float


def town(draw: Draw, name: str, seed: int, lasts_s: tuple[float, float] = (7.0, 10.0)) -> Scene:
    """A drive along a street of a town at night."""
    weather, wetness = draw_weather(draw)
    wetness = max(wetness, draw.uniform(0.5, 1.0)) if draw.chance(0.3) else wetness
    duration_s, speed = draw.uniform(*lasts_s), draw.uniform(8.0, 15.5)
    length_m = float(round(START_M + speed * duration_s + SIGHT_M))
    street = _street(draw, length_m, wetness)
    is_braking = draw.chance(0.4)
    braking = Braking(draw.uniform(1.0, 4.0), draw.uniform(4.5, 7.0), draw.uniform(1.0, 2.5))
    lane = draw.integer(0, street.road.num_lanes - 1)
    journey = Journey(duration_s, START_M, speed, braking.delayed(0.8) if is_braking else None, lane)
    vehicles = [
        *_ahead(draw, journey, braking if is_braking else None),
        *_oncoming(draw, journey, street),
        *_cyclists(draw, street),
        *_parked(draw, street),
    ]
    surroundings = _surroundings(draw, street, START_M + speed * duration_s)
    return assembled(draw, (name, seed), journey, street.road, surroundings, vehicles, weather)


def _street(draw: Draw, length_m: float, wetness: float) -> _Street:
    bend = draw.choice([-1, 1]) / draw.log_uniform(150.0, 900.0)
    start = draw.uniform(0.2, 0.5) * length_m
    points = ((0.0, 0.0), (start, 0.0), (start + 25.0, bend), (start + 90.0, bend), (start + 115.0, 0.0))
    has_parking = draw.chance(0.6)
    num_lanes = draw.choice([1, 2], [0.7, 0.3])
    road = RoadSpec(
        length_m=length_m,
        lane_width_m=draw.uniform(3.0, 3.5),
        num_lanes=num_lanes,
        shoulders_m=(0.0, draw.uniform(2.1, 2.3) if has_parking else draw.uniform(0.3, 1.5)),
        curvature_per_m=tuple((round(s_m, 1), float(f"{k:.5g}")) for s_m, k in points)
        if draw.chance(0.6)
        else ((0, 0),),
        elevation_m=((0.0, 0.0), (length_m / 2, draw.uniform(-4.0, 4.0)), (length_m, draw.uniform(-4.0, 4.0))),
        centre_marking=draw.choice(["dashed", "solid", "none"], [0.6, 0.2, 0.2]),
        has_edge_marking=has_parking or draw.chance(0.4),
        wear=draw.uniform(0.1, 0.9),
        wetness=wetness,
    )
    return _Street(road, has_parking, draw.uniform(0.0, 1.0))


def _ahead(draw: Draw, journey: Journey, braking: Braking | None) -> list[VehicleSpec]:
    vehicles: list[VehicleSpec] = []
    gap_m = 0.0
    for number in range(draw.integer(1 if braking else 0, MAX_AHEAD - 1)):
        gap_m += draw.log_uniform(9.0, 40.0) + 5.0
        earlier = (braking or Braking(0.0, 0.0, 0.0)).delayed(-0.7 * number)
        timetable = slowed(START_M + gap_m, journey.speed_mps, journey.duration_s, earlier)
        spans = ((earlier.begin_s, earlier.end_s),) if braking else ()
        fields: dict[str, Any] = {"lane": "own", "lane_number": journey.lane_number, "brakes_s": spans}
        vehicles.append(drawn_vehicle(draw, drawn_kind(draw, TOWN), timetable, **fields))
        gap_m += 6.0
    return vehicles


def _oncoming(draw: Draw, journey: Journey, street: _Street) -> list[VehicleSpec]:
    vehicles: list[VehicleSpec] = []
    for lane in range(street.road.num_lanes):
        speed = draw.uniform(8.0, 14.0)
        span = (START_M + 15.0, START_M + (journey.speed_mps + speed) * journey.duration_s + 200.0)
        stream = Stream("oncoming", lane, span, speed, draw.log_uniform(20.0, 120.0), TOWN)
        vehicles += stream.drawn(draw)
    vehicles.sort(key=lambda vehicle: vehicle.timetable[0][1])
    return vehicles[:MAX_ONCOMING]


def _cyclists(draw: Draw, street: _Street) -> list[VehicleSpec]:
    """On the strip beside the lanes, where nobody parks and it is wide enough."""
    road = street.road
    if street.has_parking or road.shoulders_m[1] < 0.9:
        return []
    t = road.half_width_m - road.shoulders_m[1] * 0.55
    cyclists = []
    for _ in range(draw.integer(0, 3)):
        lane, at_m, speed = draw.choice(["own", "oncoming"]), draw.uniform(90.0, 260.0), draw.uniform(3.5, 7.0)
        sign = 1 if lane == "own" else -1
        timetable = ((0.0, at_m), (10.0, round(at_m + 10.0 * sign * speed, 2)))
        cyclists.append(drawn_vehicle(draw, "bicycle", timetable, lane=lane, lateral_m=round(-sign * t, 2)))
    return cyclists


def _parked(draw: Draw, street: _Street) -> list[VehicleSpec]:
    """Dark cars at the kerb, with gaps."""
    if not street.has_parking:
        return []
    cars: list[VehicleSpec] = []
    for lane in ("parked_left", "parked_right"):
        s_m = draw.uniform(20.0, 60.0)
        while s_m < street.road.length_m - 20.0 and draw.chance(0.93):
            timetable = ((0.0, round(s_m, 2)),)
            is_towards = lane == "parked_left"
            kind = drawn_kind(draw, PARKED)
            car = drawn_vehicle(draw, kind, timetable, lane=lane, is_towards=is_towards)
            cars.append(car.model_copy(update={"beam": "off"}))
            s_m += draw.choice([6.2, 7.0, 25.0, 60.0])
    # Those ahead of us in the first place: the others are passed before they are seen.
    return sorted(cars, key=lambda car: abs(car.timetable[0][1] - START_M - 60.0))[:MAX_PARKED]


def _surroundings(draw: Draw, street: _Street, end_m: float) -> SurroundingsSpec:
    houses: list[House] = []
    panels: list[Panel] = []
    for side in SIDES:
        s_m = draw.uniform(5.0, 15.0)
        depth_m = draw.uniform(2.7, 6.0)
        while s_m < street.road.length_m - 15.0:
            width = draw.uniform(9.0, 18.0)
            if draw.chance(0.88):
                houses.append(_house(draw, side, s_m + width / 2, width, depth_m, street.bustle))
            elif draw.chance(0.6):
                panels.append(_billboard(draw, side, s_m + width / 2))
            s_m += width + draw.choice([0.3, 0.3, 2.0, 8.0])
        panels += [_poster(draw, side, street.road.length_m) for _ in range(draw.integer(0, round(3 * street.bustle)))]
    return SurroundingsSpec(
        left=PAVED,
        right=PAVED,
        houses=tuple(houses),
        panels=tuple(panels),
        signals=_signals(draw, street, end_m),
        signs=_signs(draw, street.road.length_m),
        street_lamps=_lamps(draw, street),
        delineator_spacing_m=0.0,
    )


def _house(draw: Draw, side: Side, s_m: float, width_m: float, offset_m: float, bustle: float) -> House:
    height = draw.uniform(5.5, 8.0 + 7.0 * bustle)
    return House(
        side=side,
        s_m=round(s_m, 1),
        offset_m=offset_m,
        size_m=(width_m, draw.uniform(8.0, 11.0), height),
        num_lit_windows=draw.integer(0, round(width_m * height / 12.0)),
        has_panes=True,
        window_cd_m2=draw.log_uniform(*WINDOW_CD_M2),
        shop_cd_m2=draw.log_uniform(*SHOP_CD_M2) if draw.chance(0.05 + 0.5 * bustle) else 0.0,
    )


def _billboard(draw: Draw, side: Side, s_m: float) -> Panel:
    return Panel(
        side=side,
        s_m=round(s_m, 1),
        offset_m=draw.uniform(3.0, 5.0),
        height_m=draw.uniform(1.5, 3.0),
        screen_cd_m2=draw.log_uniform(*BILLBOARD_CD_M2),
        yaw_deg=draw.uniform(5.0, 25.0),
    )


def _poster(draw: Draw, side: Side, length_m: float) -> Panel:
    """A lit poster on the pavement, as at bus stops."""
    return Panel(
        side=side,
        s_m=round(draw.uniform(80.0, length_m - 10.0), 1),
        offset_m=0.5,
        height_m=0.5,
        size_m=(1.2, 1.75),
        screen_cd_m2=draw.log_uniform(*BILLBOARD_CD_M2),
        yaw_deg=draw.uniform(0.0, 10.0),
    )


def _signals(draw: Draw, street: _Street, end_m: float) -> tuple[Signal, ...]:
    """Signals at one or two crossings: green where we pass, of any colour beyond the end of our drive."""
    signals = []
    for _ in range(draw.choice([0, 1, 2], [0.35, 0.4, 0.25])):
        s_m = round(draw.uniform(110.0, end_m + 130.0), 1)
        lit = "green" if s_m < end_m + 25.0 else draw.choice(["red", "red", "amber", "green"])
        fields: dict[str, Any] = {"lit": lit, "intensity_cd": draw.log_uniform(*SIGNAL_CD)}
        signals.append(Signal(side="right", s_m=s_m, **fields))
        if draw.chance(0.6):
            arm_m = street.road.shoulders_m[1] + street.road.lane_width_m
            signals.append(Signal(side="right", s_m=s_m, offset_m=0.9, height_m=4.8, arm_m=arm_m, **fields))
        signals.append(Signal(side="left", s_m=s_m + 8.0, faces_oncoming=True, **fields))
    return tuple(signals)


def _signs(draw: Draw, length_m: float) -> tuple[Sign, ...]:
    signs = []
    for _ in range(draw.integer(1, 7)):
        is_back = draw.chance(0.35)
        signs.append(
            Sign(
                side="left" if is_back else "right",
                s_m=round(draw.uniform(60.0, length_m - 5.0), 1),
                kind=draw.choice(["round", "triangle", "rectangle"]),
                offset_m=0.5,
                height_m=draw.uniform(2.0, 2.4),
                size_m=draw.uniform(0.5, 0.75),
                faces_oncoming=is_back,
            )
        )
    return tuple(signs)


def _lamps(draw: Draw, street: _Street) -> tuple[StreetLamp, ...]:
    """A row on one side of a narrow street, on both of a wide or busy one."""
    is_wide = street.road.num_lanes > 1 or street.bustle > 0.7
    sides = SIDES if is_wide else (draw.choice(SIDES),)
    row = {
        "spacing_m": draw.uniform(24.0, 36.0),
        "height_m": draw.uniform(7.0, 9.5) if is_wide else draw.uniform(5.0, 7.0),
        "flux_lm": draw.log_uniform(4_000.0, 9_000.0) if is_wide else draw.log_uniform(2_500.0, 6_000.0),
        "offset_m": 0.6,
    }
    return tuple(lamp for side in sides for lamp in lamp_row(draw, side, (0.0, street.road.length_m), **row))
