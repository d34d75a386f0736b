"""Where and when hidden vehicles are expected to come into sight, and where and when they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from foreglow.beam import Occurrence
from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import PipelineConfig
from foreglow.datasets import PVDN
from foreglow.datasets.simulated import FrameTruth, VehicleTruth, read_truth
from foreglow.geometry import Pose
from foreglow.lab.studies.occurrence.metrics import Sighting
from foreglow.photometry import read_headlamps
from foreglow.pipeline import Pipeline

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the step, how much of it is done, and how much there is."""

LEADS_S = (2.0, 1.0, 0.5)
"""Before direct sight, when expectations are scored."""

MIN_VISIBLE = 0.2
"""Share of a lamp's disc that is seen at first sight, as in the labels' rule."""


class Moment(NamedTuple):
    """What is known of one image, as far as it matters here.

    Attributes:
        time_s: Since the drive began.
        ego_pose: world_from_vehicle.
        vehicles: The other vehicles.
    """

    time_s: float
    ego_pose: Pose
    vehicles: tuple[VehicleTruth, ...]

    @classmethod
    def of(cls, known: FrameTruth) -> Moment:
        """That of a frame as it is driven, or as it was written down."""
        return cls(known.timestamp_ns / 1e9, known.ego_pose, known.vehicles)


class Expectations:
    """What was expected in one frame after another of a drive."""

    def __init__(self, coverage: float) -> None:
        """Takes the share of the probability that a gap covers."""
        self._shares = (0.5 * (1.0 - coverage), 0.5 * (1.0 + coverage))
        self._rows: list[tuple[float, float, float, float]] = []

    def note(self, expected: Occurrence | None) -> None:
        """Takes note of the next frame's expectation."""
        if expected is None:
            self._rows.append((math.nan, math.nan, math.nan, math.nan))
        else:
            right, left = expected.quantiles_rad(self._shares)
            self._rows.append((expected.azimuth_rad, expected.time_s, right, left))

    def sightings(self, moments: Sequence[Moment], rate_hz: float) -> tuple[Sighting, ...]:
        """For every vehicle that was hidden and came into sight, what was expected before.

        Args:
            moments: Of the frames that were noted.
            rate_hz: Frames a second.
        """
        times_s = np.array([moment.time_s for moment in moments])
        found = []
        for vehicle_id, azimuth_rad, sight_s in first_sights(moments):
            for lead_s in LEADS_S:
                place = int(np.argmin(np.abs(times_s - (sight_s - lead_s))))
                if abs(times_s[place] - (sight_s - lead_s)) <= 0.5 / rate_hz:
                    expected_rad, expected_s, right_rad, left_rad = self._rows[place]
                    found.append(
                        Sighting(
                            vehicle_id=vehicle_id,
                            lead_s=lead_s,
                            error_deg=abs(math.degrees(expected_rad - azimuth_rad)),
                            error_s=abs(expected_s - lead_s),
                            width_deg=math.degrees(left_rad - right_rad),
                            is_covered=right_rad <= azimuth_rad <= left_rad,
                        )
                    )
        return tuple(found)


def first_sights(moments: Sequence[Moment]) -> Iterator[tuple[int, float, float]]:
    """Oncoming vehicles that were hidden at first: id, direction (rad, in our frame) and time of first direct sight."""
    seen: set[int] = set()
    for place, moment in enumerate(moments):
        for vehicle in moment.vehicles:
            lamps = [one for one in vehicle.lamps if not one.is_rear and one.visible_share >= MIN_VISIBLE]
            if lamps and vehicle.vehicle_id not in seen:
                seen.add(vehicle.vehicle_id)
                if place > 0 and is_coming(moment.ego_pose, vehicle):
                    middle = np.mean([one.position_world_m for one in lamps], axis=0)
                    x, y, _ = moment.ego_pose.to_body(middle).tolist()
                    yield vehicle.vehicle_id, math.atan2(y, x), moment.time_s


def is_coming(ego_pose: Pose, vehicle: VehicleTruth) -> bool:
    """Whether a vehicle drives against our direction, more or less; one that crosses counts as coming, too."""
    return float(ego_pose.rotation[:, 0] @ vehicle.pose.rotation[:, 0]) < 0.3


def run_experiment(split: Path, config: PipelineConfig, progress: Progress | None = None) -> tuple[Sighting, ...]:
    """What our policy expects on a simulated split, as it was rendered: the beam changes nothing in its images.

    Args:
        split: Folder of the split.
        config: The pipeline; of its beam stage the parameters of our policy are used.
        progress: Told of each image.

    Raises:
        FileNotFoundError: If an image, a label file or the simulator's truth is missing.
        ValueError: If one is broken.
    """
    dataset, truth = PVDN(split), read_truth(split)
    pipeline = Pipeline(config)
    policy = ForeglowPolicy(config.beam, read_headlamps(config.beam.headlamps))
    expected: dict[str, Expectations] = {}
    for place, frame in enumerate(dataset):
        if frame.sequence not in expected:
            pipeline.reset()
            policy.reset()
            expected[frame.sequence] = Expectations(config.beam.coverage)
        tracks = pipeline.step(frame).tracks
        assert tracks is not None
        policy.gaps(frame, tracks)
        expected[frame.sequence].note(policy.expected)
        if progress is not None:
            progress("images", place + 1, len(dataset))
    found: list[Sighting] = []
    for sequence in truth:
        if sequence.directory in expected:
            moments = [Moment.of(one) for one in sequence.frames]
            found += expected[sequence.directory].sightings(moments, truth.info.rate_hz)
    return tuple(found)
