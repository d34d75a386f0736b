"""Drawing a motorway: lanes in either direction with a median, streams of traffic, lorries, and cars that overtake."""

from __future__ import annotations

from typing import Any, Literal

from foreglow.lab.simulation.scenes.assembly import Journey, assembled
from foreglow.lab.simulation.scenes.draw import Draw, draw_weather
from foreglow.lab.simulation.scenes.roadside import lamp_row
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.stream import (
    FAST_LANE,
    SLOW_LANE,
    Braking,
    Stream,
    drawn_kind,
    drawn_vehicle,
    slowed,
    steady,
)
from foreglow.lab.simulation.scenes.surroundings import (
    House,
    Profile,
    Rail,
    Side,
    Sign,
    Span,
    StreetLamp,
    SurroundingsSpec,
    Verge,
    Wall,
    Woods,
)

START_M = 110.0
"""Where we are at the begin; others come from behind."""

SIGHT_M = 700.0
"""Length of the road beyond the end of our drive; further lamps are specks."""

MAX_ONCOMING, MAX_AHEAD = 14, 8
"""Vehicles of either direction; each costs as much as a lit wall."""


def motorway(draw: Draw, name: str, seed: int) -> Scene:
    """A drive along a motorway with two to four lanes in either direction, by day-to-day traffic or little of it."""
    weather, wetness = draw_weather(draw)
    duration_s, ego_mps = draw.uniform(7.0, 10.0), draw.uniform(21.0, 36.0)
    length_m = float(round(START_M + ego_mps * duration_s + SIGHT_M))
    road = _road(draw, length_m, wetness)
    lane = draw.integer(0, road.num_lanes - 1)
    braking = Braking(draw.uniform(1.5, 4.0), draw.uniform(4.5, 7.0), draw.uniform(1.0, 2.5))
    is_braking = draw.chance(0.35)
    journey = Journey(duration_s, START_M, ego_mps, braking.delayed(0.9) if is_braking else None, lane)
    vehicles = _ahead(draw, journey, road, braking if is_braking else None) + _oncoming(draw, journey, road)
    return assembled(draw, (name, seed), journey, road, _surroundings(draw, road), vehicles, weather)


def _road(draw: Draw, length_m: float, wetness: float) -> RoadSpec:
    median: Literal["barrier", "rails"] = draw.choice(["barrier", "rails"], [0.6, 0.4])
    bends: list[tuple[float, float]] = [(0.0, 0.0)]
    if draw.chance(0.6):
        start, length = draw.uniform(0.0, 0.6) * length_m, draw.uniform(250.0, 600.0)
        bend = draw.choice([-1, 1]) / draw.log_uniform(500.0, 3000.0)
        bends += [(start + 1.0, 0.0), (start + 120.0, bend), (start + length, bend), (start + length + 120.0, 0.0)]
    heights = [(0.0, 0.0), *((share * length_m, draw.uniform(-6.0, 6.0)) for share in (0.3, 0.6, 1.0))]
    return RoadSpec(
        length_m=length_m,
        lane_width_m=draw.uniform(3.4, 3.75),
        num_lanes=draw.choice([2, 3, 4], [0.55, 0.35, 0.1]),
        median=median,
        median_m=draw.uniform(1.4, 2.5) if median == "barrier" else draw.uniform(2.5, 4.0),
        shoulders_m=(draw.uniform(0.7, 1.2), draw.uniform(1.5, 3.0)),
        curvature_per_m=_rounded(bends),
        elevation_m=_rounded(heights) if draw.chance(0.7) else ((0.0, 0.0),),
        superelevation=0.025,
        wear=draw.uniform(0.0, 0.6),
        wetness=wetness,
    )


def _rounded(points: list[tuple[float, float]]) -> Profile:
    return tuple((round(s_m, 1), float(f"{value:.5g}")) for s_m, value in points)


def _ahead(draw: Draw, journey: Journey, road: RoadSpec, braking: Braking | None) -> list[VehicleSpec]:
    """Vehicles in our direction: those that brake ahead of us, one that overtakes, and the other lanes."""
    vehicles: list[VehicleSpec] = []
    own: dict[str, Any] = {"lane": "own", "lane_number": journey.lane_number}
    kinds = SLOW_LANE if journey.lane_number == road.num_lanes - 1 else FAST_LANE
    gap_m = 0.0
    for number in range(draw.integer(1, 3) if braking else draw.integer(0, 2)):
        gap_m += draw.log_uniform(22.0, 80.0) + 8.0
        start_m = round(START_M + gap_m, 2)
        timetable = steady(start_m, journey.speed_mps)
        spans: tuple[Span, ...] = ()
        if braking:
            earlier = braking.delayed(-0.8 * number)
            timetable = slowed(start_m, journey.speed_mps, journey.duration_s, earlier)
            spans = ((earlier.begin_s, earlier.end_s),)
        vehicles.append(drawn_vehicle(draw, drawn_kind(draw, kinds), timetable, brakes_s=spans, **own))
        gap_m += 10.0
    if journey.lane_number and draw.chance(0.5):  # overtakes us in the lane next to ours
        start_m, faster = START_M - draw.uniform(12.0, 50.0), draw.uniform(4.0, 10.0)
        other: dict[str, Any] = {"lane": "own", "lane_number": (journey.lane_number or 0) - 1}
        timetable = steady(start_m, journey.speed_mps + faster)
        vehicles.append(drawn_vehicle(draw, drawn_kind(draw, FAST_LANE), timetable, **other))
    for lane in range(road.num_lanes):
        if lane != journey.lane_number:
            is_slow = lane == road.num_lanes - 1
            speed = draw.uniform(22.0, 25.0) if is_slow else journey.speed_mps + draw.uniform(-3.0, 6.0)
            span = (START_M - 45.0, START_M + 350.0)
            stream = Stream(
                "own", lane, span, speed, draw.log_uniform(60.0, 250.0), SLOW_LANE if is_slow else FAST_LANE
            )
            vehicles += stream.drawn(draw)
    return vehicles[:MAX_AHEAD]


