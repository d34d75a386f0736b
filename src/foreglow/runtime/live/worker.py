"""The computing thread: takes the newest frame, steps the pipeline, and delivers the result."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from foreglow.config import LiveConfig, PipelineConfig
from foreglow.plugins import described
from foreglow.runtime.live.faults import FaultBook, LiveFault
from foreglow.runtime.live.mailbox import Arrival, Mailbox
from foreglow.runtime.memory import release_memory
from foreglow.runtime.run import Stepper
from foreglow.types import Frame, FrameResult
from foreglow.types.arrays import check_kind, check_members

THREADS = "live "
"""Begins the names of threads that may hang, in a stage, a sink or a camera's driver, and can't be ended then."""

STAGE = "stage"
"""The origin of these faults in the `FaultBook`."""


class LivePipeline(Stepper, Protocol):
    """The part of a `Pipeline` that the live loop uses."""

    @property
    def stage(self) -> str | None:
        """As `Pipeline.stage`."""
        ...

    def step(self, frame: Frame, *, now_ns: Callable[[], int] | None = None, faults: Sequence[str] = ()) -> FrameResult:
        """As `Pipeline.step`."""
        ...


def made_by(make_pipeline: Callable[[], LivePipeline]) -> LivePipeline:
    """The pipeline that `make_pipeline`, a user's function, makes.

    Raises:
        ValueError: If it makes none, or one that commands no beam.
        Exception: What it raised.
    """
    pipeline = make_pipeline()
    check_members(
        "make_pipeline", pipeline, "one that makes a pipeline", "config", "step", "reset", "stage", "dispatch"
    )
    check_kind("make_pipeline: config", pipeline.config, PipelineConfig)
    if not pipeline.config.commands:
        raise ValueError("make_pipeline: expected one that commands a beam, as of `config.commanding()`")
    return pipeline


@dataclass(frozen=True, slots=True)
class Stepped:
    """A frame that a worker has processed.

    Attributes:
        arrival: The frame, and when it arrived.
        begun_ns: When processing began, by the frames' clock.
        result: The stages' result; None if a stage raised an error.
    """

    arrival: Arrival
    begun_ns: int
    result: FrameResult | None


class Worker:
    """A thread with a pipeline of its own.

    Attributes:
        reason: Why a pipeline could not be made, the last time that one could not.
    """

    def __init__(
        self,
        make_pipeline: Callable[[], LivePipeline],
        mailbox: Mailbox,
        book: FaultBook,
        now_ns: Callable[[], int] | None,
        config: LiveConfig,
        deliver: Callable[[Worker, Stepped], None],
    ) -> None:
        """A worker that has not started yet.

        Args:
            make_pipeline: Makes a pipeline; called in the thread, if `start` is given none, or after too many failures.
            mailbox: Where frames come from.
            book: Where faults are reported.
            now_ns: The frames' clock; None for lossless sources, where time does not count.
            config: The limits.
            deliver: Called with each processed frame.
        """
        self._make_pipeline, self._mailbox, self._book = make_pipeline, mailbox, book
        self._now_ns, self._config, self._deliver = now_ns, config, deliver
        self._pipeline: LivePipeline | None = None
        self._num_failures = 0
        self._busy_since_s: float | None = None
        self._making_since_s: float | None = None
        self._missing_since_s: float | None = None
        self.reason = ""
        self._is_stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{THREADS}compute", daemon=True)

    def start(self, pipeline: LivePipeline | None = None) -> None:
        """Starts the thread, with this pipeline or one that it makes itself."""
        self._pipeline = pipeline
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def busy_s(self) -> float:
        """How long the current frame has taken so far; 0 while there is none."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    @property
    def making_s(self) -> float:
        """How long the pipeline under construction has taken so far; 0 while there is none."""
        since_s = self._making_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    @property
    def missing_s(self) -> float:
        """For how long it has tried to make a pipeline, each time in vain; 0 if it has one."""
        since_s = self._missing_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    @property
    def has_pipeline(self) -> bool:
        """Whether it has a pipeline."""
        return self._pipeline is not None

    @property
    def stage(self) -> str:
        """The stage under way, or that a pipeline is being made."""
        pipeline = self._pipeline
        if pipeline is None:
            return "making a pipeline"
        return pipeline.stage or "between the stages"

    def stop(self, timeout_s: float = 0.0) -> None:
        """Stops after the current frame; waits for it, `timeout_s` at most."""
        self._is_stopped.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while not self._is_stopped.is_set():
            if self._pipeline is None and not self._make():
                self._is_stopped.wait(self._config.retry_s)
                continue
            arrival = self._mailbox.take(0.1)
            if arrival is not None:
                self._busy_since_s = time.monotonic()
                stepped = self._step(arrival)
                self._busy_since_s = None
                self._deliver(self, stepped)

    def _make(self) -> bool:
        """Makes the pipeline; returns whether that succeeded."""
        release_memory()  # that of the pipeline before
        self._making_since_s = time.monotonic()
        try:
            self._pipeline = made_by(self._make_pipeline)
            self._missing_since_s = None
        except BaseException as error:  # such as a model file that is being replaced: tried again later
            self.reason = described(error)
            self._missing_since_s = self._missing_since_s or self._making_since_s
            self._book.note(STAGE, [LiveFault.NO_PIPELINE], self.reason)
        finally:
            self._making_since_s = None
        self._num_failures = 0
        return self._pipeline is not None

    def _step(self, arrival: Arrival) -> Stepped:
        pipeline, frame = self._pipeline, arrival.frame
        begun_ns = arrival.arrived_ns if self._now_ns is None else self._now_ns()
        at_ns = frame.timestamp_ns if self._now_ns is None else None
        assert pipeline is not None
        faults = self._book.heeded()
        try:
            result = pipeline.step(frame, now_ns=self._now_ns, faults=faults)
        except BaseException as error:  # of any stage, no signal's: low beam, and the next frame is another chance
            self._book.note(STAGE, [LiveFault.STAGE_FAILED], f"{self.stage}: {described(error)}", at_ns=at_ns)
            self._num_failures += 1
            if self._num_failures >= self._config.max_failures:
                self._pipeline = None
            return Stepped(arrival, begun_ns, None)
        self._num_failures = 0
        self._book.note(STAGE, at_ns=at_ns)
        return Stepped(arrival, begun_ns, result)
