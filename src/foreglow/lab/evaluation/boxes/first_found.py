"""How long after a vehicle's first light the detector finds it, and how long before its first lamp."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from foreglow.files import fields_to_json
from foreglow.lab.evaluation.boxes.breakdown import LightMatches, SplitLabels
from foreglow.lab.evaluation.ratios import share


@dataclass(frozen=True, slots=True)
class FirstFound:
    """One vehicle of one sequence, seen by its front lamps' light.

    Times are seconds from the first image of the sequence; NaN where it never happens.

    Attributes:
        sequence_id: The sequence.
        vehicle_id: The vehicle.
        light_s: Its first labelled light, direct or not.
        found_s: First accepted box that holds a light of it.
        lamp_s: Its first labelled lamp.
        num_frames: Images of the sequence from its first light to the first such box; NaN where it is never found.
    """

    sequence_id: int
    vehicle_id: int
    light_s: float
    found_s: float
    lamp_s: float
    num_frames: float

    @property
    def delay_s(self) -> float:
        """From its first light to the first box that holds one; NaN where it is never found."""
        return self.found_s - self.light_s

    @property
    def lead_s(self) -> float:
        """From the first box that holds its light to its first lamp: positive if it is found before it is there."""
        return self.lamp_s - self.found_s

    def to_json(self) -> dict[str, Any]:
        """All fields and both times by name."""
        return fields_to_json(self, "delay_s", "lead_s")


def first_found(labels: SplitLabels, matched: LightMatches, threshold: float) -> tuple[FirstFound, ...]:
    """When each vehicle is found if boxes with a score above `threshold` are accepted, by sequence and vehicle.

    Light of rear lamps is left out: those vehicles are not oncoming. With a few frames a second, the times are no
    finer than the frames.
    """
    rows = [
        (light.sequence_id, light.vehicle_id, labels.time_s[light.image_id], light.is_direct, best > threshold, index)
        for light, best, index in zip(
            matched.lights, matched.best_scores.tolist(), matched.matches.image_of_point.tolist(), strict=True
        )
        if not light.is_rear
    ]
    rows.sort(key=lambda row: row[:3])
    found = []
    for (sequence_id, vehicle_id), group in itertools.groupby(rows, key=lambda row: row[:2]):
        lights = list(group)
        light_s, light_index = lights[0][2], lights[0][5]
        found_s, found_index = next(((row[2], float(row[5])) for row in lights if row[4]), (math.nan, math.nan))
        lamp_s = next((row[2] for row in lights if row[3]), math.nan)
        found.append(FirstFound(sequence_id, vehicle_id, light_s, found_s, lamp_s, found_index - light_index))
    return tuple(found)


def share_found_ahead(vehicles: Sequence[FirstFound]) -> float:
    """Of the vehicles whose light comes before their first lamp, the share found before it; NaN without any."""
    return share([vehicle.lead_s > 0 for vehicle in vehicles if vehicle.light_s < vehicle.lamp_s])
