"""The one place where stages meet: `Pipeline.step(frame) -> FrameResult`."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from foreglow.config import PipelineConfig, preset
from foreglow.plugins import built, checked, name_of
from foreglow.stopwatch import Stopwatch
from foreglow.types import BeamCommand, Detections, Frame, FrameResult, Ranges, Tracks

if TYPE_CHECKING:
    from foreglow.beam import BeamPolicy, BeamStage
    from foreglow.classifier import OnnxClassifier
    from foreglow.distance import RangeEstimator
    from foreglow.proposals import Proposer, StandingLight
    from foreglow.tracking import Tracker


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
                lacks the method of its stage.
        """
        given = (("estimator", estimator, "estimate"), ("tracker", tracker, "update"), ("policy", policy, "command"))
        for name, plugin, method in given:
            if plugin is not None and not callable(getattr(plugin, method, None)):
                raise ValueError(f"{name}: expected a class or an object with the method {method}, got {plugin!r}")
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
        from foreglow.distance import make_estimator

        config = self.config.distance
        return built(self._plugins[0], make_estimator, config) if config.estimator != "none" else None

    @cached_property
    def tracker(self) -> Tracker | None:
        """The fourth stage."""
        from foreglow.tracking import make_tracker

        config = self.config.tracker
        return built(self._plugins[1], make_tracker, config) if config.method != "none" else None

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
        for stage in (self.standing, self.classifier, self.estimator, self.tracker, self.beam):
            if stage is not None:
                stage.reset()


class Pipeline:
    """Runs the configured stages on one frame after another.

    The same object serves a data set, a recording, the simulator and the car: it knows nothing of where frames come
    from. Results depend on the frames alone; `FrameResult.stage_ms` is the only thing that a clock touches.
    Not thread-safe: use one pipeline a thread.
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
            raise ValueError(f"Pipeline.config: expected what foreglow.preset or read_config gives, got {config!r}")
        self._stages = Stages(config or preset("foreglow"), estimator=estimator, tracker=tracker, policy=policy)
        self.config = self._stages.config
        self._stages.build()
        self._stopwatch = Stopwatch()
        self._lock = threading.Lock()
        self._sequence: str | None = None

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
        """What the stages make of `frame`; one of another sequence than the frame before begins with a `reset`.

        Args:
            frame: A frame, or a plain grey image (height, width) of uint8 or uint16, taken as frame 0 at time 0.
                Without a camera in it nothing has a range.
            now_ns: The frames' clock, by which the guard sees how old the image is when its command is there; None off
                line, where no time passes. Nothing else knows of it.
            faults: What is known to be wrong around the pipeline, such as frames that did not come; any of it means
                low beam, from which light comes back slowly.

        Raises:
            ValueError: If a plain image is not grey uint8 or uint16, or a plug-in returns something of another kind.
            RuntimeError: If another thread is inside `step` of this pipeline.
        """
        with self._alone("step"):
            return self._step(frame if isinstance(frame, Frame) else Frame(frame, timestamp_ns=0), now_ns, faults)

    def _step(self, frame: Frame, now_ns: Callable[[], int] | None, faults: Sequence[str]) -> FrameResult:
        stages = self._stages
        if self._sequence not in (None, frame.sequence):  # sequences share no time axis
            stages.reset()
        self._sequence = frame.sequence
        stopwatch = self._stopwatch = Stopwatch()
        stopwatch.begin("proposals")
        proposals = stages.proposer.propose(frame.image)
        if stages.standing is not None:
            stopwatch.begin("standing")
            proposals = stages.standing.leave_out(frame, proposals)
        detections: Detections | None = None
        ranges: Ranges | None = None
        tracks: Tracks | None = None
        beam: BeamCommand | None = None
        if stages.classifier is not None:
            stopwatch.begin("classifier")
            detections = stages.classifier.classify(frame, proposals)
            if stages.estimator is not None and frame.camera is not None:
                stopwatch.begin("distance")
                ranges = checked("distance.estimator", stages.estimator.estimate(frame, detections), Ranges)
                if ranges.detections is not detections:
                    raise ValueError("distance.estimator: expected ranges of the detections it was given, got others")
            if stages.tracker is not None:
                stopwatch.begin("tracking")
                tracks = checked("tracker.method", stages.tracker.update(frame, detections, ranges), Tracks)
                if stages.beam is not None:
                    stopwatch.begin("beam")
                    beam = stages.beam.command(frame, tracks, now_ns=now_ns, faults=faults)
        stopwatch.end()
        times_ms = stopwatch.times_ms
        return FrameResult(frame.frame, frame.timestamp_ns, proposals, detections, times_ms, ranges, tracks, beam)

    def run(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """The results of `frames`, one by one, in order; each sequence begins with a `reset`."""
        sequence: str | None = None
        for frame in frames:
            if isinstance(frame, Frame) and frame.sequence != sequence:  # sequences share no time axis
                self.reset()
                sequence = frame.sequence
            yield self.step(frame)

    def reset(self) -> None:
        """Forgets what earlier frames left behind, as at the start of a sequence.

        Raises:
            RuntimeError: If another thread is inside `step` of this pipeline.
        """
        with self._alone("reset"):
            self._stages.reset()
            self._sequence = None

    @contextlib.contextmanager
    def _alone(self, method: str) -> Iterator[None]:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(f"Pipeline.{method}: another thread is inside: use one pipeline per thread")
        try:
            yield
        finally:
            self._lock.release()
