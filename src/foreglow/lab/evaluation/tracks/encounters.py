"""The first vehicle of each sequence: when its light is annotated, when it is in sight, and when it is reported.

All times of a sequence count from its first image. Its first vehicle is the vehicle whose light is annotated first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from foreglow.datasets import CategoryConfig, LabelledSource
from foreglow.datasets.simulated import has_truth, read_truth
from foreglow.lab.evaluation.boxes.breakdown import SplitLabels

HUMAN_DELAY_S = 0.8
"""From the first annotated artifact to a human's report of the vehicle, on average (paper)."""

UNKNOWN_VEHICLE = "vehicle"
"""Kind of a vehicle about which nothing more is known."""


@dataclass(frozen=True, slots=True)
class Encounter:
    """The first vehicle of a sequence. Times are seconds from the sequence's first image; NaN for never.

    Attributes:
        sequence_id: The sequence.
        sequence: Its folder.
        scenario: Name of the simulator's scenario, such as `crest`; empty where unknown.
        vehicle_id: The vehicle (PVDN: oid).
        vehicle: Its kind: car, van, lorry, motorcycle; `vehicle` where unknown.
        light_s: Its first annotated artifact.
        sight_s: Its first annotated lamp.
        production_s: First report of the production system.
        duration_s: The sequence's last image.
    """

    sequence_id: int
    sequence: str
    scenario: str
    vehicle_id: int
    vehicle: str
    light_s: float
    sight_s: float
    production_s: float
    duration_s: float

    @property
    def is_occluded(self) -> bool:
        """Whether its light is annotated before its lamps, or its lamps are never annotated."""
        return not self.light_s >= self.sight_s

    @property
    def human_s(self) -> float:
        """When a human would report it, on average."""
        return self.light_s + HUMAN_DELAY_S


def read_encounters(
    dataset: LabelledSource, labels: SplitLabels, categories: CategoryConfig | None = None
) -> tuple[Encounter, ...]:
    """The first vehicle of every sequence of `dataset` with annotated light, in the order of sequences.

    Args:
        dataset: Images with labels.
        labels: Its labels, as `read_split_labels` gives them.
        categories: Which image category marks the production system's report, where the set is not simulated.

    Raises:
        ValueError: If the simulator's truth beside the labels is broken.
    """
    encounters = []
    for sequence in dataset.sequences:
        lights = sorted(
            (labels.time_s[image_id], light.vehicle_id, light.is_direct)
            for image_id in sequence.image_ids
            for light in labels.lights.get(image_id, ())
            if not light.is_rear
        )
        if not lights:
            continue
        light_s, vehicle_id, _ = lights[0]
        sights = (time_s for time_s, its_id, is_direct in lights if its_id == vehicle_id and is_direct)
        scenario, vehicle, production_s = vehicle_facts(dataset, sequence.id, vehicle_id, categories)
        encounters.append(
            Encounter(
                sequence_id=sequence.id,
                sequence=sequence.directory,
                scenario=scenario,
                vehicle_id=vehicle_id,
                vehicle=vehicle,
                light_s=light_s,
                sight_s=next(sights, math.nan),
                production_s=production_s,
                duration_s=(len(sequence.image_ids) - 1) / dataset.rate_hz,
            )
        )
    return tuple(encounters)


def vehicle_facts(
    dataset: LabelledSource, sequence_id: int, vehicle_id: int, categories: CategoryConfig | None = None
) -> tuple[str, str, float]:
    """Scenario, kind of the vehicle, and when the production system first reports a vehicle; see `Encounter`."""
    scenario, kind = "", UNKNOWN_VEHICLE
    if has_truth(dataset.root):
        truth = read_truth(dataset.root).sequence(sequence_id)
        vehicles = (vehicle for frame in truth.frames for vehicle in frame.vehicles)
        kind = next((vehicle.kind for vehicle in vehicles if vehicle.vehicle_id == vehicle_id), UNKNOWN_VEHICLE)
        reported = next((frame.image_id for frame in truth.frames if frame.is_production_detected), None)
        scenario = truth.scenario
    else:
        sequence = next(sequence for sequence in dataset.sequences if sequence.id == sequence_id)
        reported = dataset.first_with(sequence, (categories or CategoryConfig()).low_beam_trigger)
    return scenario, kind, math.nan if reported is None else dataset.time_s(reported)
