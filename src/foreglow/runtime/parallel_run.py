"""An off-line run whose sequences are run apart, by processes or machines; the results are those of `run`."""

from __future__ import annotations

import functools
import shutil
import time
import uuid
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from foreglow.config import PipelineConfig
from foreglow.datasets import FrameSource, part_names, part_of
from foreglow.files import naming
from foreglow.parallel import Parent, Workers
from foreglow.pipeline import Pipeline
from foreglow.provenance import processor_name
from foreglow.runs.folder import OutputFolder
from foreglow.runs.frame_records import FrameRecords, time_record
from foreglow.runs.summary import RunSummary, Tally
from foreglow.runtime.run import InterruptFlag, check_readable, publish, step_through
from foreglow.types import Frame, FrameResult

TELL_S = 0.1
"""How often a part tells how far it is."""


@dataclass(frozen=True, slots=True)
class Opening:
    """How a source is opened, anywhere.

    Attributes:
        function: A function or class of a module, which returns the source.
        arguments: Of it.
    """

    function: Callable[..., FrameSource]
    arguments: tuple[Hashable, ...]

    def __call__(self) -> FrameSource:
        """The source, opened."""
        return self.function(*self.arguments)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Those among the arguments."""
        return tuple(_paths_in(self.arguments))


def _paths_in(arguments: tuple[Hashable, ...]) -> Iterator[Path]:
    for one in arguments:
        if isinstance(one, tuple):
            yield from _paths_in(one)
        elif isinstance(one, Path) and one.exists():
            yield one


@dataclass(frozen=True, slots=True)
class Part:
    """What came of one sequence.

    Attributes:
        name: What its files are called.
        tally: Of its frames.
        skipped: As `FrameSource.skipped`.
        dispatch: Of the pipeline that ran.
        processor: That it ran on.
    """

    name: str
    tally: Tally
    skipped: tuple[str, ...]
    dispatch: str | None
    processor: str


def run_apart(
    opening: Opening,
    config: PipelineConfig,
    folder: OutputFolder,
    workers: Workers,
    *,
    told: Callable[[str, int], None] = lambda *_: None,
    source_name: str = "",
) -> RunSummary:
    """Runs a pipeline over each sequence of a source; `folder` then holds what `run` writes, in the same order.

    `frames.jsonl` and `config.toml` are the same, byte for byte; so is the summary but for run-times and processor.
    After a first Ctrl-C what is done of every sequence is published; after any error, and after a second Ctrl-C,
    nothing of this run remains.

    Args:
        opening: How each worker opens the source; one that is all of a piece is run by one worker.
        config: Of the pipeline.
        folder: Where the results go; every worker writes into it.
        workers: Who runs.
        told: Called with a sequence's name and how many of its frames are done.
        source_name: What the summary calls the source; empty takes its own name.

    Raises:
        ChildProcessError: If a sequence cost several processes; the message names it.
        FileNotFoundError: If a worker of a cluster lacks a file.
        ValueError: If a frame is unreadable and the source stops at it, its content is unfit, or no frame at all can
            be read.
        OSError: If a result cannot be written; the message names the path.
    """
    try:
        source = opening()
        name, parts = source_name or source.name, folder.parts()
        items = {one or source.name: one for one in part_names(source)}
        work = functools.partial(_run_part, opening, config, parts)
        paths = (parts, *opening.paths)
        with InterruptFlag() as interrupt:
            done = dict(workers.each(work, items, told, is_stopped=lambda: interrupt.is_set, paths=paths))
            found = [done[one] for one in items if one in done]
            tally, skipped = Tally(), [line for part in found for line in part.skipped]
            for part in found:
                tally.extend(part.tally)
            check_readable(name, tally, skipped)
            for result in ("frames.jsonl", "times.jsonl"):
                _join([parts / f"{part.name}.{result}" for part in found], folder.partial(result))
        summary = tally.summary(
            name,
            skipped,
            _Ran(config, _each_once([part.dispatch for part in found])),
            is_complete=not interrupt.is_set,
            processor=_each_once([part.processor for part in found]),
        )
        publish(folder, config, summary)
    except BaseException:
        folder.discard()
        raise
    return summary


@dataclass(slots=True)
class _Ran:
    """What the pipelines were."""

    config: PipelineConfig
    dispatch: str | None


def _each_once(names: Sequence[str | None]) -> str | None:
    return ", ".join(dict.fromkeys(name for name in names if name is not None)) or None


def _join(pieces: Sequence[Path], path: Path) -> None:
    """Writes the pieces to `path`, one after another."""
    with naming(path), path.open("wb") as whole:
        for piece in pieces:
            with piece.open("rb") as file:
                shutil.copyfileobj(file, whole)


def _run_part(opening: Opening, config: PipelineConfig, folder: Path, sequence: str, parent: Parent) -> Part:
    """Runs one sequence; its files have a name of their own in `folder`, whatever an earlier attempt left there."""
    frames = part_of(_source(opening, folder), sequence)
    pipeline, tally, name = _pipeline(config, folder), Tally(), uuid.uuid4().hex
    takers = (
        FrameRecords(folder / f"{name}.frames.jsonl"),
        FrameRecords(folder / f"{name}.times.jsonl", time_record),
        _Teller(parent, sequence),
    )
    step_through(frames, pipeline, takers, tally, lambda: parent.is_stopped)
    for taker in takers:
        taker.close()
    return Part(name, tally, tuple(frames.skipped), pipeline.dispatch, processor_name())


@functools.lru_cache(maxsize=1)
def _source(opening: Opening, run: Path) -> FrameSource:  # noqa: ARG001
    """The source, opened once a run and process: a later run may find other files."""
    return opening()


@functools.lru_cache(maxsize=1)
def _pipeline(config: PipelineConfig, run: Path) -> Pipeline:  # noqa: ARG001
    """Made once a run and process, as a model's file may change; every sequence resets it."""
    return Pipeline(config)


class _Teller:
    """A result sink that tells how many frames of a sequence are done."""

    def __init__(self, parent: Parent, sequence: str) -> None:
        self._parent, self._sequence = parent, sequence
        self._num_done = 0
        self._told_s = time.monotonic()

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Counts one frame."""
        self._num_done += 1
        if time.monotonic() - self._told_s > TELL_S:
            self.close()

    def close(self) -> None:
        """Tells what is done."""
        self._parent.tell(self._sequence, self._num_done)
        self._told_s = time.monotonic()

    def discard(self) -> None:
        """Tells nothing."""
