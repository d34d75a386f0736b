"""The one place where stages meet: `Pipeline.step(frame) -> FrameResult`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam import BeamStage
from foreglow.classifier import OnnxClassifier
from foreglow.config import PipelineConfig, preset
from foreglow.distance import make_estimator
from foreglow.proposals import NativeProposer, make_proposer
from foreglow.tracking import make_tracker
from foreglow.types import BeamCommand, Detections, Frame, FrameResult, Ranges, Tracks


class Pipeline:
    """Runs the configured stages on one frame after another.

    The same object serves a data set, a recording, the simulator and the car: it knows nothing of where frames come
    from. Results depend on the frames alone; `FrameResult.stage_ms` is the only thing that a clock touches.
    Not thread-safe: use one pipeline a thread.
    """

    def __init__(self, config: PipelineConfig | None = None) -> None:
        """Builds the stages; without a configuration, those of the preset `foreglow`.

        Raises:
            FileNotFoundError: If the configured model does not exist.
            ValueError: If the model or the lamps' description cannot be used; the message names path, field and
                expectation.
        """
        self.config = config or preset("foreglow")
        self._proposer = make_proposer(self.config.proposals)
        model, distance, tracker = self.config.classifier.model, self.config.distance, self.config.tracker
        self._classifier = OnnxClassifier(self.config.classifier) if model is not None else None
        self._estimator = make_estimator(distance) if distance.estimator != "none" else None
        self._tracker = make_tracker(tracker) if tracker.method != "none" else None
        self._beam = BeamStage(self.config.beam, self.config.guard) if self.config.beam.policy != "none" else None

        self._clock = _StageClock()

    @property
    def stage(self) -> str | None:
        """The stage under way, also after it raised; None between frames. For those who watch from another thread."""
        return self._clock.stage

    @property
    def dispatch(self) -> str | None:
        """The instruction set that the native core uses: `baseline`, `avx2` or `avx512`; None with another back end."""
        return self._proposer.dispatch if isinstance(self._proposer, NativeProposer) else None

    def step(
        self, frame: Frame | NDArray[Any], *, now_ns: Callable[[], int] | None = None, faults: Sequence[str] = ()
    ) -> FrameResult:
        """What the stages make of `frame`.

        Args:
            frame: A frame, or a plain grey image (height, width) of uint8 or uint16, taken as frame 0 at time 0.
                Without a camera in it nothing has a range.
            now_ns: The frames' clock, by which the guard sees how old the image is when its command is there; None off
                line, where no time passes. Nothing else knows of it.
            faults: What is known to be wrong around the pipeline, such as frames that did not come; any of it means
                low beam, from which light comes back slowly.

        Raises:
            ValueError: If a plain image is not grey uint8 or uint16.
        """
        if isinstance(frame, np.ndarray):
            frame = Frame(frame, timestamp_ns=0)
        clock = self._clock = _StageClock()
        clock.begin("proposals")
        proposals = self._proposer.propose(frame.image)
        detections: Detections | None = None
        ranges: Ranges | None = None
        tracks: Tracks | None = None
        beam: BeamCommand | None = None
        if self._classifier is not None:
            clock.begin("classifier")
            detections = self._classifier.classify(frame, proposals)
            if self._estimator is not None and frame.camera is not None:
                clock.begin("distance")
                ranges = self._estimator.estimate(frame, detections)
            if self._tracker is not None:
                clock.begin("tracking")
                tracks = self._tracker.update(frame, detections, ranges)
                if self._beam is not None:
                    clock.begin("beam")
                    beam = self._beam.command(frame, tracks, time_ns=now_ns and now_ns(), faults=faults)
        clock.end()
        return FrameResult(frame.frame, frame.timestamp_ns, proposals, detections, clock.stage_ms, ranges, tracks, beam)

    def run(self, frames: Iterable[Frame]) -> Iterator[FrameResult]:
        """The results of `frames`, one by one, in order."""
        for frame in frames:
            yield self.step(frame)

    def reset(self) -> None:
        """Forgets what earlier frames left behind, as at the start of a sequence."""
        for stage in (self._classifier, self._estimator, self._tracker, self._beam):
            if stage is not None:
                stage.reset()


class _StageClock:
    """Takes the time that each stage needs, milliseconds.

    Attributes:
        stage: The one that is under way; None before the first, and after the last.
    """

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}
        self.stage: str | None = None
        self._begun_ns = 0

    def begin(self, stage: str) -> None:
        """The next stage begins, where the one before ends."""
        self.end()
        self.stage = stage

    def end(self) -> None:
        """The stage under way ends."""
        now_ns = time.perf_counter_ns()
        if self.stage is not None:
            self.stage_ms[self.stage] = (now_ns - self._begun_ns) / 1e6
        self.stage, self._begun_ns = None, now_ns
