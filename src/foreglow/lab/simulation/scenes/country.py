"""Drawing traffic on two-lane roads: a queue of oncoming vehicles, vehicles ahead that brake, and cyclists."""

from __future__ import annotations

from foreglow.lab.simulation.scenes import courses
from foreglow.lab.simulation.scenes.assembly import Journey, assembled
from foreglow.lab.simulation.scenes.courses import Layout
from foreglow.lab.simulation.scenes.draw import Draw, draw_weather
from foreglow.lab.simulation.scenes.planning import Plan, plan_encounter, shifted
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.stream import (
    COUNTRY,
    SLOW_LANE,
    Braking,
    drawn_kind,
    drawn_vehicle,
    slowed,
    steady,
)
from foreglow.lab.simulation.world.bodies import BODIES

LAYOUTS: dict[Layout, float] = {
    courses.curve: 0.35,
    courses.straight: 0.25,
    courses.s_bend: 0.2,
    courses.crest: 0.1,
    courses.forest: 0.1,
}
"""Courses of the roads, with their shares."""

LONGEST_S = 11.5
CYCLE_LANE_M = (1.2, 1.6)
"""Narrowest and widest paved strip beside the lanes, on which people cycle."""


def queue(draw: Draw, name: str, seed: int) -> Scene:
    """Four to nine oncoming vehicles close behind each other, often behind a lorry."""
    weather, wetness = draw_weather(draw)
    plan = _plan(draw, wetness)
    vehicles, behind_m = [], 0.0
    for number in range(draw.integer(4, 9)):
        kind = drawn_kind(draw, SLOW_LANE if number == 0 else COUNTRY)
        vehicles.append(drawn_vehicle(draw, kind, shifted(plan.other, behind_m), high_share=0.03))
        behind_m += BODIES[kind].size_m[0] + draw.log_uniform(7.0, 35.0)
    journey = Journey(min(plan.meeting_s + draw.uniform(0.5, 2.5), LONGEST_S), *_motion(plan))
    if draw.chance(0.35):
        start_m = journey.start_m + draw.uniform(20.0, 70.0)
        kind = drawn_kind(draw, COUNTRY)
        vehicles.append(drawn_vehicle(draw, kind, steady(start_m, journey.speed_mps), lane="own"))
    road = plan.road.model_copy(update={"length_m": plan.road.length_m + float(round(behind_m))})
    return assembled(draw, (name, seed), journey, road, plan.surroundings, vehicles, weather)


def following(draw: Draw, name: str, seed: int) -> Scene:
    """One to three vehicles ahead of us, which brake and so do we; now and then oncoming ones."""
    weather, wetness = draw_weather(draw)
    plan = _plan(draw, wetness)
    start_m, speed = _motion(plan)
    braking = Braking(draw.uniform(1.5, 4.5), draw.uniform(5.0, 7.5), draw.uniform(1.0, 3.0))
    if draw.chance(0.3):
        braking = Braking(braking.begin_s, braking.begin_s, 0.0)  # not this time
    journey = Journey(draw.uniform(7.0, 10.0), start_m, speed, braking.delayed(0.9))
    vehicles: list[VehicleSpec] = []
    gap_m = 0.0
    for number in range(draw.integer(1, 3)):
        kind = drawn_kind(draw, COUNTRY)
        gap_m += draw.log_uniform(14.0, 45.0) + 5.0
        earlier = braking.delayed(-0.8 * number)
        spans = ((earlier.begin_s, earlier.end_s),) if earlier.end_s > earlier.begin_s else ()
        timetable = slowed(start_m + gap_m, speed, journey.duration_s, earlier)
        vehicles.append(drawn_vehicle(draw, kind, timetable, lane="own", brakes_s=spans))
        gap_m += BODIES[kind].size_m[0]
    for _ in range(draw.integer(0, 2)):
        timetable = shifted(plan.other, draw.uniform(0.0, 120.0))
        vehicles.append(drawn_vehicle(draw, drawn_kind(draw, COUNTRY), timetable, high_share=0.1))
    return assembled(draw, (name, seed), journey, plan.road, plan.surroundings, vehicles, weather)


def cyclists(draw: Draw, name: str, seed: int) -> Scene:
    """People on bicycles beside the lanes, some towards us, some in our direction; motorcycles and cars as well."""
    weather, wetness = draw_weather(draw)
    plan = _plan(draw, wetness)
    start_m, speed = _motion(plan)
    journey = Journey(draw.uniform(7.0, 9.5), start_m, min(speed, draw.uniform(9.0, 18.0)))
    strip_m = draw.uniform(*CYCLE_LANE_M)
    road = plan.road.model_copy(update={"shoulders_m": (0.0, strip_m), "has_edge_marking": True})
    vehicles = []
    for _ in range(draw.integer(1, 3)):
        at_m, slow = start_m + draw.uniform(25.0, 40.0 + 8.0 * journey.speed_mps), draw.uniform(3.5, 7.5)
        vehicles.append(_bicycle(draw, road, "own", at_m, slow))
    for _ in range(draw.integer(0, 2)):
        at_m, slow = start_m + draw.uniform(40.0, 60.0 + 12.0 * journey.speed_mps), draw.uniform(3.5, 7.5)
        vehicles.append(_bicycle(draw, road, "oncoming", at_m, slow))
    for _ in range(draw.integer(0, 2)):
        kind = draw.choice(["motorcycle", drawn_kind(draw, COUNTRY)])
        timetable = shifted(plan.other, draw.uniform(0.0, 100.0))
        vehicles.append(drawn_vehicle(draw, kind, timetable, high_share=0.1))
    return assembled(draw, (name, seed), journey, road, plan.surroundings, vehicles, weather)


def _bicycle(draw: Draw, road: RoadSpec, lane: str, at_m: float, speed_mps: float) -> VehicleSpec:
    sign = -1 if lane == "own" else 1
    beside_m = sign * (road.lane_width_m + road.shoulders_m[1] * draw.uniform(0.3, 0.6))
    timetable = steady(at_m, -sign * speed_mps)
    return drawn_vehicle(draw, "bicycle", timetable, lane=lane, lateral_m=round(beside_m, 2))


def _plan(draw: Draw, wetness: float) -> Plan:
    return plan_encounter(draw, draw.choice(list(LAYOUTS), list(LAYOUTS.values())), wetness)


def _motion(plan: Plan) -> tuple[float, float]:
    """Where we begin, and our speed."""
    (begin_s, begin_m), (end_s, end_m) = plan.ego
    return begin_m, round((end_m - begin_m) / (end_s - begin_s), 2)
