"""Where and when hidden vehicles are expected to come into sight, and where and when they do."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import PipelineConfig
from foreglow.datasets import open_labelled
from foreglow.datasets.simulated import read_truth
from foreglow.lab.evaluation.occurrence import NEAR_DEG, Expectations, LeadScore, Moment, Sighting, lead_scores
from foreglow.lab.reports.page import Table, number, percent
from foreglow.lab.studies.progress import Progress, counted
from foreglow.photometry import read_headlamps
from foreglow.pipeline import Pipeline


def run_experiment(split: Path, config: PipelineConfig, progress: Progress | None = None) -> tuple[Sighting, ...]:
    """What our policy expects on a simulated split, as it was rendered: the beam changes nothing in its images.

    Raises:
        FileNotFoundError: If an image, a label file or the simulator's truth is missing.
        ValueError: If one is broken, or the configuration has no model or no tracker.
    """
    config = config.commanding()
    dataset, truth = open_labelled(split), read_truth(split)
    pipeline = Pipeline(config)
    policy = ForeglowPolicy(config.beam, read_headlamps(config.beam.headlamps))
    expected: dict[str, Expectations] = {}
    images = counted(dataset, "images", len(dataset), progress)
    for sequence, frames in itertools.groupby(images, key=lambda frame: frame.sequence):
        policy.reset()
        expected[sequence] = Expectations(config.beam.coverage)
        for frame in frames:
            tracks = pipeline.step(frame).tracks
            assert tracks is not None
            policy.gaps(frame, tracks)
            expected[sequence].add(policy.expected)
    return tuple(
        sighting
        for drive in truth
        if drive.directory in expected
        for sighting in expected[drive.directory].sightings(
            [Moment(frame.timestamp_ns / 1e9, frame.ego_pose, frame.vehicles) for frame in drive.frames],
            truth.info.rate_hz,
        )
    )


def report_lines(sightings: Sequence[Sighting]) -> list[str]:
    """A remark, a table in Markdown, and what the paper says of it."""
    if not sightings:
        return ["No vehicle comes into sight after it was hidden."]
    return [REMARK, occurrence_table(lead_scores(sightings)).markdown(), PAPERS]


PAPERS = "The paper has no value beside these: where a vehicle appears is among what it leaves open."


REMARK = (
    "Where a vehicle comes into sight, told from its light and the road; errors of those of which something was told "
    "at that time."
)


def occurrence_table(leads: Sequence[LeadScore]) -> Table:
    """A row for each lead."""
    columns: dict[str, Callable[[LeadScore], object]] = {
        "before direct sight": lambda lead: f"{lead.lead_s:g} s",
        "hidden vehicles": lambda lead: lead.num,
        "told": lambda lead: lead.num_told,
        "median error": lambda lead: f"{number(lead.median_deg)} deg",
        f"within {NEAR_DEG:g} deg": lambda lead: percent(lead.near_share),
        "held by the gap": lambda lead: percent(lead.covered_share),
        "its median width": lambda lead: f"{number(lead.width_deg, 1)} deg",
        "median error of the time": lambda lead: f"{number(lead.median_s)} s",
    }
    return Table.of(columns, leads)
