"""The live loop: one thread reads frames, one computes, and the main thread supervises both."""

from __future__ import annotations

import contextlib
import dataclasses
import operator
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from foreglow.config import PipelineConfig
from foreglow.numbers import checked_number, checked_whole
from foreglow.photometry import read_headlamps
from foreglow.plugins import described, words_of
from foreglow.runs.summary_file import LiveSummary
from foreglow.runs.tally import Tally
from foreglow.runtime.health import Health, LiveSink
from foreglow.runtime.live.background import Background
from foreglow.runtime.live.faults import FaultBook, LiveFault
from foreglow.runtime.live.mailbox import Arrival, Mailbox
from foreglow.runtime.live.outlet import LIMIT_S, BeamOutput, Outlet
from foreglow.runtime.live.sources import LiveSource, Paced, check_live_source
from foreglow.runtime.live.watch import CAMERA, FrameWatch
from foreglow.runtime.live.worker import STAGE, THREADS, LivePipeline, Stepped, Worker, made_by
from foreglow.runtime.memory import settled_memory
from foreglow.runtime.run import PATIENCE_S, InterruptFlag, check_readable
from foreglow.types import BeamCommand, Frame
from foreglow.types.arrays import check_callables, check_each, check_kind

LIVE_FAULTS = frozenset(LiveFault)

GUARD, BUS, SINKS = "guard", "bus", "sinks"
"""Further origins of faults. `BUS` causes low beam, too, so that light comes back slowly when the bus does."""

MAX_HUNG = 3
"""When so many pipelines hang, each in a thread that cannot be ended, the program ends and has to be restarted."""

SWITCH_S = 0.0005
"""Interval at which Python switches between threads, in place of 5 ms: the longest wait for another thread's Python."""


_switch_lock = threading.Lock()
_usual_switch_s: list[float] = []
"""For each loop under way the interval before the first of them, which the last one to end restores."""


