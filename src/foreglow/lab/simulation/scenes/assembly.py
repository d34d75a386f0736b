"""From a road, its surroundings and its traffic to a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from foreglow.lab.simulation.scenes.clearance import without_collisions
from foreglow.lab.simulation.scenes.conditions import draw_camera, draw_sensor
from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, Scene, VehicleSpec, WeatherSpec
from foreglow.lab.simulation.scenes.stream import Braking, slowed, steady
from foreglow.lab.simulation.scenes.surroundings import Profile, SurroundingsSpec


@dataclass(frozen=True, slots=True)
class Journey:
    """Our own drive.

    Attributes:
        duration_s: Its duration.
        start_m: Where it begins.
        speed_mps: Our speed.
        braking: When we slow down; None for never.
        lane_number: Our lane, counted from the median; None for the one at the edge.
    """

    duration_s: float
    start_m: float
    speed_mps: float
    braking: Braking | None = None
    lane_number: int | None = None

    @property
    def timetable(self) -> Profile:
        """The time table of our vehicle."""
        if self.braking is None:
            return steady(self.start_m, self.speed_mps)
        return slowed(self.start_m, self.speed_mps, self.duration_s, self.braking)


def assembled(
    draw: Draw,
    origin: tuple[str, int],
    journey: Journey,
    road: RoadSpec,
    surroundings: SurroundingsSpec,
    vehicles: Iterable[VehicleSpec],
    weather: WeatherSpec,
) -> Scene:
    """The scene called by the name and with the seed of `origin`; vehicles that would collide are left out."""
    ego = EgoSpec(
        timetable=journey.timetable,
        lane_number=journey.lane_number,
        brightness=draw.log_uniform(0.5, 1.25),
        yaw_aim_deg=draw.normal(0.0, 0.4),
        pitch_aim_deg=draw.normal(-0.1, 0.3),
        body_motion=draw.log_uniform(0.5, 2.0),
    )
    return Scene(
        name=origin[0],
        seed=origin[1],
        duration_s=round(journey.duration_s, 2),
        road=road,
        surroundings=surroundings,
        vehicles=without_collisions(vehicles, ego, road, journey.duration_s),
        ego=ego,
        weather=weather,
        camera=draw_camera(draw),
        sensor=draw_sensor(draw),
    )
