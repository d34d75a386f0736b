"""Drawing what UN R48 asks of a camera: a straight level road, an oncoming vehicle far away, and one ahead."""

from __future__ import annotations

from foreglow.lab.simulation.scenes.assembly import Journey, assembled
from foreglow.lab.simulation.scenes.conditions import draw_weather
from foreglow.lab.simulation.scenes.courses import Course
from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.planning import draw_road
from foreglow.lab.simulation.scenes.roadside import draw_surroundings
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.scenes.stream import COUNTRY, drawn_kind, drawn_vehicle, steady

DURATION_S = 14.0
LENGTH_M = 800.0


def level_road(draw: Draw, name: str, seed: int) -> Scene:
    """One vehicle comes from 600 m until we meet, and one ahead draws away from 25 m to 190 m; any weather alike."""
    weather, wetness = draw_weather(draw, is_even=True)
    journey = Journey(DURATION_S, draw.uniform(10.0, 25.0), draw.uniform(14.0, 17.0))
    course = Course(draw.choice(["open", "forest"]))
    oncoming_mps, ahead_mps = draw.uniform(26.0, 29.0), journey.speed_mps + draw.uniform(11.0, 13.0)
    vehicles = (
        drawn_vehicle(draw, drawn_kind(draw, COUNTRY), steady(journey.start_m + 620.0, -oncoming_mps)),
        drawn_vehicle(draw, drawn_kind(draw, COUNTRY), steady(journey.start_m + 30.0, ahead_mps), lane="own"),
    )
    road = draw_road(draw, course, LENGTH_M, wetness)
    surroundings = draw_surroundings(draw, course.style, LENGTH_M, course.bends)
    return assembled(draw, (name, seed), journey, road, surroundings, vehicles, weather)
