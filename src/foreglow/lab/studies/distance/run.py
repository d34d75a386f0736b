"""The paper's experiment on distance: every estimator with every heuristic, on lights whose ranges are known."""

from __future__ import annotations

import dataclasses
import functools
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.config import OUR_TRACKER, DistanceConfig, PipelineConfig, TrackerConfig, preset
from foreglow.datasets import SplitName, split_in
from foreglow.distance import ESTIMATORS, RangeEstimator
from foreglow.distance.heuristics import HEURISTICS
from foreglow.distance.pixelwise import PixelwiseEstimator
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.studies.distance.lights import LidarLights, RangedLight, Sample, SimulatedLights
from foreglow.lab.studies.progress import Progress
from foreglow.tracking import make_tracker
from foreglow.types import Detections, Frame, Ranges, Tracks
from foreglow.types.white import full_scale

NUM_FRAMES = 5
"""Source: Ewecker et al., arXiv 2107.11302, distance estimation over a track."""

Reduce: TypeAlias = Callable[[Floats], Any]

SERIES: dict[str, Reduce] = {"mean of five frames": np.mean, "median of five frames": np.median}
"""Averages of the latest ranges, by name."""


def over_frames(frames: NDArray[np.int64], ranges_m: Floats, reduce: Reduce) -> Floats:
    """`reduce` applied to the ranges in each frame and the `NUM_FRAMES` - 1 before it, shape (N,).

    Earlier ranges are not predicted to the latest frame: an approaching light is nearer than their mean.

    Args:
        frames: Shape (N,), numbers of the frames in which the light has a box, ascending; frames may be missing.
        ranges_m: Shape (N,), its ranges; NaN is left out, and the result is NaN where all are.
        reduce: Makes one range out of several.

    >>> over_frames(np.array([0, 1, 7]), np.array([50.0, 40.0, 20.0]), np.mean).tolist()
    [50.0, 45.0, 20.0]
    """
    begins = np.searchsorted(frames, frames - NUM_FRAMES, side="right")
    results = np.full(len(frames), np.nan)
    for index, begin in enumerate(begins):
        window = ranges_m[begin : index + 1]
        known = window[~np.isnan(window)]
        if len(known):
            results[index] = reduce(known)
    return results


def tilted(frame: Frame, pitch_rad: float) -> Frame:
    """`frame` with a calibration whose pitch is wrong by `pitch_rad`, upwards."""
    assert frame.camera is not None
    return dataclasses.replace(frame, camera=_tilted_camera(frame.camera, pitch_rad))


@functools.lru_cache(maxsize=64)  # the same camera for each frame: estimators remember what depends on it
def _tilted_camera(camera: Camera, pitch_rad: float) -> Camera:
    mount = camera.vehicle_from_camera
    claimed = Pose(mount.position_m, mount.rotation @ rotation(pitch_rad=pitch_rad))
    return dataclasses.replace(camera, vehicle_from_camera=claimed)


Estimates: TypeAlias = tuple[Floats, Floats]
"""Ranges and sigmas of some lights, shape (N,) each; NaN and infinity without estimate."""

TILTS_DEG = tuple(round(0.1 * step, 1) for step in range(-5, 6))
"""Added to the calibration, upwards."""

OWN_RULE = "own rule"
"""Instead of a heuristic, of estimators that do not go by pixels."""

DEFAULT_HEURISTIC = DistanceConfig().heuristic

TRACKER_ROWS: Mapping[str, TrackerConfig] = MappingProxyType(
    {
        "alpha-beta filter": OUR_TRACKER,
        "mean of the last five": OUR_TRACKER.model_copy(update={"range_filter": "mean", "num_ranges": NUM_FRAMES}),
        "median of the last five": OUR_TRACKER.model_copy(update={"range_filter": "median", "num_ranges": NUM_FRAMES}),
        "alpha-beta filter and looming": OUR_TRACKER.model_copy(update={"use_looming": True}),
    }
)
"""Our tracker with each of its ways to make one range of those of a track, by name."""

BOX_ALONE = "box alone"
"""The range of the box that a plausible track follows, to compare with the track's."""