@contextlib.contextmanager
def quick_switching() -> Iterator[None]:
    """Has Python switch between threads every `SWITCH_S`, while any loop of this process is in such a block."""
    with _switch_lock:
        _usual_switch_s.append(_usual_switch_s[0] if _usual_switch_s else sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        with _switch_lock:
            usual_s = _usual_switch_s.pop()
            if not _usual_switch_s:
                sys.setswitchinterval(usual_s)


class LiveEndedError(TimeoutError):
    """The loop could not go on.

    Attributes:
        summary: What came of the run until then.
    """

    def __init__(self, reason: str, summary: LiveSummary) -> None:
        super().__init__(reason)
        self.summary = summary


class _UnfitError(ValueError):
    """The configuration does not fit the frames, so that no later frame is another chance."""


ASLEEP_S = 0.5
"""When the watching thread itself was late by this, the whole process had stopped: time that no stage has used."""

MAX_PAUSE_S = 0.1
"""Longest pause of the watching thread, however slowly a recording is replayed: Ctrl-C is heeded after it."""

HEALTH_S = 1.0
"""Interval of health reports, besides those for changes of the faults."""


class LiveLoop:
    """Runs a pipeline on frames in real time. Any fault is recorded and means low beam until its cause is over.

    A newer frame replaces one that waits. Commands are sent to the lamps at once; sinks run in threads of their own.
    """

    def __init__(
        self,
        source: LiveSource,
        make_pipeline: Callable[[], LivePipeline],
        config: PipelineConfig,
        *,
        outputs: Sequence[BeamOutput] = (),
        sinks: Sequence[LiveSink] = (),
        beat: Callable[[], None] = lambda: None,
        at_begin: Callable[[], None] = lambda: None,
        at_end: Callable[[], None] = lambda: None,
        give_up_s: float | None = None,
    ) -> None:
        """A loop that can be run once.

        Args:
            source: The frames.
            make_pipeline: Makes a pipeline with a beam policy; also called in the computing thread.
            config: The configuration.
            outputs: Where commands are sent.
            sinks: Where results and health reports are written.
            beat: Called several times a frame period while the loop runs: for an external watchdog.
            at_begin: Called when a signal ends the loop in order from now on; what is raised before discards the sinks.
            at_end: Called before threads are ended and sinks completed, which may take long and is without beats.
            give_up_s: End after so long without a frame; None waits for ever.

        Raises:
            ValueError: If the lamps' description is broken, or an argument is of another kind.
        """
        check_live_source("source", source)
        check_kind("config", config, PipelineConfig)
        check_each("outputs", outputs, "connections to the lamps", "send", "close")
        check_each("sinks", sinks, "live sinks", "write", "write_health", "close", "discard")
        check_callables(make_pipeline=make_pipeline, beat=beat, at_begin=at_begin, at_end=at_end)
        if give_up_s is not None and not checked_number("give_up_s", give_up_s) > 0:
            raise ValueError(f"give_up_s: expected a positive number of seconds or None, got {give_up_s}")
        self._source, self._config, self._proposals = source, config.live, config.proposals
        self._make_pipeline, self._outputs, self._beat = make_pipeline, outputs, beat
        self._at_begin, self._at_end, self._give_up_s = at_begin, at_end, give_up_s
        self._period_s = 1.0 / float(source.rate_hz or config.live.rate_hz)  # by the frames' clock
        self._wait_s = self._period_s / (1.0 if source.is_lossless else float(source.speed))
        # With a lossless source, which waits for the computation, a slow machine is no fault.
        self._max_step_s = float(source.max_silence_s or 0.0) if source.is_lossless else config.live.max_step_s
        self._num_leds = read_headlamps(config.beam.headlamps).num_leds
        self._told_ns = (0, time.monotonic_ns())  # the source's clock, and when it was asked
        self._book = FaultBook(self._now_ns, (CAMERA, STAGE, BUS))
        self._mailbox = Mailbox(is_lossless=source.is_lossless)
        self._sinks = [Background(sink, is_lossless=source.is_lossless) for sink in sinks]
        self._tally = Tally()
        self._is_stopped = threading.Event()
        self._has_ended = threading.Event()
        self._error: BaseException | None = None
        self._limit: int | None = None
        self._is_ended = False
        self._lock = threading.RLock()
        self._num_taken = self._num_hung = self._num_late = self._num_out_of_order = 0
        self._beam: BeamCommand | None = None
        self._low_s = self._health_s = -1.0
        self._reported: tuple[tuple[str, ...], str, bool, bool] = ((), "", False, False)
        self._end = ""

    def run(self, limit: int | None = None) -> LiveSummary:
        """Runs until the source ends, Ctrl-C, or `limit` frames; then closes the sinks, with the lamps in low beam.

        SIGTERM, and SIGHUP but under `nohup`, count as Ctrl-C. In a thread other than the main one no signal ends it.

        Raises:
            LiveEndedError: If `MAX_HUNG` pipelines hang, none can be made for `rebuild_s`, no frame came for
                `give_up_s`, or a source that is no camera cannot be read any further, whatever it raised (its cause);
                it has the summary.
            ValueError: If `limit` is no count; if the pipeline is none, or commands no beam; if a source has frames,
                and none of them can be read, or the first one is too small for the configured region.
            Exception: What `make_pipeline` raised, or a source that is no camera before the first result.
        """
        self._limit = None if limit is None else checked_whole("limit", limit, 0)
        with contextlib.ExitStack() as ending:
            try:
                pipeline, reader = self._start()
                interrupt = ending.enter_context(InterruptFlag(PATIENCE_S))
                self._at_begin()
            except BaseException:
                for sink in self._sinks:
                    sink.discard()
                raise
            ending.enter_context(quick_switching())
            ending.enter_context(settled_memory())
            is_interrupted = True
            try:
                while not (interrupt.is_set or self._is_over or self._end):
                    self._supervise()
                    self._is_stopped.wait(min(self._wait_s / 4, MAX_PAUSE_S))
                is_interrupted = interrupt.is_set
            finally:
                self._stop(reader, is_interrupted=is_interrupted)
            if self._error is not None and not self._tally.num_frames:
                raise self._error
            if not self._mailbox.num_put:
                check_readable(self._source.name, self._tally.num_frames, self._source.skipped)
            summary = self._summary(pipeline, is_interrupted=is_interrupted)
        if self._error is not None:
            raise LiveEndedError(words_of(self._error), summary) from self._error
        if self._end:
            raise LiveEndedError(self._end, summary)
        return summary

    def _start(self) -> tuple[LivePipeline, threading.Thread]:
        """Makes the pipeline, and starts the threads, of which it returns the one that reads."""
        pipeline = made_by(self._make_pipeline)
        self._tally = Tally(pipeline.config)
        self._watch = FrameWatch(
            self._config,
            self._period_s,
            self._book,
            speed=float(self._source.speed),
            max_silence_s=self._source.max_silence_s,
        )
        limit_s = float(self._source.max_silence_s or LIMIT_S) if self._source.is_lossless else LIMIT_S
        self._outlets = [Outlet(output, limit_s) for output in self._outputs]
        self._worker = self._new_worker(pipeline)
        reader = threading.Thread(target=self._read, name=f"{THREADS}read", daemon=True)
        reader.start()
        self._watched_s = self._woken_s = time.monotonic()
        return pipeline, reader

    def _summary(self, pipeline: LivePipeline, *, is_interrupted: bool) -> LiveSummary:
        replay = self._source if isinstance(self._source, Paced) else None
        run = self._tally.summary(
            self._source.name,
            self._source.skipped,
            pipeline.config,
            is_complete=not (is_interrupted or self._end or self._error is not None),
            is_interrupted=is_interrupted,
            dispatch=pipeline.dispatch,
            num_lost_parts=len(replay.lost_parts) if replay is not None else 0,
            **(replay.how_read if replay is not None else {}),
        )
        return LiveSummary(
            run=run,
            num_dropped=self._mailbox.num_dropped,
            num_late=self._num_late,
            num_out_of_order=self._num_out_of_order,
            num_unrecorded=sum(sink.num_lost for sink in self._sinks),
            sink_errors=[sink.words for sink in self._sinks if sink.error is not None],
            fault_counts=dict(self._book.counts.most_common()),
            faults=tuple(self._book.events),
        )

    @property
    def _is_enough(self) -> bool:
        """Whether as many frames are done as were wanted."""
        return self._limit is not None and self._tally.num_frames >= self._limit

    @property
    def _is_over(self) -> bool:
        """Whether all frames are done, or enough of them."""
        num_left = self._mailbox.num_put - self._mailbox.num_dropped - self._num_taken
        return self._is_enough or (self._has_ended.is_set() and num_left <= 0)

    def _stop(self, reader: threading.Thread, *, is_interrupted: bool) -> None:
        """Ends the threads, completes the sinks, and leaves the lamps in low beam.

        A camera has no end, so that a recording of one that is interrupted lacks nothing.
        """
        self._at_end()
        self._is_stopped.set()
        self._mailbox.close()
        self._worker.stop(self._config.abandon_s)
        reader.join(self._config.abandon_s)  # a camera may block it for longer
        with self._lock:
            self._is_ended = True
            if self._beam is not None:
                self._send(BeamCommand.low(self._now_ns(), self._num_leds))
        errors = [error for outlet in self._outlets if (error := outlet.close())]
        if errors:
            self._note_bus(errors)
        lack = self._source.how_read["source_lack"] if isinstance(self._source, Paced) else None
        is_cut = bool(self._end) or self._error is not None or (is_interrupted and not self._source.is_endless)
        for sink in self._sinks:
            sink.close(is_complete=not is_cut and lack is None)

    def _read(self) -> None:
        """Reads frames until there are no more; runs in the reading thread."""
        while not self._is_stopped.is_set():
            try:
                for frame in self._source:
                    if self._is_stopped.is_set():
                        return
                    if not isinstance(frame, Frame):
                        raise ValueError(f"{self._source.name}: expected a Frame, got {type(frame).__name__}")
                    if not self._mailbox.num_put:
                        self._check_fit(frame)
                    if self._watch.arrived(frame):
                        self._mailbox.put(Arrival(frame, self._now_ns()))
                    else:
                        self._num_out_of_order += 1
                        self._command_low()
                reason = "the source has ended"
            except BaseException as error:  # no signal's, as this is not the main thread
                reason = described(error)
                if not self._source.is_endless or isinstance(error, _UnfitError):
                    self._watch.lost(reason)
                    self._error = error
            if not self._source.is_endless or self._error is not None:
                self._has_ended.set()
                return
            self._watch.lost(reason)
            self._is_stopped.wait(self._config.retry_s)

    def _now_ns(self) -> int:
        """The source's clock; where it fails, the loop ends, and until then time goes on from what it told last."""
        try:
            now_ns = operator.index(self._source.now_ns())
        except Exception as error:  # own sources raise what they like
            wrong = isinstance(error, TypeError)
            words = f"{self._source.name}: now_ns: expected nanoseconds as a whole number: {words_of(error)}"
            self._error = self._error or (ValueError(words) if wrong else error)
            self._has_ended.set()
            told_ns, then_ns = self._told_ns
            return told_ns + time.monotonic_ns() - then_ns
        self._told_ns = now_ns, time.monotonic_ns()
        return now_ns

    def _check_fit(self, frame: Frame) -> None:
        """Raises if no frame of this size can be worked with: nothing that may pass, as what a stage raises."""
        try:
            self._proposals.check_region(frame.height_px, frame.width_px)
        except ValueError as error:
            raise _UnfitError(words_of(error)) from None

    def _supervise(self) -> None:
        """Checks both threads; commands low beam if frames are missing or a stage hangs."""
        now_s = time.monotonic()
        if now_s - self._watched_s > self._wait_s + ASLEEP_S:
            self._woken_s = now_s
        self._watched_s = now_s
        awake_s = now_s - self._woken_s
        is_silent = not self._has_ended.is_set() and self._watch.listen()
        is_hanging = self._worker.busy_s > self._max_step_s
        if is_hanging:
            self._book.note(STAGE, [LiveFault.STAGE_HANGS], self._worker.stage)
        if self._worker.making_s > self._config.abandon_s:
            self._book.note(STAGE, [LiveFault.NO_PIPELINE], self._worker.stage)
        is_stuck = min(self._worker.busy_s, awake_s) > self._max_step_s + self._config.abandon_s
        is_stuck |= min(self._worker.making_s, awake_s) > self._config.rebuild_s
        if is_stuck or not self._worker.is_alive:
            self._abandon()
        is_waiting = is_silent or is_hanging or not self._worker.has_pipeline
        if is_waiting and now_s - self._low_s >= self._wait_s:
            self._low_s = now_s
            self._command_low()
        self._note_sinks()
        beam = self._beam  # with a fault that is over already it says so until the next frame's
        present = (*self._book.present, beam is not None and bool(beam.faults), self._is_timed)
        if now_s - self._health_s >= HEALTH_S or present != self._reported:
            self._health_s, self._reported = now_s, present
            self._report_health()
        self._give_up(awake_s)
        if min(self._worker.missing_s, awake_s) > self._config.rebuild_s:
            self._end = f"no pipeline for {self._config.rebuild_s:g} s: {self._worker.reason}; start again"
        self._beat()

    def _give_up(self, awake_s: float) -> None:
        silent_s = min(self._watch.silent_s, awake_s)
        if self._give_up_s is not None and not self._has_ended.is_set() and silent_s > self._give_up_s:
            reason = self._watch.reason or "it is silent, or its frames' times stand still"
            self._end = f"{self._source.name}: no frame for {self._give_up_s:g} s: {reason}"

    def _abandon(self) -> None:
        """Abandons a worker that hangs or has died, and starts a new one unless too many have hung."""
        self._num_hung += 1
        if self._num_hung >= MAX_HUNG:
            self._end = f"{self._worker.stage}: hung {self._num_hung} times; start again"
            return
        with self._lock:
            self._worker.stop()
            self._num_taken += self._worker.has_pipeline  # else it had no frame
            self._book.note(STAGE, [LiveFault.NO_PIPELINE], f"the previous one hangs in {self._worker.stage}")
            self._worker = self._new_worker()

    def _new_worker(self, pipeline: LivePipeline | None = None) -> Worker:
        now_ns = None if self._source.is_lossless else self._now_ns
        worker = Worker(self._make_pipeline, self._mailbox, self._book, now_ns, self._config, self._deliver)
        worker.start(pipeline)
        return worker

    def _deliver(self, worker: Worker, stepped: Stepped) -> None:
        """Sends a frame's command, then passes its result to the sinks; runs in the computing thread."""
        frame, result = stepped.arrival.frame, stepped.result
        ready_ns = time.monotonic_ns()
        with self._lock:  # for which it may have to wait while low beam is sent
            if worker is not self._worker or self._is_ended or self._is_enough:
                return
            self._num_taken += 1
            beam, faults = None if result is None else result.beam, self._book.unheeded
            if beam is not None:  # else nobody judged, and what the guard found last goes on
                # Without a loss the reader, by which the clock goes, may be some frames ahead.
                at_ns = frame.timestamp_ns if self._source.is_lossless else None
                self._book.note(GUARD, [name for name in beam.faults if name not in LIVE_FAULTS], at_ns=at_ns)
            if beam is None or faults:  # a stage failed, or a fault appeared meanwhile
                found = () if beam is None else beam.faults
                beam = BeamCommand.low(frame.timestamp_ns, self._num_leds, *dict.fromkeys([*faults, *found]))
            self._send(beam)
            sent_ns = time.monotonic_ns()
        age_ns = 0 if self._source.is_lossless else self._now_ns() - frame.timestamp_ns
        if result is None:
            return
        clock_to_ms = 1e6 * float(self._source.speed)  # of a replay's clock, which may run faster than time
        stage_ms = {
            "capture": (stepped.arrival.arrived_ns - frame.timestamp_ns) / clock_to_ms,
            "queue": (stepped.begun_ns - stepped.arrival.arrived_ns) / clock_to_ms,
            **result.stage_ms,
            "send": (sent_ns - ready_ns) / 1e6,
        }
        result = dataclasses.replace(result, beam=beam, stage_ms=stage_ms)
        self._tally.add(frame, result)
        self._num_late += age_ns > self._period_s * 1e9
        for sink in self._sinks:
            sink.write(frame, result)

    def _command_low(self) -> None:
        with self._lock:
            self._send(BeamCommand.low(self._now_ns(), self._num_leds, *self._book.active))

    def _send(self, command: BeamCommand) -> None:
        self._beam = command
        for outlet in self._outlets:  # all at once: one that hangs keeps no other waiting
            outlet.begin(command)
        self._note_bus([error for outlet in self._outlets if (error := outlet.outcome())])

    def _note_bus(self, errors: Sequence[str]) -> None:
        self._book.note(BUS, [LiveFault.BUS] if errors else [], "; ".join(errors))

    def _note_sinks(self) -> None:
        behind = [sink.words for sink in self._sinks if sink.is_behind]
        self._book.note(SINKS, [LiveFault.NOT_RECORDED] if behind else [], "; ".join(behind))

    @property
    def _is_timed(self) -> bool:
        """Whether the source's clock has begun: that of a replay does with its first frame."""
        return self._source.is_endless or self._mailbox.num_put > 0

    def _report_health(self) -> None:
        health = Health(
            self._now_ns(),
            self._reported[0],
            self._tally.num_frames,
            self._mailbox.num_dropped,
            self._num_late,
            self._beam,
            self._reported[1],
            is_timed=self._is_timed,
        )
        for sink in self._sinks:
            sink.write_health(health)
