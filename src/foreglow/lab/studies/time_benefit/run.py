"""The experiment on the time benefit: one pass over a split, any number of trackers on the same detections."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, PipelineConfig, TrackerConfig
from foreglow.datasets import PVDN, CategoryConfig
from foreglow.lab.evaluation.boxes.breakdown import match_lights, plain, read_split_labels
from foreglow.lab.evaluation.boxes.first_found import first_found
from foreglow.lab.evaluation.tracks.encounters import Encounter, read_encounters
from foreglow.lab.evaluation.tracks.track_quality import SequenceTracks, match_tracks
from foreglow.lab.studies.time_benefit.metrics import TimeBenefit, detection_times_s, time_benefit
from foreglow.pipeline import Pipeline
from foreglow.runs.predictions import Predictions
from foreglow.tracking import Tracker, make_tracker
from foreglow.types import Tracks

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the step, how much of it is done, and how much there is."""

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
            f"{hits} of {looks}": _ours(confirmation="m_of_n", min_hits=hits, num_looks=looks)
            for hits, looks in ((1, 1), (2, 3), (3, 4), (3, 5), (4, 6), (5, 7), (6, 9), (8, 12))
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
class FalseTracks:
    """Confirmed tracks that never held any light of a vehicle, not even doubtful light.

    Attributes:
        num: How many.
        num_plausible: Of so many confirmed tracks.
        minutes: In so much time.
        km: On such a way; NaN where the speed is unknown.
        num_empty: Those that came up in an image without any vehicle's light.
        empty_minutes: Time of such images.
    """

    num: int
    num_plausible: int
    minutes: float
    km: float
    num_empty: int
    empty_minutes: float

    @property
    def per_minute(self) -> float:
        """Rate in time; NaN without any."""
        return self.num / self.minutes if self.minutes else math.nan

    @property
    def per_km(self) -> float:
        """Rate along the way; NaN where that is unknown or nothing."""
        return self.num / self.km if self.km > 0 else math.nan

    @property
    def per_empty_minute(self) -> float:
        """Rate where nobody is; NaN without such time."""
        return self.num_empty / self.empty_minutes if self.empty_minutes else math.nan

    def to_json(self) -> dict[str, Any]:
        """All fields and rates by name, for JSON: null instead of NaN."""
        rates = ("per_minute", "per_km", "per_empty_minute")
        values = dataclasses.asdict(self) | {name: getattr(self, name) for name in rates}
        return {name: plain(value) for name, value in values.items()}


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the table.

    Attributes:
        benefit: How early it detects.
        false: Its false confirmed tracks; None for what is no tracker.
        delay_s: Mean time from the first annotated artifact, where a vehicle that is not detected before the production
            system reports it, or the sequence ends, counts as detected then: missing a vehicle makes no rule quick.
    """

    benefit: TimeBenefit
    false: FalseTracks | None
    delay_s: float

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        false = None if self.false is None else self.false.to_json()
        return self.benefit.to_json() | {"false": false, "delay_s": plain(self.delay_s)}


@dataclass(frozen=True, slots=True)
class TimeBenefitResults:
    """Everything that the report shows.

    Attributes:
        name: The split.
        config: What detected.
        encounters: The first vehicle of each sequence with one.
        num_sequences: All sequences.
        methods: The rows of the table.
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
        return next(one for one in self.methods if one.benefit.name == name)

    def to_json(self) -> dict[str, Any]:
        """All figures by name, for JSON: null instead of NaN."""
        return {
            "name": self.name,
            "num_sequences": self.num_sequences,
            "encounters": [one.to_json() for one in self.encounters],
            "methods": [one.to_json() for one in self.methods],
            "curves": {rule: [one.to_json() for one in methods] for rule, methods in self.curves.items()},
        }


@dataclass(slots=True)
class _Followed:
    """What one pass over the split gathers."""

    boxes: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    scores: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    tracks: dict[str, dict[int, Tracks]] = field(default_factory=dict)
    km: float = 0.0


