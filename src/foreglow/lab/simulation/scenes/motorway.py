"""Drawing a motorway: lanes in either direction with a median, streams of traffic, lorries, and cars that overtake."""

from __future__ import annotations

from dataclasses import replace
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
    Bridge,
    Gantry,
    House,
    Profile,
    Rail,
    Settlement,
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

SIGHT_M = 900.0
"""Length of the road beyond the end of our drive: vehicles are seen up to 900 m away."""

MAX_ONCOMING, MAX_AHEAD = 26, 14
"""Vehicles of either direction."""

LIGHTS_UP_TO_M = 220.0
"""Distance beyond which only the lamps of vehicles count: what a near one lights costs as much as a lit wall."""

CARPETS = (0.4, 0.4, 0.4, 0.4, 0.55, 0.8)
"""Wide light of our low beam; most cars of ours have old lamps."""


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
    journey = replace(journey, carpet=draw.choice(CARPETS))
    vehicles = _ahead(draw, journey, road, braking if is_braking else None) + _oncoming(draw, journey, road)
    vehicles = [vehicle.model_copy(update={"lights_up_to_m": LIGHTS_UP_TO_M}) for vehicle in vehicles]
    return assembled(draw, (name, seed), journey, road, _surroundings(draw, road), vehicles, weather)


def _road(draw: Draw, length_m: float, wetness: float) -> RoadSpec:
    median: Literal["barrier", "rails"] = draw.choice(["barrier", "rails"], [0.7, 0.3])
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
        barrier_m=draw.choice([0.9, 1.15]),
        shoulders_m=(draw.uniform(0.7, 1.2), draw.uniform(1.5, 3.0)),
        curvature_per_m=_rounded(bends),
        elevation_m=_rounded(heights) if draw.chance(0.7) else ((0.0, 0.0),),
        superelevation=0.025,
        edge_line_m=draw.choice([0.15, 0.2, 0.3]),
        wear=draw.uniform(0.2, 0.9),
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
            span = (START_M - 45.0, START_M + 950.0)
            stream = Stream(
                "own", lane, span, speed, draw.log_uniform(80.0, 350.0), SLOW_LANE if is_slow else FAST_LANE
            )
            vehicles += stream.drawn(draw)
    return vehicles[:MAX_AHEAD]


def _oncoming(draw: Draw, journey: Journey, road: RoadSpec) -> list[VehicleSpec]:
    vehicles: list[VehicleSpec] = []
    density = draw.log_uniform(0.4, 1.7)
    for lane in range(road.num_lanes):
        is_slow = lane == road.num_lanes - 1
        speed = draw.uniform(22.0, 25.0) if is_slow else draw.uniform(27.0, 37.0)
        span = (START_M + 20.0, START_M + (journey.speed_mps + speed) * journey.duration_s + 800.0)
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
        if draw.chance(0.7 if side == "right" else 0.3):
            rails.append(Rail(side=side, span_m=span, offset_m=draw.uniform(0.4, 1.0)))
        if draw.chance(0.4):
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
        signs=(*_signs(draw, road), *_chevrons(draw, road)),
        gantries=_gantries(draw, road),
        bridges=(_bridge(draw, road),) if draw.chance(0.35) else (),
        settlements=_neighbours(draw, road, sides),
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
                kind="guide" if is_large else draw.choice(["round", "triangle", "rectangle"]),
                offset_m=draw.uniform(1.5, 3.0),
                height_m=draw.uniform(1.8, 2.5),
                size_m=draw.uniform(2.2, 4.0) if is_large else draw.uniform(0.75, 1.1),
                faces_oncoming=is_back,
            )
        )
    return tuple(signs)


def _chevrons(draw: Draw, road: RoadSpec) -> tuple[Sign, ...]:
    """Rows of chevrons along the outer side of half of the tighter bends."""
    s_m, curvature = max(road.curvature_per_m, key=lambda point: abs(point[1]))
    if abs(curvature) < 1 / 1500 or draw.chance(0.5):
        return ()
    is_left = curvature > 0
    spacing, first = draw.uniform(18.0, 36.0), s_m - draw.uniform(0.0, 100.0)
    fields: dict[str, Any] = {"offset_m": draw.uniform(1.2, 2.5), "size_m": draw.uniform(0.75, 1.2)}
    places = [round(first + number * spacing, 1) for number in range(draw.integer(5, 14))]
    return tuple(
        Sign(
            side="right" if is_left else "left",
            s_m=place,
            kind="chevron_left" if is_left else "chevron_right",
            height_m=1.2,
            **fields,
        )
        for place in places
        if 20.0 < place < road.length_m - 20.0
    )


def _gantries(draw: Draw, road: RoadSpec) -> tuple[Gantry, ...]:
    return tuple(
        Gantry(
            side="left" if draw.chance(0.3) else "right",
            s_m=round(draw.uniform(0.15, 0.95) * road.length_m, 1),
            height_m=draw.uniform(5.2, 6.2),
            signs_m=tuple(draw.uniform(2.0, 5.0) for _ in range(draw.integer(1, 3))),
        )
        for _ in range(draw.choice([0, 0, 1, 2]))
    )


def _bridge(draw: Draw, road: RoadSpec) -> Bridge:
    return Bridge(
        s_m=round(draw.uniform(0.25, 0.95) * road.length_m, 1),
        width_m=draw.uniform(5.0, 16.0),
        height_m=draw.uniform(4.8, 6.5),
    )


def _neighbours(draw: Draw, road: RoadSpec, sides: tuple[Side, Side]) -> tuple[Settlement, ...]:
    """Lamps of other roads and yards near by."""
    return tuple(
        Settlement(
            side=draw.choice(sides),
            s_m=round(draw.uniform(0.4, 1.4) * road.length_m, 1),
            offset_m=draw.log_uniform(60.0, 300.0),
            size_m=(draw.log_uniform(60.0, 500.0), draw.log_uniform(15.0, 120.0)),
            height_m=draw.log_uniform(5.0, 14.0),
            num_lamps=draw.integer(2, 9),
            intensity_cd=draw.log_uniform(15.0, 250.0),
        )
        for _ in range(draw.choice([0, 1, 2, 3]))
    )


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
        lamps = [lamp for side in sides for lamp in lamp_row(draw, side, (begin, road.length_m), **row)]
        return tuple(_uneven(draw, lamp) for lamp in lamps)
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


def _uneven(draw: Draw, lamp: StreetLamp) -> StreetLamp:
    """A lamp of a row as it is: not quite in line, and as bright as its age lets it be."""
    return lamp.model_copy(
        update={
            "s_m": round(lamp.s_m + draw.normal(0.0, 1.5), 1),
            "offset_m": lamp.offset_m + draw.uniform(0.0, 1.2),
            "height_m": lamp.height_m + draw.normal(0.0, 0.25),
            "intensity_cd": float(f"{lamp.intensity_cd * draw.log_uniform(0.5, 1.2):.5g}"),
        }
    )
