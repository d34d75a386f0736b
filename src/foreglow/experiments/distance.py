"""The paper's experiment on distance: every estimator with every heuristic, on lights whose ranges are known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.config import DistanceConfig, PipelineConfig, TrackerConfig, preset
from foreglow.datasets import PVDN, SplitName, split_folder
from foreglow.distance import ESTIMATORS, RangeEstimator
from foreglow.distance.heuristics import HEURISTICS
from foreglow.distance.pixelwise import PixelwiseEstimator
from foreglow.distance.series import SERIES, over_frames
from foreglow.experiments.distance_lights import RangedLight, ranged_lights, tilted
from foreglow.geometry import Floats
from foreglow.pipeline import Pipeline
from foreglow.simulation import read_truth
from foreglow.types import Detections, Frame

Progress: TypeAlias = Callable[[str, int, int], None]
"""Told the step, how much of it is done, and of how much."""

TILTS_DEG = tuple(round(0.1 * step, 1) for step in range(-5, 6))
"""Added to the calibration, upwards."""

OWN_RULE = "own rule"
"""Instead of a heuristic, of estimators that do not go by pixels."""

DEFAULT_HEURISTIC = DistanceConfig().heuristic


@dataclass(frozen=True, slots=True)
class DistancePlan:
    """What is asked for.

    Attributes:
        split: The split that is measured on.
        estimators: Names of `ESTIMATORS`.
        config: Of the detector whose boxes are given a range, and of the pitch.
        seed: Of the intervals.
    """

    split: SplitName = "test"
    estimators: tuple[str, ...] = tuple(ESTIMATORS)
    config: PipelineConfig = field(default_factory=lambda: preset("foreglow"))
    seed: int = 1

    def __post_init__(self) -> None:
        unknown = [name for name in self.estimators if name not in ESTIMATORS]
        if unknown or not self.estimators:
            raise ValueError(
                f"estimators: expected some of {', '.join(ESTIMATORS)}, got {', '.join(unknown) or 'none'}"
            )


@dataclass(frozen=True, slots=True, order=True)
class Method:
    """An estimator with a heuristic.

    Attributes:
        estimator: Of `ESTIMATORS`.
        heuristic: Of `HEURISTICS`, or `own rule`.
        tilt_deg: Error of the calibration's pitch that is put in, upwards.
    """

    estimator: str
    heuristic: str
    tilt_deg: float = 0.0

    @property
    def name(self) -> str:
        """Such as `gp, centre`."""
        return f"{self.estimator}, {self.heuristic}"

    def make(self, config: PipelineConfig) -> RangeEstimator:
        """The estimator, otherwise set as in `config`."""
        fields = {"estimator": self.estimator}
        if self.heuristic != OWN_RULE:
            fields["heuristic"] = self.heuristic
        return ESTIMATORS[self.estimator](config.distance.model_copy(update=fields))


@dataclass(frozen=True, slots=True, eq=False)
class DistanceResults:
    """All ranges of all methods.

    Attributes:
        name: The split.
        plan: What was asked for.
        num_images: Images of the split.
        rate_hz: Their rate.
        left_out: Labelled lights without a range to compare with or without a box, by reason.
        lights: The N others, in the order of sequence and image.
        ranges_m: By method, shape (N,); NaN without estimate.
        sigmas_m: Likewise.
        series_m: By name of the series and method, shape (N,): the ranges of a light's latest five frames as one.
    """

    name: str
    plan: DistancePlan
    num_images: int
    rate_hz: float
    left_out: Mapping[str, int]
    lights: tuple[RangedLight, ...]
    ranges_m: Mapping[Method, Floats]
    sigmas_m: Mapping[Method, Floats]
    series_m: Mapping[tuple[str, Method], Floats]

    def column(self, name: str) -> NDArray[Any]:
        """Shape (N,): a field of the lights."""
        return np.array([getattr(light, name) for light in self.lights])

    @property
    def methods(self) -> tuple[Method, ...]:
        """Those with the calibration as it is."""
        return tuple(method for method in self.ranges_m if not method.tilt_deg)

    @property
    def main_methods(self) -> tuple[Method, ...]:
        """One of each estimator: with the heuristic that is the default, or its own rule."""
        return tuple(method for method in self.methods if method.heuristic in (DEFAULT_HEURISTIC, OWN_RULE))


def run_experiment(data: Path, plan: DistancePlan, progress: Progress | None = None) -> DistanceResults:
    """Ranges for every labelled light of a simulated split whose range is known, from the smallest box around it.

    Args:
        data: A data set with the split.
        plan: What to measure.
        progress: Told how many images are done.

    Raises:
        FileNotFoundError: If a file of the data set is missing.
        ValueError: If one is broken, or the set has no ranges, calibration and road beside its labels.
    """
    dataset = PVDN(split_folder(data, plan.split))
    if not (dataset.root / "simulation" / "info.json").is_file():
        raise ValueError(
            f"{dataset.root}: expected the range of each light, a calibration and the road ahead beside the labels, "
            "as simulated drives have them in simulation/; found none"
        )
    truth = read_truth(dataset.root)
    detector = Pipeline(
        plan.config.model_copy(
            update={"distance": DistanceConfig(estimator="none"), "tracker": TrackerConfig(method="none")}
        )
    )
    methods = {method: method.make(plan.config) for method in _methods(plan.estimators)}
    left_out: Counter[str] = Counter()
    lights: list[RangedLight] = []
    found: dict[Method, list[tuple[Floats, Floats]]] = {method: [] for method in methods}
    num_done = 0
    for sequence_id in (sequence.id for sequence in dataset.sequences):
        drive = truth.sequence(sequence_id)
        detector.reset()
        for estimator in methods.values():
            estimator.reset()
        for image in drive.frames:
            frame = dataset.read(image.image_id)
            detections = _detections(detector, frame)
            its_lights = ranged_lights(image.image_id, drive, detections.boxes_xyxy_px, left_out)
            lights += its_lights
            for method, ranges in _estimated(frame, detections, its_lights, methods):
                found[method].append(ranges)
            num_done += 1
            if progress is not None:
                progress("images", num_done, len(dataset))
    ranges_m = {method: np.concatenate([np.zeros(0), *(one for one, _ in pairs)]) for method, pairs in found.items()}
    sigmas_m = {method: np.concatenate([np.zeros(0), *(one for _, one in pairs)]) for method, pairs in found.items()}
    return DistanceResults(
        name=dataset.name,
        plan=plan,
        num_images=len(dataset),
        rate_hz=dataset.rate_hz,
        left_out=dict(left_out),
        lights=tuple(lights),
        ranges_m=ranges_m,
        sigmas_m=sigmas_m,
        series_m=dict(_series(lights, ranges_m)),
    )


def _methods(estimators: Sequence[str]) -> Iterator[Method]:
    """Every heuristic where an estimator goes by pixels; tilted, the default one only."""
    for name in estimators:
        by_pixels = issubclass(ESTIMATORS[name], PixelwiseEstimator)
        for heuristic in HEURISTICS if by_pixels else (OWN_RULE,):
            yield Method(name, heuristic)
        for tilt_deg in TILTS_DEG:
            if tilt_deg:
                yield Method(name, DEFAULT_HEURISTIC if by_pixels else OWN_RULE, tilt_deg)


def _detections(detector: Pipeline, frame: Frame) -> Detections:
    """All boxes of the frame, as the stage of distance gets them; without a model all with the score 1."""
    result = detector.step(frame)
    ones = np.ones(len(result.proposals), np.float32)
    if result.detections is not None:
        return result.detections
    return Detections(result.proposals, ones, score_threshold=0.5)


def _estimated(
    frame: Frame, detections: Detections, lights: Sequence[RangedLight], methods: Mapping[Method, RangeEstimator]
) -> Iterator[tuple[Method, tuple[Floats, Floats]]]:
    """Ranges and sigmas of the lights by each method; estimators with a memory see images without lights, too."""
    frames = {tilt_deg: tilted(frame, float(np.radians(tilt_deg))) for tilt_deg in TILTS_DEG if tilt_deg} | {0.0: frame}
    places = np.array([light.place for light in lights], np.intp)
    for method, estimator in methods.items():
        ranges = estimator.estimate(frames[method.tilt_deg], detections)
        yield method, (ranges.ranges_m[places], ranges.sigmas_m[places])


def _series(
    lights: Sequence[RangedLight], ranges_m: Mapping[Method, Floats]
) -> Iterator[tuple[tuple[str, Method], Floats]]:
    """The series of every main method, light by light; the labels' instances are the tracks."""
    keys = np.array([(light.sequence_id, light.instance_id) for light in lights], np.int64).reshape(-1, 2)
    image_ids = np.array([light.image_id for light in lights], np.int64)
    _, track_of = np.unique(keys, axis=0, return_inverse=True)
    tracks = [np.flatnonzero(track_of == track) for track in range(int(track_of.max(initial=-1)) + 1)]
    for method, ranges in ranges_m.items():
        if method.tilt_deg:
            continue
        for name, reduce in SERIES.items():
            series = np.full(len(lights), np.nan)
            for places in tracks:
                series[places] = over_frames(image_ids[places], ranges[places], reduce)
            yield (name, method), series
