"""Drawing vehicles in numbers: their kinds, their lamps, and the streams in which they drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.scene import VehicleKind, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import Profile, Span
from foreglow.lab.simulation.world.bodies import BODIES

Kinds: TypeAlias = dict[VehicleKind, float]
"""Kinds of vehicles with their shares."""

COUNTRY: Kinds = {"car": 0.72, "van": 0.1, "lorry": 0.06, "semitrailer": 0.07, "motorcycle": 0.05}
TOWN: Kinds = {"car": 0.78, "van": 0.12, "lorry": 0.06, "motorcycle": 0.04}
FAST_LANE: Kinds = {"car": 0.85, "van": 0.12, "motorcycle": 0.03}
SLOW_LANE: Kinds = {"car": 0.42, "van": 0.1, "lorry": 0.12, "semitrailer": 0.36}

STEP_S = 0.5
"""Step of time tables of vehicles that brake."""


@dataclass(frozen=True, slots=True)
class Braking:
    """A vehicle slows down.

    Attributes:
        begin_s: When its brakes come on.
        end_s: When they go off.
        rate_mps2: Deceleration.
    """

    begin_s: float
    end_s: float
    rate_mps2: float

    def delayed(self, by_s: float) -> Braking:
        """The same of a vehicle behind."""
        return Braking(round(self.begin_s + by_s, 2), round(self.end_s + by_s, 2), self.rate_mps2)


@dataclass(frozen=True, slots=True)
class Stream:
    """Vehicles that follow each other in a lane, all at one speed.

    Attributes:
        lane: Their direction.
        lane_number: Their lane, counted from the median.
        span_m: Where they are at the begin of the drive.
        speed_mps: Their speed.
        gap_m: Their median gap.
        kinds: What they are.
        high_share: Share of those that have their high beams on.
    """

    lane: Literal["oncoming", "own"]
    lane_number: int | None
    span_m: Span
    speed_mps: float
    gap_m: float
    kinds: Kinds
    high_share: float = 0.03

    def drawn(self, draw: Draw) -> list[VehicleSpec]:
        """Its vehicles, the first in the span first."""
        vehicles: list[VehicleSpec] = []
        sign = 1 if self.lane == "own" else -1
        s_m = self.span_m[0] + draw.uniform(0.0, self.gap_m)
        while s_m < self.span_m[1]:
            kind = drawn_kind(draw, self.kinds)
            middle_m = BODIES[kind].box_centre_m[0]
            s_m += BODIES[kind].size_m[0] / 2
            start_m = s_m - sign * middle_m
            timetable = steady(start_m, sign * self.speed_mps)
            lane: dict[str, Any] = {"lane": self.lane, "lane_number": self.lane_number}
            vehicles.append(drawn_vehicle(draw, kind, timetable, high_share=self.high_share, **lane))
            s_m += BODIES[kind].size_m[0] / 2 + draw.log_uniform(0.45 * self.gap_m, 2.2 * self.gap_m)
        return vehicles


def drawn_kind(draw: Draw, kinds: Kinds) -> VehicleKind:
    """One of `kinds`, by their shares."""
    return draw.choice(list(kinds), list(kinds.values()))


def drawn_vehicle(
    draw: Draw, kind: VehicleKind, timetable: Profile, *, high_share: float = 0.0, **fields: Any
) -> VehicleSpec:
    """A vehicle with lamps as people leave them: more or less bright, dirty, and out of aim."""
    return VehicleSpec(
        kind=kind,
        timetable=timetable,
        beam="high" if draw.chance(high_share) else "low",
        brightness=draw.log_uniform(0.6, 1.8),
        yaw_aim_deg=draw.normal(0.0, 0.5),
        pitch_aim_deg=draw.normal(0.0, 1.2 if kind == "bicycle" else 0.4),
        is_light=draw.chance(0.35),
        **fields,
    )


def steady(start_m: float, speed_mps: float) -> Profile:
    """The time table of a vehicle at constant speed, negative against the arc length."""
    return ((0.0, round(start_m, 2)), (10.0, round(start_m + 10.0 * speed_mps, 2)))


def slowed(start_m: float, speed_mps: float, duration_s: float, braking: Braking) -> Profile:
    """The time table of a vehicle that brakes, at the lowest to a crawl of 1 m/s."""
    times = np.arange(0.0, duration_s + 2.0, STEP_S / 10)
    speeds = speed_mps - braking.rate_mps2 * np.clip(times - braking.begin_s, 0.0, braking.end_s - braking.begin_s)
    speeds = np.maximum(speeds, min(speed_mps, 1.0))
    ways = start_m + np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2) * (STEP_S / 10)])
    return tuple(
        (round(float(time), 2), round(float(s_m), 2)) for time, s_m in zip(times[::10], ways[::10], strict=True)
    )