def _oncoming(draw: Draw, journey: Journey, road: RoadSpec) -> list[VehicleSpec]:
    vehicles: list[VehicleSpec] = []
    density = draw.log_uniform(0.4, 2.0)
    for lane in range(road.num_lanes):
        is_slow = lane == road.num_lanes - 1
        speed = draw.uniform(22.0, 25.0) if is_slow else draw.uniform(27.0, 37.0)
        span = (START_M + 20.0, START_M + (journey.speed_mps + speed) * journey.duration_s + 350.0)
        stream = Stream("oncoming", lane, span, speed, 110.0 / density, SLOW_LANE if is_slow else FAST_LANE)
        vehicles += stream.drawn(draw)
    # The nearest ones first: those at the end of the road may be left out.
    vehicles.sort(key=lambda vehicle: vehicle.timetable[0][1])
    return vehicles[:MAX_ONCOMING]


def _surroundings(draw: Draw, road: RoadSpec) -> SurroundingsSpec:
    sides: tuple[Side, Side] = ("left", "right")
    span = (2.0, road.length_m - 2.0)
    walls, rails, woods = [], [], []
    for side in sides:
        has_wall = draw.chance(0.2)
        if has_wall:
            begin = draw.uniform(0.0, 0.5) * road.length_m + 2.0
            end = min(begin + draw.uniform(150.0, 600.0), road.length_m - 2.0)
            walls.append(Wall(side=side, span_m=(begin, end), offset_m=2.2, height_m=draw.uniform(2.5, 4.5)))
        if draw.chance(0.75):
            rails.append(Rail(side=side, span_m=span, offset_m=draw.uniform(0.4, 1.0)))
        if draw.chance(0.35):
            begin = draw.uniform(0.0, 0.5) * road.length_m
            wood: dict[str, Any] = {
                "offset_m": draw.uniform(8.0, 15.0),
                "depth_m": draw.uniform(0.0, 10.0),
                "spacing_m": 7.0,
            }
            woods.append(Woods(side=side, span_m=(begin, begin + draw.uniform(100.0, 400.0)), **wood))
    verges = [
        Verge(
            bank_m=draw.uniform(-2.0, 4.0),
            bank_offset_m=draw.uniform(3.0, 6.0),
            grass_height_m=draw.uniform(0.06, 0.2),
            grass_per_m2=draw.choice([0.0, 3.0, 8.0]),
        )
        for _ in sides
    ]
    return SurroundingsSpec(
        left=verges[0],
        right=verges[1],
        rails=tuple(rails),
        walls=tuple(walls),
        woods=tuple(woods),
        signs=_signs(draw, road),
        houses=tuple(_house(draw, draw.choice(sides), road) for _ in range(draw.choice([0, 0, 2, 5]))),
        street_lamps=_lamps(draw, road, sides),
        delineator_spacing_m=50.0,
        num_bushes=draw.choice([0, 20, 60]),
    )


def _signs(draw: Draw, road: RoadSpec) -> tuple[Sign, ...]:
    """Guide signs as large as doors, speed limits, and their backs on the other side."""
    signs = []
    for _ in range(draw.integer(1, 6)):
        is_large, is_back = draw.chance(0.4), draw.chance(0.3)
        signs.append(
            Sign(
                side="left" if is_back else "right",
                s_m=round(draw.uniform(60.0, road.length_m - 20.0), 1),
                kind="rectangle" if is_large else draw.choice(["round", "triangle", "rectangle"]),
                offset_m=draw.uniform(1.5, 3.0),
                height_m=draw.uniform(1.8, 2.5),
                size_m=draw.uniform(2.2, 4.0) if is_large else draw.uniform(0.75, 1.1),
                faces_oncoming=is_back,
            )
        )
    return tuple(signs)


def _house(draw: Draw, side: Side, road: RoadSpec) -> House:
    return House(
        side=side,
        s_m=round(draw.uniform(0.15, 0.95) * road.length_m, 1),
        offset_m=draw.uniform(25.0, 55.0),
        size_m=(draw.uniform(10.0, 30.0), draw.uniform(8.0, 11.0), draw.uniform(4.0, 9.0)),
        num_lit_windows=draw.integer(0, 10),
        has_panes=True,
        window_cd_m2=draw.log_uniform(5.0, 80.0),
        yaw_deg=draw.normal(0.0, 15.0),
    )


def _lamps(draw: Draw, road: RoadSpec, sides: tuple[Side, Side]) -> tuple[StreetLamp, ...]:
    """One motorway in four is lit, along a part of it; many others have lamps of other roads near by."""
    if draw.chance(0.25):
        height, flux = draw.uniform(10.0, 12.0), draw.log_uniform(14_000.0, 28_000.0)
        begin = draw.choice([0.0, 0.0, 0.5]) * road.length_m
        row = {"spacing_m": draw.uniform(36.0, 48.0), "height_m": height, "flux_lm": flux, "offset_m": 1.8}
        return tuple(lamp for side in sides for lamp in lamp_row(draw, side, (begin, road.length_m), **row))
    lamps = [
        StreetLamp(
            side=draw.choice(sides),
            s_m=round(draw.uniform(0.1, 1.0) * road.length_m, 1),
            offset_m=draw.uniform(15.0, 60.0),
            height_m=draw.uniform(5.0, 10.0),
            intensity_cd=draw.log_uniform(400.0, 2500.0),
        )
        for _ in range(draw.choice([0, 0, 3, 8]))
    ]
    return tuple(lamps)
