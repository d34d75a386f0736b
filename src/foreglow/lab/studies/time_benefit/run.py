"""The experiment on the time benefit: one pass over the images, any number of trackers on the same detections."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, PipelineConfig, TrackerConfig
from foreglow.datasets import CategoryConfig, ImageCategory, LabelledSource
from foreglow.lab.evaluation.boxes.breakdown import match_lights, read_split_labels
from foreglow.lab.evaluation.boxes.lights import unsaid
from foreglow.lab.evaluation.vehicles import (
    HUMAN_DELAY_S,
    Encounter,
    SequenceTracks,
    first_found,
    match_tracks,
    read_encounters,
)
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

TRACKER_ROWS: Mapping[str, TrackerConfig] = MappingProxyType(
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


LEAST_RATE_HZ = 4 / HUMAN_DELAY_S
"""Below this rate the paper's tracker, which waits for five frames, cannot be earlier than a human."""

SINGLE_FRAME = "single frame"

PAPER_SINGLE_FRAME, PAPER_CHAIN = "single frame, paper's whole chain", "tracker, paper's whole chain"


@dataclass(frozen=True, slots=True)
class TimeBenefitResults:
    """Everything that the report shows.

    Attributes:
        name: Of the split, or of all splits.
        rates_hz: Frames a second, of each split.
        encounters: The first vehicle of each sequence with one.
        curves: By rule of confirmation, one row a setting.
        categories: By the name of an image category, when the first image in it was taken, one time an encounter, in
            their order; NaN for never. Categories without any image are left out.
        notes: What the labels do not say, a line each; see `unsaid`.
    """

    name: str
    rates_hz: tuple[float, ...]
    config: PipelineConfig
    encounters: tuple[Encounter, ...]
    num_sequences: int
    methods: tuple[Method, ...]
    curves: Mapping[str, tuple[Method, ...]]
    categories: Mapping[str, tuple[float, ...]]
    notes: tuple[str, ...] = ()

    @property
    def num_begun(self) -> int:
        """Encounters whose light is there in the first image, so that times after it are too short."""
        return sum(encounter.is_begun for encounter in self.encounters)

    def method(self, name: str) -> Method:
        """The row called `name`."""
        return next(method for method in self.methods if method.benefit.name == name)

    def to_json(self) -> dict[str, Any]:
        """All figures by name, without the configuration."""
        names = (
            "name",
            "rates_hz",
            "num_sequences",
            "encounters",
            "num_begun",
            "methods",
            "curves",
            "categories",
            "notes",
        )
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, slots=True)
class _Split:
    """What was measured on one split.

    Attributes:
        detected_s: By method, one time an encounter.
        tracks: By tracker, what its tracks are worth.
    """

    name: str
    encounters: tuple[Encounter, ...]
    num_sequences: int
    detected_s: Mapping[str, tuple[float, ...]]
    tracks: Mapping[str, tuple[SequenceTracks, ...]]
    km: float
    categories: Mapping[str, tuple[float, ...]]
    notes: tuple[str, ...]


def run_experiment(
    datasets: Sequence[LabelledSource],
    config: PipelineConfig,
    categories: CategoryConfig | None = None,
    progress: Progress | None = None,
    paper: PipelineConfig | None = None,
) -> TimeBenefitResults:
    """Runs the detector of `config` over `datasets` once, and all trackers on what it finds.

    Args:
        datasets: Splits with labels; their sequences are pooled.
        config: Detector and distance; its tracker has a row of its own where it is none of `TRACKER_ROWS`.
        categories: Which image category marks the production system's report, where the set is not simulated.
        progress: Called after each image.
        paper: The paper's whole chain, whose detector and tracker have rows of their own; None for none.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one is broken, the configuration has no model, or no vehicle's light is annotated.
    """
    if config.classifier.model is None:
        raise ValueError("experiment time-benefit: classifier.model: expected one, the configuration has none")
    trackers = dict(TRACKER_ROWS)
    if config.tracker.method != "none" and config.tracker not in trackers.values():
        trackers[CONFIGURED] = config.tracker
    settings = {name: tracker for curve in RULES.values() for name, tracker in curve.items()} | trackers
    chains = {SINGLE_FRAME: (config, settings)}
    if paper is not None:
        chains[PAPER_SINGLE_FRAME] = (paper, {PAPER_CHAIN: paper.tracker})
    splits = [_measure(dataset, chains, categories, progress) for dataset in datasets]
    encounters = tuple(
        dataclasses.replace(met, sequence=f"{split.name}/{met.sequence}") if len(splits) > 1 else met
        for split in splits
        for met in split.encounters
    )
    if not encounters:
        roots = ", ".join(str(dataset.root) for dataset in datasets)
        raise ValueError(f"{roots}: expected a vehicle whose light is annotated, found none")
    km = sum(split.km for split in splits)

    def pooled(name: str) -> list[float]:
        return [time_s for split in splits for time_s in split.detected_s[name]]

    def method(
        name: str, detected_s: Sequence[float], false: FalseTracks | None = None, plausibility_s: tuple[float, ...] = ()
    ) -> Method:
        benefit = time_benefit(name, encounters, detected_s)
        return Method(benefit, false, mean_delay_s(encounters, detected_s), plausibility_s)

    def tracker_method(name: str, single: str = SINGLE_FRAME) -> Method:
        tracks = [sequence for split in splits for sequence in split.tracks[name]]
        waits_s = np.subtract(pooled(name), pooled(single))
        return method(name, pooled(name), FalseTracks.of(tracks, km), tuple(waits_s[~np.isnan(waits_s)].tolist()))

    papers: list[Method] = []
    if paper is not None:
        papers = [
            method(PAPER_SINGLE_FRAME, pooled(PAPER_SINGLE_FRAME)),
            tracker_method(PAPER_CHAIN, PAPER_SINGLE_FRAME),
        ]
    return TimeBenefitResults(
        name=" and ".join(split.name for split in splits),
        rates_hz=tuple(dataset.mean_rate_hz for dataset in datasets),
        config=config,
        encounters=encounters,
        num_sequences=sum(split.num_sequences for split in splits),
        methods=(
            method(SINGLE_FRAME, pooled(SINGLE_FRAME)),
            *(tracker_method(name) for name in trackers),
            *papers,
            method("human", [encounter.human_s for encounter in encounters]),
            method("first lamp in sight", [encounter.sight_s for encounter in encounters]),
            method("production system", [encounter.production_s for encounter in encounters]),
        ),
        curves={rule: tuple(tracker_method(name) for name in curve) for rule, curve in RULES.items()},
        categories={
            category: times_s
            for category in splits[0].categories
            if not np.isnan(times_s := tuple(time_s for split in splits for time_s in split.categories[category])).all()
        },
        notes=tuple(line for split in splits for line in split.notes),
    )