def run_experiment(
    dataset: PVDN, config: PipelineConfig, categories: CategoryConfig | None = None, progress: Progress | None = None
) -> TimeBenefitResults:
    """Runs the detector of `config` over `dataset` once, and all trackers on what it finds.

    Args:
        dataset: Images with labels.
        config: Detector and distance; its tracker has a row of its own where it is none of `TRACKERS`.
        categories: Which image category marks the production system's report, where the set is not simulated.
        progress: Told of each image.

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
    settings = {name: one for curve in RULES.values() for name, one in curve.items()} | trackers
    followed = _follow(dataset, config, settings, progress)

    def method(name: str, detected_s: Sequence[float], false: FalseTracks | None = None) -> Method:
        return Method(time_benefit(name, encounters, detected_s), false, _delay_s(encounters, detected_s))

    def tracker_method(name: str) -> Method:
        quality = match_tracks(labels, followed.tracks[name], followed.boxes)
        found = [vehicle for sequence in quality for vehicle in sequence.vehicles]
        return method(name, detection_times_s(encounters, found), _false_tracks(quality, followed.km))

    predictions = Predictions(followed.boxes, followed.scores)
    singles = first_found(labels, match_lights(labels, predictions), config.classifier.score_threshold)
    return TimeBenefitResults(
        name=dataset.name,
        config=config,
        encounters=encounters,
        num_sequences=len(dataset.sequences),
        methods=(
            method("single frame", detection_times_s(encounters, singles)),
            *(tracker_method(name) for name in trackers),
            method("human", [one.human_s for one in encounters]),
            method("first lamp in sight", [one.sight_s for one in encounters]),
            method("production system", [one.production_s for one in encounters]),
        ),
        curves={rule: tuple(tracker_method(name) for name in curve) for rule, curve in RULES.items()},
    )


def least_delay_s(curve: Sequence[Method], max_false_per_minute: float) -> float:
    """The least mean delay of a rule's settings with at most so many false confirmed tracks a minute; NaN without."""
    delays = [one.delay_s for one in curve if one.false is not None and one.false.per_minute <= max_false_per_minute]
    return min(delays, default=math.nan)


def _follow(
    dataset: PVDN, config: PipelineConfig, settings: Mapping[str, TrackerConfig], progress: Progress | None
) -> _Followed:
    """Detections of every image, and what each tracker makes of them."""
    pipeline = Pipeline(config.model_copy(update={"tracker": TrackerConfig(method="none")}))
    trackers: dict[str, Tracker] = {name: make_tracker(one) for name, one in settings.items()}
    followed = _Followed(tracks={name: {} for name in trackers})
    sequence = ""
    for place, frame in enumerate(dataset):
        if frame.sequence != sequence:
            pipeline.reset()
            for tracker in trackers.values():
                tracker.reset()
            sequence = frame.sequence
        result = pipeline.step(frame)
        assert result.detections is not None
        followed.boxes[frame.frame] = result.detections.boxes_xyxy_px.astype(np.float64)
        followed.scores[frame.frame] = result.detections.scores.astype(np.float64)
        for name, tracker in trackers.items():
            followed.tracks[name][frame.frame] = tracker.update(frame, result.detections, result.ranges)
        speed_mps = math.nan if frame.motion is None else frame.motion.speed_mps
        followed.km += speed_mps / dataset.rate_hz / 1000.0
        if progress is not None:
            progress("images", place + 1, len(dataset))
    return followed


def _false_tracks(quality: Sequence[SequenceTracks], km: float) -> FalseTracks:
    return FalseTracks(
        num=sum(one.num_false for one in quality),
        num_plausible=sum(one.num_plausible for one in quality),
        minutes=sum(one.duration_s for one in quality) / 60.0,
        km=km,
        num_empty=sum(one.num_false_empty for one in quality),
        empty_minutes=sum(one.empty_s for one in quality) / 60.0,
    )


def _delay_s(encounters: Sequence[Encounter], detected_s: Sequence[float]) -> float:
    """See `Method.delay_s`."""
    latest_s = [
        max(one.light_s, one.duration_s if math.isnan(one.production_s) else one.production_s) for one in encounters
    ]
    delays = np.fmin(detected_s, latest_s) - [one.light_s for one in encounters]
    return float(delays.mean())
