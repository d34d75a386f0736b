"""The experiment on the time benefit: one pass over a split, any number of trackers on the same detections."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, PipelineConfig, TrackerConfig
from foreglow.datasets import CategoryConfig, LabelledSource
from foreglow.lab.evaluation.boxes.breakdown import match_lights, read_split_labels
from foreglow.lab.evaluation.vehicles import Encounter, first_found, match_tracks, read_encounters
from foreglow.lab.studies.progress import Progress, counted
from foreglow.lab.studies.time_benefit.metrics import (
    FalseTracks,
    Method,
    detection_times_s,
    mean_delay_s,
    time_benefit,
)
from foreglow.pipeline import Pipeline
from foreglow.runs.predictions import Predictions
from foreglow.tracking import make_tracker
from foreglow.types import Tracks

TRACKERS: Mapping[str, TrackerConfig] = MappingProxyType(
    {
        "tracker, published code": PUBLISHED_TRACKER,
        "tracker, paper": TrackerConfig(),
        "tracker, ours": OUR_TRACKER,
    }
)
"""The trackers of the table, by name."""

CONFIGURED = "tracker, configured"
"""That of the configuration, where it is another one."""


def _ours(**changes: Any) -> TrackerConfig:
    return TrackerConfig(**(OUR_TRACKER.model_dump() | changes))


RULES: Mapping[str, Mapping[str, TrackerConfig]] = MappingProxyType(
    {
        "frames": {f"{hits} frames": _ours(confirmation="frames", min_hits=hits) for hits in range(1, 11)},
        "m_of_n": {
            f"{hits} of {window}": _ours(confirmation="m_of_n", min_hits=hits, num_looks=window)
            for hits, window in ((1, 1), (2, 3), (3, 4), (3, 5), (4, 6), (5, 7), (6, 9), (8, 12))
        },
        "evidence": {
            f"evidence {level:g}": _ours(
                confirmation="evidence",
                confirm_evidence=level,
                reject_evidence=min(level, OUR_TRACKER.reject_evidence),
            )
            for level in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
        },
    }
)
"""By rule of confirmation, its settings on the curve; all else is our tracker's."""

FIVE_FRAMES = "5 frames"
"""The paper's setting, on the curve of its rule."""


@dataclass(frozen=True, slots=True)
class TimeBenefitResults:
    """Everything that the report shows.

    Attributes:
        encounters: The first vehicle of each sequence with one.
        curves: By rule of confirmation, one row a setting.
    """

    name: str
    config: PipelineConfig
    encounters: tuple[Encounter, ...]
    num_sequences: int
    methods: tuple[Method, ...]
    curves: Mapping[str, tuple[Method, ...]]

    def method(self, name: str) -> Method:
        """The row called `name`."""
        return next(method for method in self.methods if method.benefit.name == name)

    def to_json(self) -> dict[str, Any]:
        """All figures by name, without the configuration."""
        names = ("name", "num_sequences", "encounters", "methods", "curves")
        return {name: getattr(self, name) for name in names}


def run_experiment(
    dataset: LabelledSource,
    config: PipelineConfig,
    categories: CategoryConfig | None = None,
    progress: Progress | None = None,
) -> TimeBenefitResults:
    """Runs the detector of `config` over `dataset` once, and all trackers on what it finds.

    Args:
        dataset: Images with labels.
        config: Detector and distance; its tracker has a row of its own where it is none of `TRACKERS`.
        categories: Which image category marks the production system's report, where the set is not simulated.
        progress: Called after each image.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one is broken, the configuration has no model, or no vehicle's light is annotated.
    """
    if config.classifier.model is None:
        raise ValueError("experiment time-benefit: classifier.model: expected one, the configuration has none")
    labels = read_split_labels(dataset)
    encounters = read_encounters(dataset, labels, categories)
    if not encounters:
        raise ValueError(f"{dataset.root}: expected a vehicle whose light is annotated, found none")
    trackers = dict(TRACKERS)
    if config.tracker.method != "none" and config.tracker not in trackers.values():
        trackers[CONFIGURED] = config.tracker
    settings = {name: tracker for curve in RULES.values() for name, tracker in curve.items()} | trackers
    predictions, tracks, km = _run(dataset, config, settings, progress)

    def method(name: str, detected_s: Sequence[float], false: FalseTracks | None = None) -> Method:
        return Method(time_benefit(name, encounters, detected_s), false, mean_delay_s(encounters, detected_s))

    def tracker_method(name: str) -> Method:
        quality = match_tracks(labels, tracks[name], predictions.boxes_xyxy_px)
        found = [vehicle for sequence in quality for vehicle in sequence.vehicles]
        return method(name, detection_times_s(encounters, found), FalseTracks.of(quality, km))

    singles = first_found(labels, match_lights(labels, predictions), config.classifier.score_threshold)
    return TimeBenefitResults(
        name=dataset.name,
        config=config,
        encounters=encounters,
        num_sequences=len(dataset.sequences),
        methods=(
            method("single frame", detection_times_s(encounters, singles)),
            *(tracker_method(name) for name in trackers),
            method("human", [encounter.human_s for encounter in encounters]),
            method("first lamp in sight", [encounter.sight_s for encounter in encounters]),
            method("production system", [encounter.production_s for encounter in encounters]),
        ),
        curves={rule: tuple(tracker_method(name) for name in curve) for rule, curve in RULES.items()},
    )


def _run(
    dataset: LabelledSource, config: PipelineConfig, settings: Mapping[str, TrackerConfig], progress: Progress | None
) -> tuple[Predictions, Mapping[str, Mapping[int, Tracks]], float]:
    """Detections, what each tracker makes of them by name and image id, and the kilometres driven."""
    pipeline = Pipeline(config.model_copy(update={"tracker": TrackerConfig(method="none")}))
    trackers = {name: make_tracker(setting) for name, setting in settings.items()}
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    tracks: dict[str, dict[int, Tracks]] = {name: {} for name in trackers}
    km = 0.0
    images = counted(dataset, "images", len(dataset), progress)
    for _, frames in itertools.groupby(images, key=lambda frame: frame.sequence):
        pipeline.reset()
        for tracker in trackers.values():
            tracker.reset()
        for frame in frames:
            result = pipeline.step(frame)
            assert result.detections is not None
            boxes[frame.frame] = result.detections.boxes_xyxy_px.astype(np.float64)
            scores[frame.frame] = result.detections.scores.astype(np.float64)
            for name, tracker in trackers.items():
                tracks[name][frame.frame] = tracker.update(frame, result.detections, result.ranges)
            km += (math.nan if frame.motion is None else frame.motion.speed_mps) / dataset.rate_hz / 1000.0
    return Predictions(boxes, scores), tracks, km
