"""An off-line run: each frame of a source goes through the pipeline, and the results are written to a folder.

`Replay` takes an earlier run's tracks in place of the stages before the beam.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import re
import signal
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Protocol, TypeVar

from foreglow.beam import BeamStage
from foreglow.config import PipelineConfig
from foreglow.datasets import FrameSource, how_read, lost_parts
from foreglow.datasets.source import also_left_out, check_source
from foreglow.numbers import checked_whole
from foreglow.plugins import staying
from foreglow.runs.folder import OutputFolder
from foreglow.runs.origin import origin_name
from foreglow.runs.summary_file import RunSummary
from foreglow.runs.tally import Tally
from foreglow.types import Frame, FrameResult
from foreglow.types.arrays import check_kind, check_members, check_optional
from foreglow.whole_files import ENDINGS, undisturbed

PATIENCE_S = 2.0
"""Further signals within this time mean the same wish: they don't disturb the tidying up after the first."""


class ResultSink(Protocol):
    """Gets the result of every frame, in order: a file, a video, a progress bar."""

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Takes the result of one frame."""
        ...

    def close(self) -> None:
        """Completes the file; called once after the last frame, also when the run was interrupted."""
        ...

    def discard(self) -> None:
        """Releases everything without completing it; called when the run failed, perhaps after `close`."""
        ...


Sink = TypeVar("Sink", bound=ResultSink)


class KeepingSink:
    """A result sink that keeps the frames for later, such as a recording.

    Attributes:
        is_complete: Whether all frames of the source came, which it may say of itself; set before it is closed.
    """

    is_complete = True

    @property
    @abstractmethod
    def num_kept(self) -> int:
        """Of how many frames the results are on the disk, and stay there."""


class Stepper(Protocol):
    """A `Pipeline`, or a substitute for one such as `Replay`: it is driven through the frames of a run, one by one."""

    config: PipelineConfig

    @property
    def dispatch(self) -> str | None:
        """As `Pipeline.dispatch`."""
        ...

    def step(self, frame: Frame) -> FrameResult:
        """The result of `frame`; a frame of another sequence than the one before it begins anew."""
        ...

    def reset(self) -> None:
        """Has the next frame begin anew, whatever its sequence."""
        ...


class InterruptFlag:
    """In its `with` block a first Ctrl-C only sets a flag, so that the current frame is finished; a second one raises.

    Any of `ENDINGS` counts as Ctrl-C; a second one raises if it is of the same kind, as the end of a session sends
    several kinds at once, and comes later than `patience_s`. SIGHUP stays ignored under `nohup`. Outside the main
    thread, where Python delivers no signals, it does nothing.
    """

    is_set = False
    _first: int | None = None

    def __init__(self, patience_s: float = 0.0) -> None:
        self._patience_s = patience_s

    def __enter__(self) -> InterruptFlag:
        self._is_main = threading.current_thread() is threading.main_thread()
        if self._is_main:
            is_nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            numbers = [number for number in ENDINGS if number != signal.SIGHUP or not is_nohup]
            self._previous = {number: signal.signal(number, self._interrupt) for number in numbers}
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_main:
            for number, handler in self._previous.items():
                signal.signal(number, handler)

    def _interrupt(self, number: int, _frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if self._first is None:
            self._first, self._first_s = number, now_s
        elif number == self._first and now_s - self._first_s >= self._patience_s:
            raise KeyboardInterrupt
        self.is_set = True


def run(
    source: FrameSource,
    pipeline: Stepper,
    folder: OutputFolder | None,
    *,
    sinks: Iterable[ResultSink] = (),
    limit: int | None = None,
    source_name: str = "",
    origin: RunSummary | None = None,
    among: Collection[int] | None = None,
) -> RunSummary:
    """Runs `pipeline` over `source`; writes results, run-times, configuration and summary to `folder`, if any.

    After a first Ctrl-C the results so far are completed and published, and the summary says
    `is_complete: false`. After any error, and after a second Ctrl-C, nothing of this run remains and an older
    result in the folder is untouched.

    Args:
        source: The frames.
        pipeline: It makes the results, and is reset before the first frame.
        folder: Where the results go; sinks that write files write to its `partial` paths. None: only to the sinks.
        sinks: They get the results, too; if they are made one by one, an error discards those that are there.
        limit: Stop after this many frames; None runs all of them.
        source_name: Name of the source in the summary; empty takes its path, or else its own name.
        origin: The earlier run whose results `pipeline` takes; what that lacks, this run lacks, too.
        among: Numbers of the frames to take, where an interrupted run of several jobs did not reach all; None for all.

    Raises:
        ValueError: If an argument is of another kind; if a frame is unreadable and the source stops at it, its content
            is unfit, or no frame at all can be read; with an `origin` also if the source has fewer than `limit` frames.
        OSError: If a result cannot be written; the message names the path.
    """
    check_source("source", source)
    check_members("pipeline", pipeline, "a pipeline", "config", "dispatch", "step", "reset")
    check_optional("folder", folder, OutputFolder)
    check_kind("sinks", sinks, Iterable)
    check_kind("source_name", source_name, str)
    check_optional("origin", origin, RunSummary)
    check_optional("among", among, Collection)
    tally, name = Tally(pipeline.config), source_name or origin_name(source)
    all_sinks: list[ResultSink] = []
    with folder or contextlib.nullcontext(), discarding(all_sinks):
        if folder is not None:
            all_sinks += folder.line_sinks()
        open_each(sinks, all_sinks)
        limit = None if limit is None else checked_whole("limit", limit, 0)
        with InterruptFlag() as interrupt:
            taken = (frame for frame in source if among is None or frame.frame in among)
            step_through(itertools.islice(taken, limit), pipeline, all_sinks, tally, lambda: interrupt.is_set)
            check_readable(name, tally.num_frames, source.skipped)
            if origin is not None and limit is not None and tally.num_frames < limit and not interrupt.is_set:
                reason = also_left_out(source.skipped, origin.skipped)
                raise ValueError(
                    f"{name}: expected the {limit} frames of the run, there are {tally.num_frames} now{reason}"
                )
            is_cut, read = interrupt.is_set, how_read(source)
            is_complete = not is_cut and (origin is None or origin.is_complete)
            num_lost_parts = len(lost_parts(source))
            for sink in all_sinks:
                if isinstance(sink, KeepingSink):
                    sink.is_complete = is_complete and read["source_lack"] is None and not num_lost_parts
                sink.close()
            summary = tally.summary(
                name,
                source.skipped,
                pipeline.config,
                is_complete=is_complete,
                is_interrupted=is_cut,
                dispatch=pipeline.dispatch,
                num_lost_parts=num_lost_parts,
                **read,
            )
            if origin is not None:
                summary = dataclasses.replace(summary, model_sha256=origin.model_sha256)
            if origin is not None and origin.calibration != summary.calibration:
                own = summary.calibration
                summary = dataclasses.replace(summary, calibration=origin.calibration, beam_calibration=own)
            if folder is not None:
                summary = folder.publish(pipeline.config, summary)
    if interrupt.is_set and not is_cut:  # too late to leave out a frame
        raise KeyboardInterrupt
    return summary


@contextlib.contextmanager
def discarding(sinks: Iterable[ResultSink]) -> Iterator[None]:
    """Discards the sinks that are there when its `with` block ends with an error."""
    try:
        yield
    except BaseException:
        with undisturbed():
            for sink in sinks:
                sink.discard()
        raise


def open_each(sinks: Iterable[Sink], opened: list[Sink]) -> None:
    """Adds the sinks, which may be made one by one, to those that are open; a signal waits while one is being made."""
    making = iter(sinks)
    num_before = -1
    while len(opened) != num_before:
        num_before = len(opened)
        with undisturbed():
            for sink in itertools.islice(making, 1):
                check_members("sinks", sink, "result sinks", "write", "close", "discard")
                opened.append(sink)


def step_through(
    frames: Iterable[Frame],
    pipeline: Stepper,
    sinks: Sequence[ResultSink],
    tally: Tally,
    is_stopped: Callable[[], bool],
) -> None:
    """Runs the pipeline over the frames and passes on the results; after each frame it asks whether to stop.

    Raises:
        ValueError: If the source yields something else than frames; if a frame has the number of the one before: what
            is recorded knows frames by their numbers.
    """
    pipeline.reset()
    before: tuple[str, int] | None = None
    for frame in frames:
        check_kind("source", frame, Frame)
        place = frame.sequence, frame.frame
        if place == before:
            raise ValueError(f"frame: expected another number than that of the frame before, got {frame.frame} again")
        before = place
        result = pipeline.step(frame)
        for sink in sinks:
            sink.write(frame, result)
        tally.add(frame, result)
        if is_stopped():
            break


def check_readable(name: str, num_frames: int, skipped: Sequence[str]) -> None:
    """ValueError if all frames of the source called `name` were skipped, so that there are none."""
    if not num_frames and skipped:
        line = skipped[0]
        ends = [found.start() for found in re.finditer(": ", line)]
        end = next((end for end in ends if Path(line[:end]).absolute() == Path(name).absolute()), None)
        reason = line if end is None else line[end + 2 :]  # of the source itself, not of a file in it
        raise ValueError(f"{name}: expected a readable frame; {reason}")


class Replay:
    """Takes the place of a pipeline: it returns the results of an earlier run, each with a new beam command.

    Attributes:
        config: Configuration of the earlier run, but for the beam.
        known: Numbers of the frames that the earlier run had.
    """

    dispatch = None
    """The native core is not used."""

    def __init__(self, config: PipelineConfig, results: Mapping[int, FrameResult], origin: str) -> None:
        """Makes the beam stage.

        Args:
            config: With a beam policy.
            results: By frame, the results of the earlier run, with tracks.
            origin: Name of that run in messages.

        Raises:
            FileNotFoundError: If the file that describes the headlamps is missing.
            ValueError: If it is broken.
        """
        self.config = config
        self.known: Collection[int] = results.keys()
        self._beam = BeamStage(config.beam, config.guard, lit_street=config.lit_street)
        self._results = results
        self._origin = origin
        self._sequence: str | None = None

    def step(self, frame: Frame) -> FrameResult:
        """The earlier result of `frame` with a new beam command; `stage_ms` has the run-time of the beam alone.

        As for a `Pipeline`, a frame of another sequence than the one before it begins anew.

        Raises:
            ValueError: If the earlier run did not have this frame.
        """
        result = self._results.get(frame.frame)
        if result is None or result.tracks is None or result.timestamp_ns != frame.timestamp_ns:
            raise ValueError(
                f"{self._origin}: expected the frames of its source, has no frame {frame.frame} "
                f"at {frame.timestamp_ns / 1e9:.3f} s"
            )
        with staying():
            if frame.sequence != self._sequence:
                self._beam.reset()
                self._sequence = frame.sequence
            before_ns = time.perf_counter_ns()
            beam = self._beam.command(frame, result.tracks)
        stage_ms = {"beam": (time.perf_counter_ns() - before_ns) / 1e6}
        return dataclasses.replace(result, beam=beam, stage_ms=stage_ms)

    def reset(self) -> None:
        """As `Pipeline.reset`."""
        self._sequence = None