def _measure(
    dataset: LabelledSource,
    chains: Mapping[str, tuple[PipelineConfig, Mapping[str, TrackerConfig]]],
    categories: CategoryConfig | None,
    progress: Progress | None,
) -> _Split:
    """Runs each detector, by the name of its single frames, and its trackers by name."""
    labels = read_split_labels(dataset)
    encounters = read_encounters(dataset, labels, categories)
    detected_s: dict[str, tuple[float, ...]] = {}
    quality: dict[str, tuple[SequenceTracks, ...]] = {}
    for single, (config, settings) in chains.items():
        predictions, tracks, km = _run(dataset, config, settings, progress)
        singles = first_found(labels, match_lights(labels, predictions), config.classifier.score_threshold)
        detected_s[single] = detection_times_s(encounters, singles)
        for name in settings:
            quality[name] = match_tracks(labels, tracks[name], predictions.boxes_xyxy_px)
            found = [vehicle for sequence in quality[name] for vehicle in sequence.vehicles]
            detected_s[name] = detection_times_s(encounters, found)
    return _Split(
        name=dataset.name,
        encounters=encounters,
        num_sequences=len(dataset.sequences),
        detected_s=detected_s,
        tracks=quality,
        km=km,
        categories=_category_times_s(dataset, encounters),
        notes=tuple(f"{dataset.root}: {line}" for line in (*dataset.notes, *unsaid(labels.lights))),
    )


def _category_times_s(dataset: LabelledSource, encounters: Sequence[Encounter]) -> Mapping[str, tuple[float, ...]]:
    """See `TimeBenefitResults.categories`; of all categories but that of images without any."""
    sequences = {sequence.id: sequence for sequence in dataset.sequences}

    def first_s(encounter: Encounter, category: ImageCategory) -> float:
        image_id = dataset.first_with(sequences[encounter.sequence_id], category)
        return math.nan if image_id is None else dataset.time_s(image_id)

    return {
        f"{category.value}, {category.name.lower().replace('_', ' ')}": tuple(
            first_s(met, category) for met in encounters
        )
        for category in ImageCategory
        if category != ImageCategory.NONE
    }


def _run(
    dataset: LabelledSource, config: PipelineConfig, settings: Mapping[str, TrackerConfig], progress: Progress | None
) -> tuple[Predictions, Mapping[str, Mapping[int, Tracks]], float]:
    """Detections, what each tracker makes of them by name and image id, and the kilometres driven."""
    pipeline = Pipeline(config.model_copy(update={"tracker": TrackerConfig(method="none")}))
    trackers = {name: make_tracker(setting) for name, setting in settings.items()}
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    tracks: dict[str, dict[int, Tracks]] = {name: {} for name in trackers}
    km, period_s = 0.0, 1.0 / dataset.mean_rate_hz
    images = counted(dataset, "images", len(dataset), progress)
    for _, frames in itertools.groupby(images, key=lambda frame: frame.sequence):
        for tracker in trackers.values():
            tracker.reset()
        for frame in frames:
            result = pipeline.step(frame)
            assert result.detections is not None
            boxes[frame.frame] = result.detections.boxes_xyxy_px.astype(np.float64)
            scores[frame.frame] = result.detections.scores.astype(np.float64)
            for name, tracker in trackers.items():
                tracks[name][frame.frame] = tracker.update(frame, result.detections, result.ranges)
            km += (math.nan if frame.motion is None else frame.motion.speed_mps) * period_s / 1000.0
    return Predictions(boxes, scores), tracks, km
