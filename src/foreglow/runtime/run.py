"""An off-line run: every frame of a source through the pipeline, and its results into a folder."""

from __future__ import annotations

import itertools
import signal
import threading
from collections.abc import Callable, Iterable, Sequence
from types import FrameType
from typing import Protocol

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.datasets import FrameSource
from foreglow.runs.folder import OutputFolder
from foreglow.runs.frame_records import FrameRecords, time_record
from foreglow.runs.summary import RunSummary, Tally
from foreglow.runtime.stepper import Stepper
from foreglow.types import Frame, FrameResult

INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what `kill` and job schedulers send."""


class ResultSink(Protocol):
    """Takes the result of every frame, in order: a file, a video, a progress bar."""

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Takes one frame's result."""
        ...

    def close(self) -> None:
        """Completes what was written; called once, after the last frame, also where the run was interrupted."""
        ...

    def discard(self) -> None:
        """Lets go of everything without completing it; called where the run failed, perhaps after `close`."""
        ...


class InterruptFlag:
    """While entered, the first Ctrl-C only sets a flag, so that the frame at hand is finished; a second one raises.

    A plain `kill` (SIGTERM), as job schedulers send it, counts as Ctrl-C. Does nothing outside the main thread, where
    Python delivers no signals.
    """

    is_set = False

    def __enter__(self) -> InterruptFlag:
        self._is_main = threading.current_thread() is threading.main_thread()
        if self._is_main:
            self._previous = {number: signal.signal(number, self._interrupt) for number in INTERRUPTS}
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_main:
            for number, handler in self._previous.items():
                signal.signal(number, handler)

    def _interrupt(self, _signal: int, _frame: FrameType | None) -> None:
        if self.is_set:
            raise KeyboardInterrupt
        self.is_set = True


def run(
    source: FrameSource,
    pipeline: Stepper,
    folder: OutputFolder | None,
    *,
    sinks: Sequence[ResultSink] = (),
    limit: int | None = None,
    source_name: str = "",
) -> RunSummary:
    """Runs `pipeline` over `source`; writes results, their times, configuration and summary into `folder`, if any.

    After a first Ctrl-C the results so far are completed and published, and the summary says
    `is_complete: false`. After any error, and after a second Ctrl-C, nothing of this run remains and an older
    result in the folder is untouched.

    Args:
        source: The frames.
        pipeline: What makes results of them; it is reset at the start of each sequence.
        folder: Where the results go; sinks that write files write to its `partial` names. None for sinks alone.
        sinks: Further takers of the results.
        limit: Stop after this many frames; None runs all of them.
        source_name: What the summary calls the source; empty takes its own name.

    Raises:
        ValueError: If a frame is unreadable and the source stops at it, its content is unfit, or no frame at all can
            be read.
        OSError: If a result cannot be written; the message names the path.
    """
    tally = Tally()
    takers: list[ResultSink] = list(sinks)
    try:
        if folder is not None:
            takers.insert(0, FrameRecords(folder.partial("times.jsonl"), time_record))
            takers.insert(0, FrameRecords(folder.partial("frames.jsonl")))
        name = source_name or source.name
        with InterruptFlag() as interrupt:
            step_through(itertools.islice(source, limit), pipeline, takers, tally, lambda: interrupt.is_set)
            check_readable(name, tally, source.skipped)
            for taker in takers:
                taker.close()
        summary = tally.summary(name, source.skipped, pipeline, is_complete=not interrupt.is_set)
        if folder is not None:
            publish(folder, pipeline.config, summary)
    except BaseException:
        for taker in takers:
            taker.discard()
        if folder is not None:
            folder.discard()
        raise
    return summary


def step_through(
    frames: Iterable[Frame],
    pipeline: Stepper,
    takers: Sequence[ResultSink],
    tally: Tally,
    is_stopped: Callable[[], bool],
) -> None:
    """Runs the pipeline over the frames until it is stopped, which is asked after each, and hands on the results."""
    sequence: str | None = None
    for frame in frames:
        if frame.sequence != sequence:  # sequences share no time axis
            pipeline.reset()
            sequence = frame.sequence
        result = pipeline.step(frame)
        for taker in takers:
            taker.write(frame, result)
        tally.add(frame, result)
        if is_stopped():
            break


def check_readable(name: str, tally: Tally, skipped: Sequence[str]) -> None:
    """ValueError if all frames of the source called `name` were passed over."""
    if not tally.num_frames and skipped:
        raise ValueError(f"{name}: expected a readable frame; {skipped[0]}")


def publish(folder: OutputFolder, config: PipelineConfig, summary: RunSummary) -> None:
    """Makes the results in `folder` whole, and gives them their names."""
    folder.write_text("config.toml", config_to_toml(config))
    folder.write_text("summary.json", summary.to_json())
    folder.publish()
