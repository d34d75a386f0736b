"""The one place where stages meet: `Pipeline.step(frame) -> FrameResult`."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from foreglow.config import PipelineConfig, preset
from foreglow.plugins import METHODS, built, check_methods, checked, name_of, staying
from foreglow.stopwatch import Stopwatch
from foreglow.types import BeamCommand, Detections, Frame, FrameResult, Ranges, Tracks, Vehicles
from foreglow.types.arrays import check_callables, check_names
from foreglow.types.white import full_scale
from foreglow.wording import shortened

if TYPE_CHECKING:
    from foreglow.beam import BeamPolicy, BeamStage
    from foreglow.classifier import OnnxClassifier
    from foreglow.distance import RangeEstimator
    from foreglow.proposals import Proposer, StandingLight
    from foreglow.tracking import Tracker


MAX_TRACKS = 2000
"""Tracks of a frame: far more than there are lights, and few enough that a beam can be made of them."""


def estimated(estimator: RangeEstimator, frame: Frame, detections: Detections) -> Ranges:
    """The ranges that `estimator`, perhaps a plug-in, gives `detections` in `frame`, which must have a camera.

    Raises:
        ValueError: If it returns anything else, or ranges of others.
    """
    ranges = checked("distance.estimator", estimator.estimate(frame, detections), Ranges)
    if ranges.detections is not detections:
        raise ValueError("distance.estimator: expected ranges of the detections it was given, got others")
    return ranges


def tracked(tracker: Tracker, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
    """The tracks that `tracker`, perhaps a plug-in, has after `frame`.

    Raises:
        ValueError: If it returns anything else, more than `MAX_TRACKS`, or tracks of boxes that are not there.
    """
    tracks = checked("tracker.method", tracker.update(frame, detections, ranges), Tracks)
    if len(tracks) > MAX_TRACKS:
        raise ValueError(f"tracker.method: expected at most {MAX_TRACKS} tracks of a frame, got {len(tracks)}")
    if len(tracks) and tracks.detections.max() >= len(detections):
        expected = f"expected tracks of the {len(detections)} boxes it was given"
        raise ValueError(f"tracker.method: {expected}, got box {tracks.detections.max()}")
    if tracks.vehicles is None:
        return tracks
    return dataclasses.replace(tracks, vehicles=checked("tracker.method", tracks.vehicles, Vehicles))


class Stages:
    """The stages that a configuration names, each imported and made when it is first asked for; None where it is off.

    Attributes:
        config: The configuration; plug-ins that were given have their names in it.
    """

    def __init__(
        self,
        config: PipelineConfig,
        *,
        estimator: RangeEstimator | type[RangeEstimator] | None = None,
        tracker: Tracker | type[Tracker] | None = None,
        policy: BeamPolicy | type[BeamPolicy] | None = None,
    ) -> None:
        """Takes the configuration, and plug-ins that stand in place of what it names: an object or a class each.

        Raises:
            ValueError: If a policy is given, and there is no model or no tracker to make its tracks; if a plug-in
                lacks a method of its stage.
        """
        for kind, plugin in (("estimator", estimator), ("tracker", tracker), ("policy", policy)):
            if plugin is not None:
                check_methods(kind, plugin, METHODS[kind])
        if estimator is not None:
            config = config.changed("distance", estimator=name_of(estimator))
        if tracker is not None:
            config = config.changed("tracker", method=name_of(tracker))
        if policy is not None:
            config = config.commanding(policy=name_of(policy))
        self.config = config
        self._plugins = estimator, tracker, policy

    @cached_property
    def proposer(self) -> Proposer:
        """The first stage."""
        from foreglow.proposals import make_proposer

        return make_proposer(self.config.proposals)

    @cached_property
    def standing(self) -> StandingLight | None:
        """What takes boxes out that stand still while we drive, after the first stage."""
        from foreglow.proposals import StandingLight

        return StandingLight(self.config.standing) if self.config.standing.enabled else None

    @cached_property
    def classifier(self) -> OnnxClassifier | None:
        """The second stage; None without a model."""
        from foreglow.classifier import OnnxClassifier

        return OnnxClassifier(self.config.classifier) if self.config.classifier.model is not None else None

    @cached_property
    def estimator(self) -> RangeEstimator | None:
        """The third stage."""
        config = self.config.distance
        if config.estimator == "none":
            return None
        from foreglow.distance import make_estimator

        return built(self._plugins[0], make_estimator, config)

    @cached_property
    def tracker(self) -> Tracker | None:
        """The fourth stage."""
        config = self.config.tracker
        if config.method == "none":
            return None
        from foreglow.tracking import make_tracker

        return built(self._plugins[1], make_tracker, config)

    @cached_property
    def beam(self) -> BeamStage | None:
        """The fifth stage: the policy, and the guard after it."""
        from foreglow.beam import BeamStage

        config = self.config
        if config.beam.policy == "none":
            return None
        return BeamStage(config.beam, config.guard, self._plugins[2], config.lit_street)

    def build(self) -> None:
        """Makes all stages now, so that what is wrong with one is known before the first frame."""
        _ = self.proposer, self.standing, self.classifier, self.estimator, self.tracker, self.beam

    def reset(self) -> None:
        """Has the stages forget what earlier frames left behind, as at the start of a sequence."""
        self._reset_before_beam()
        if self.beam is not None:
            self.beam.reset()

    def resume(self) -> None:
        """The same after an error within a sequence, but for what the guard knows of the camera."""
        self._reset_before_beam()
        if self.beam is not None:
            self.beam.resume()

    def _reset_before_beam(self) -> None:
        for stage in (self.standing, self.classifier, self.estimator, self.tracker):
            if stage is not None:
                stage.reset()


class Pipeline:
    """Runs the configured stages on one frame after another.

    The same object serves a data set, a recording, the simulator and the car: it knows nothing of where frames come
    from. Results depend on the frames alone; `FrameResult.stage_ms` is the only thing that a clock touches.
    Not thread-safe: use one pipeline a thread. It cannot be copied or pickled, as its stages remember frames: make one
    of its `config` where you need another.
    """

    def __init__(
        self,
        config: PipelineConfig | None = None,
        *,
        estimator: RangeEstimator | type[RangeEstimator] | None = None,
        tracker: Tracker | type[Tracker] | None = None,
        policy: BeamPolicy | type[BeamPolicy] | None = None,
    ) -> None:
        """Builds the stages; without a configuration, those of the preset `foreglow`.

        Args:
            config: What each stage is, and its parameters.
            estimator: An estimator of your own in place of the one that `config` names: an object or a class.
            tracker: A tracker of your own, likewise.
            policy: A beam policy of your own, likewise; the guard checks its commands like any other's.

        Raises:
            FileNotFoundError: If the configured model does not exist.
            ValueError: If the model, the lamps' description or a plug-in cannot be used; the message names path or
                field, and what was expected.
        """
        if not isinstance(config, PipelineConfig | None):
            raise ValueError(
                f"Pipeline.config: expected what foreglow.preset or read_config gives, got {shortened(config)}"
            )
        self._stages = Stages(config or preset("foreglow"), estimator=estimator, tracker=tracker, policy=policy)
        self.config = self._stages.config
        self._stages.build()
        self._stopwatch = Stopwatch()
        self._sequence: str | None = None  # of the frame before; None where the next frame begins anew
        self._has_failed = False  # in the frame before
        self._run: object = None  # the latest one
        self._lock = threading.Lock()

    @property
    def stage(self) -> str | None:
        """The stage under way, also after it raised; None between frames. For those who watch from another thread."""
        return self._stopwatch.part

    @property
    def dispatch(self) -> str | None:
        """The instruction set that the native core uses: `baseline`, `avx2` or `avx512`; None with another back end."""
        from foreglow.proposals import NativeProposer

        proposer = self._stages.proposer
        return proposer.dispatch if isinstance(proposer, NativeProposer) else None

    def step(
        self, frame: Frame | NDArray[Any], *, now_ns: Callable[[], int] | None = None, faults: Sequence[str] = ()
    ) -> FrameResult:
        """What the stages make of `frame`.

        A frame of another sequence than the one before it begins anew, as sequences share no time axis, and so does
        the frame after an error, but for what the guard knows of the camera.

        Args:
            frame: A frame, or a plain grey image (height, width) of uint8 or uint16, taken as frame 0 at time 0, so
                for one image; those of a drive need their times. Without a camera in it nothing has a range.
            now_ns: The frames' clock, by which the guard sees how old the image is when its command is there; None off
                line, where no time passes. Nothing else knows of it.
            faults: What is known to be wrong around the pipeline, such as frames that did not come; any of it means
                low beam, from which light comes back slowly.

        Raises:
            ValueError: If a plain image is not grey uint8 or uint16, `faults` are no names, `now_ns` is no function, or
                a plug-in returns something of another kind.
            RuntimeError: If another thread is inside `step` of this pipeline.
        """
        if now_ns is not None:
            check_callables(now_ns=now_ns)
        check_names("faults", faults)
        with self._alone("step"), staying():
            return self._step(frame if isinstance(frame, Frame) else Frame(frame, timestamp_ns=0), now_ns, faults)

    def _step(self, frame: Frame, now_ns: Callable[[], int] | None, faults: Sequence[str]) -> FrameResult:
        stages = self._stages
        stopwatch = self._stopwatch = Stopwatch()
        if frame.sequence != self._sequence:
            self._sequence = None  # until all stages have begun anew
            stages.reset()
        elif self._has_failed:
            stages.resume()
        self._sequence, self._has_failed = frame.sequence, True  # until all stages have seen this frame
        stopwatch.begin("proposals")
        seen = full_scale(frame, self.config.guard.white_level)
        proposals = stages.proposer.propose(seen.image)
        if stages.standing is not None:
            stopwatch.begin("standing")
            proposals = stages.standing.leave_out(seen, proposals)
        detections: Detections | None = None
        ranges: Ranges | None = None
        tracks: Tracks | None = None
        beam: BeamCommand | None = None
        if stages.classifier is not None:
            stopwatch.begin("classifier")
            detections = stages.classifier.classify(seen, proposals)
            if stages.estimator is not None and frame.camera is not None:
                stopwatch.begin("distance")
                ranges = estimated(stages.estimator, seen, detections)
            if stages.tracker is not None:
                stopwatch.begin("tracking")
                tracks = tracked(stages.tracker, seen, detections, ranges)
                if stages.beam is not None:
                    stopwatch.begin("beam")
                    beam = stages.beam.command(frame, tracks, now_ns=now_ns, faults=faults)
        stopwatch.end()
        self._has_failed = False
        times_ms = stopwatch.times_ms
        return FrameResult(frame.frame, frame.timestamp_ns, proposals, detections, times_ms, ranges, tracks, beam)

    def run(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """The results of `frames`, one by one, in order, after a `reset`.

        Raises:
            TypeError: If they are no frames but images, a single frame, the path of a source, or no sequence of
                anything.
            RuntimeError: If another run of this pipeline has begun meanwhile, as it would know this one's frames.
        """
        if isinstance(frames, str | os.PathLike):
            raise TypeError(f"frames: expected frames, such as foreglow.open_source({str(frames)!r}), got a path")
        if not isinstance(frames, Iterable) or isinstance(frames, np.ndarray):
            raise TypeError(
                "frames: expected frames, such as foreglow.open_source(path) or [frame], got "
                f"{'a single Frame' if isinstance(frames, Frame) else type(frames).__name__}"
            )
        self.reset()
        self._run = run = object()
        for frame in frames:
            if self._run is not run:
                raise RuntimeError("Pipeline.run: another run has begun: end one before the next, or use two pipelines")
            if not isinstance(frame, Frame):  # as `step` takes for frame 0 at time 0, each of them
                got = f"got {type(frame).__name__}: `step` takes an image without its time"
                raise TypeError(f"frames: expected each to be a Frame, such as foreglow.Frame(image, time_ns), {got}")
            yield self.step(frame)

    def reset(self) -> None:
        """Has the next frame begin anew, as at the start of a sequence: nothing of earlier frames counts for it.

        `step` does so itself where the sequence changes: this is for frames that are run a second time, and for those
        of another file, as videos and folders have no sequence.

        Raises:
            RuntimeError: If another thread is inside `step` of this pipeline.
        """
        with self._alone("reset"):
            self._sequence = None

    def resume(self) -> None:
        """Has the next frame begin anew as after an error: as `reset`, but for what the guard knows of the camera.

        Raises:
            RuntimeError: If another thread is inside `step` of this pipeline.
        """
        with self._alone("resume"):
            self._has_failed = True

    def __reduce__(self) -> NoReturn:
        raise TypeError("Pipeline: cannot be copied or pickled; make one of its config, such as in each process")

    @contextlib.contextmanager
    def _alone(self, method: str) -> Iterator[None]:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(f"Pipeline.{method}: another thread is inside: use one pipeline per thread")
        try:
            yield
        finally:
            self._lock.release()