@dataclass(frozen=True, slots=True)
class DistancePlan:
    """What is asked for.

    Attributes:
        estimators: Names of `ESTIMATORS`.
        config: Of the detector whose boxes are given a range, and of the pitch.
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

    @property
    def is_default(self) -> bool:
        """Whether it goes by the default heuristic or by its own rule."""
        return self.heuristic in (DEFAULT_HEURISTIC, OWN_RULE)

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
        left_out: Labelled lights without a range to compare with or without a box, by reason.
        lights: The N others, in the order of sequence and image.
        ranges_m: By method, shape (N,); NaN without estimate.
        sigmas_m: By method, shape (N,); infinite without estimate.
        series_m: By name of the series and method, shape (N,): the ranges of a light's latest five frames as one.
        tracked: By name of `TRACKER_ROWS`, or `box alone`, and method, the estimates of the plausible track that
            follows a light's box; none where no track does.
        example: The image with a LiDAR's depth that has the most lights; None without a LiDAR.
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
    tracked: Mapping[tuple[str, Method], Estimates]
    example: Sample | None = None

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
        return tuple(method for method in self.methods if method.is_default)


def run_experiment(source: Path | LidarLights, plan: DistancePlan, progress: Progress | None = None) -> DistanceResults:
    """Ranges for every light whose range is known.

    Args:
        source: The folder of a simulated set or split, or what a LiDAR measured.
        plan: What is asked for.
        progress: Called after each image.

    Raises:
        FileNotFoundError: If a file of the data set is missing.
        ValueError: If one is broken, or a simulated set has no ranges, calibration and road beside its labels.
    """
    samples = source if isinstance(source, LidarLights) else SimulatedLights(split_in(source, plan.split), plan.config)
    methods = {method: method.make(plan.config) for method in _methods(plan.estimators)}
    main = [method for method in methods if method.is_default and not method.tilt_deg]
    trackers = {(name, method): make_tracker(config) for method in main for name, config in TRACKER_ROWS.items()}
    stages: list[Any] = [*methods.values(), *trackers.values()]
    lights: list[RangedLight] = []
    found: dict[Method, list[Estimates]] = {method: [] for method in methods}
    tracked: dict[tuple[str, Method], list[Estimates]] = defaultdict(list)
    scene: int | None = None
    example: Sample | None = None
    for num_done, sample in enumerate(samples, start=1):
        frame = full_scale(sample.frame, plan.config.guard.white_level)  # as the pipeline's estimators see it
        detections, in_image = sample.detections, sample.lights
        if sample.depth_m is not None and (example is None or len(in_image) > len(example.lights)):
            example = sample
        if sample.scene_id != scene:
            scene = sample.scene_id
            for stage in stages:
                stage.reset()
        lights += in_image
        boxes = np.array([light.box for light in in_image], np.intp)
        for method, ranges in _estimated(frame, detections, methods):
            of_boxes = ranges.ranges_m[boxes], ranges.sigmas_m[boxes]
            found[method].append(of_boxes)
            if method not in main:
                continue
            for name in TRACKER_ROWS:
                tracks = trackers[name, method].update(frame, detections, ranges)
                rows = _tracks_of(boxes, tracks)
                # -1 as an index is what is put behind them.
                of_tracks = np.append(tracks.ranges_m, np.nan)[rows], np.append(tracks.sigmas_m, np.inf)[rows]
                tracked[name, method].append(of_tracks)
            is_tracked = rows >= 0  # by any of the trackers: they differ in the filter of the range alone
            alone = np.where(is_tracked, of_boxes[0], np.nan), np.where(is_tracked, of_boxes[1], np.inf)
            tracked[BOX_ALONE, method].append(alone)
        if progress is not None:
            progress("images", num_done, samples.num_images)
    estimates = {method: _joined(parts) for method, parts in found.items()}
    ranges_m = {method: ranges_m for method, (ranges_m, _) in estimates.items()}
    return DistanceResults(
        name=samples.name,
        plan=plan,
        num_images=samples.num_images,
        rate_hz=samples.rate_hz,
        left_out=dict(samples.left_out),
        lights=tuple(lights),
        ranges_m=ranges_m,
        sigmas_m={method: sigmas_m for method, (_, sigmas_m) in estimates.items()},
        series_m=dict(_series(lights, ranges_m)),
        tracked={key: _joined(parts) for key, parts in tracked.items()},
        example=example,
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


def _estimated(
    frame: Frame, detections: Detections, methods: Mapping[Method, RangeEstimator]
) -> Iterator[tuple[Method, Ranges]]:
    frames = {tilt_deg: tilted(frame, float(np.radians(tilt_deg))) for tilt_deg in TILTS_DEG if tilt_deg} | {0.0: frame}
    for method, estimator in methods.items():
        yield method, estimator.estimate(frames[method.tilt_deg], detections)


def _tracks_of(boxes: NDArray[np.intp], tracks: Tracks) -> NDArray[np.intp]:
    """For each box the row of the plausible track that took it in this frame; -1 where none did."""
    is_following = tracks.is_plausible & (tracks.detections >= 0)
    row_of = dict(zip(tracks.detections[is_following].tolist(), np.flatnonzero(is_following).tolist(), strict=True))
    return np.array([row_of.get(box, -1) for box in boxes.tolist()], np.intp)


def _joined(parts: Sequence[Estimates]) -> Estimates:
    ranges_m, sigmas_m = zip((np.zeros(0), np.zeros(0)), *parts, strict=True)
    return np.concatenate(ranges_m), np.concatenate(sigmas_m)


def _series(
    lights: Sequence[RangedLight], ranges_m: Mapping[Method, Floats]
) -> Iterator[tuple[tuple[str, Method], Floats]]:
    """The ranges of each light's latest five frames as one, by every method; the labels' instances are the tracks."""
    keys = np.array([(light.sequence_id, light.instance_id) for light in lights], np.int64).reshape(-1, 2)
    image_ids = np.array([light.image_id for light in lights], np.int64)
    _, track_of = np.unique(keys, axis=0, return_inverse=True)
    tracks = [np.flatnonzero(track_of == track) for track in range(int(track_of.max(initial=-1)) + 1)]
    for method, ranges in ranges_m.items():
        for name, reduce in () if method.tilt_deg else SERIES.items():
            series = np.full(len(lights), np.nan)
            for track in tracks:
                series[track] = over_frames(image_ids[track], ranges[track], reduce)
            yield (name, method), series
