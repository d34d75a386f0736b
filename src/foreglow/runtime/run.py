"""An off-line run: every frame of a source through the pipeline, and its results into a folder."""

from __future__ import annotations

import itertools
import signal
import threading
from collections.abc import Sequence
from types import FrameType
from typing import Protocol

from foreglow.config import config_to_toml
from foreglow.datasets import FrameSource
from foreglow.runtime.folder import OutputFolder
from foreglow.runtime.records import FrameRecords
from foreglow.runtime.stepper import Stepper
from foreglow.runtime.summary import RunSummary, Tally
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
    """Runs `pipeline` over `source` and writes `frames.jsonl`, `config.toml` and `summary.json` into `folder`, if any.

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
            takers.insert(0, FrameRecords(folder.partial("frames.jsonl")))
        sequence: str | None = None
        with InterruptFlag() as interrupt:
            for frame in itertools.islice(source, limit):
                if frame.sequence != sequence:  # sequences share no time axis
                    pipeline.reset()
                    sequence = frame.sequence
                result = pipeline.step(frame)
                for taker in takers:
                    taker.write(frame, result)
                tally.add(frame, result)
                if interrupt.is_set:
                    break
            if not tally.num_frames and source.skipped:
                raise ValueError(f"{source_name or source.name}: expected a readable frame; {source.skipped[0]}")
            for taker in takers:
                taker.close()
        summary = tally.summary(source_name or source.name, source.skipped, pipeline, is_complete=not interrupt.is_set)
        if folder is not None:
            folder.write_text("config.toml", config_to_toml(pipeline.config))
            folder.write_text("summary.json", summary.to_json())
            folder.publish()
    except BaseException:
        for taker in takers:
            taker.discard()
        if folder is not None:
            folder.discard()
        raise
    return summary
