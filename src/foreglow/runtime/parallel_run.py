"""An off-line run of the sequences apart, in several processes or on several machines, with the results of `run`."""

from __future__ import annotations

import copy
import dataclasses
import functools
import time
import uuid
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from foreglow.config import PipelineConfig
from foreglow.datasets import FrameSource, how_read, lost_parts, part_names, part_of
from foreglow.files import file_digest
from foreglow.parallel import Parent, Workers
from foreglow.pipeline import Pipeline
from foreglow.provenance import processor_name
from foreglow.runs.folder import OutputFolder, part_sinks
from foreglow.runs.origin import origin_name
from foreglow.runs.summary_file import RunSummary
from foreglow.runs.tally import Tally, model_digest
from foreglow.runtime.run import InterruptFlag, ResultSink, check_readable, step_through
from foreglow.types import Frame, FrameResult
from foreglow.types.arrays import check_callables, check_kind, check_members

REPORT_S = 0.1
"""Time between two reports of a part's progress, seconds."""


@dataclass(frozen=True, slots=True)
class Opening:
    """How to open a source, in any process or on any machine.

    Attributes:
        function: A function or class of a module, which returns the source.
        arguments: Its arguments.

    Raises:
        ValueError: If the function is none, or the arguments are no tuple.
    """

    function: Callable[..., FrameSource]
    arguments: tuple[Hashable, ...]

    def __post_init__(self) -> None:
        check_callables(function=self.function)
        check_kind("arguments", self.arguments, tuple)

    def __call__(self) -> FrameSource:
        """Opens the source."""
        return self.function(*self.arguments)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The existing files and folders among the arguments."""
        return tuple(_paths_in(self.arguments))

    def digests_beside(self) -> tuple[tuple[Path, str], ...]:
        """The files beside the source that its options name, such as calibration, logs and maps, with their digests.

        Raises:
            OSError: If one cannot be read.
        """
        beside = _paths_in(argument for argument in self.arguments if dataclasses.is_dataclass(argument))
        return tuple((path, file_digest(path)) for path in beside if path.is_file())


def _paths_in(arguments: Iterable[object]) -> Iterator[Path]:
    for argument in arguments:
        if dataclasses.is_dataclass(argument) and not isinstance(argument, type):
            yield from _paths_in(getattr(argument, field.name) for field in dataclasses.fields(argument))
        elif isinstance(argument, Path) and argument.exists():
            yield argument


class Watcher(ResultSink, Protocol):
    """A result sink of which each sequence has a copy, made before the first frame."""

    def add(self, other: Self) -> None:
        """Takes over what a copy has of a later sequence."""
        ...


@dataclass(frozen=True, slots=True)
class Part:
    """The run of one sequence.

    Attributes:
        name: Name of its files.
        tally: Counts and run-times of its frames.
        skipped: As `FrameSource.skipped`.
        num_lost_parts: As in `RunSummary`.
        dispatch: As `Pipeline.dispatch`.
        processor: Name of the processor that it ran on.
        watcher: The copy of the run's, if it has one.
    """

    name: str
    tally: Tally
    skipped: tuple[str, ...]
    num_lost_parts: int
    dispatch: str | None
    processor: str
    watcher: Watcher | None = None


def run_apart(
    opening: Opening,
    config: PipelineConfig,
    folder: OutputFolder,
    workers: Workers,
    *,
    progress: Callable[[str, int], None] = lambda *_: None,
    source_name: str = "",
    watcher: Watcher | None = None,
) -> RunSummary:
    """Runs a pipeline over each sequence of a source; `folder` then holds what `run` writes, in the same order.

    `frames.jsonl` and `config.toml` are the same, byte for byte; so is the summary but for run-times and processor.
    After a first Ctrl-C the results so far of every sequence are published; after any error, and after a second Ctrl-C,
    nothing of this run remains.

    Args:
        opening: How each worker opens the source; a source without sequences is run by a single worker.
        config: Configuration of the pipeline.
        folder: Where the results go; every worker writes into it.
        workers: They run the sequences.
        progress: Called with the name of a sequence and the number of its frames that are done.
        source_name: Name of the source in the summary; empty takes its path, or else its own name.
        watcher: Sees all frames as well, and is closed with those of each sequence.

    Raises:
        ChildProcessError: If a sequence cost several processes; the message names it.
        FileNotFoundError: If a worker of a cluster lacks a file.
        ValueError: If an argument is of another kind, a frame is unreadable and the source stops at it, its content is
            unfit, no frame at all can be read, or the file of the model, or one beside the source, changed before all
            workers had opened it.
        OSError: If a result cannot be written; the message names the path.
    """
    check_kind("opening", opening, Opening)
    check_kind("config", config, PipelineConfig)
    check_kind("folder", folder, OutputFolder)
    check_members("workers", workers, "workers, such as foreglow.parallel.Local(jobs)", "each", "num_workers")
    with folder:
        tally, digests = Tally(config), opening.digests_beside()
        source = opening()
        name, parts = source_name or origin_name(source), folder.make_parts()
        sequences = {sequence or source.name: sequence for sequence in part_names(source)}
        work = functools.partial(_run_part, opening, digests, config, tally.model_sha256, parts, watcher)
        paths = (parts, *opening.paths)
        with InterruptFlag() as interrupt:
            done = dict(workers.each(work, sequences, progress, is_stopped=lambda: interrupt.is_set, paths=paths))
            runs = [done[sequence] for sequence in sequences if sequence in done]
            skipped = [line for part in runs for line in part.skipped]
            for part in runs:
                tally.extend(part.tally)
                if watcher is not None and part.watcher is not None:
                    watcher.add(part.watcher)
            check_readable(name, tally.num_frames, skipped)
            folder.join_parts(parts, [part.name for part in runs])
            is_cut = interrupt.is_set
            summary = tally.summary(
                name,
                skipped,
                config,
                is_complete=not is_cut,
                is_interrupted=is_cut,
                dispatch=_each_once([part.dispatch for part in runs]),
                processor=_each_once([part.processor for part in runs]),
                num_lost_parts=sum(part.num_lost_parts for part in runs),
                **how_read(source),
            )
            summary = folder.publish(config, summary)
    if interrupt.is_set and not is_cut:  # too late to leave out a frame
        raise KeyboardInterrupt
    return summary


def _each_once(names: Sequence[str | None]) -> str | None:
    return ", ".join(dict.fromkeys(name for name in names if name is not None)) or None


def _run_part(
    opening: Opening,
    digests: tuple[tuple[Path, str], ...],
    config: PipelineConfig,
    model_sha256: str | None,
    parts: Path,
    watcher: Watcher | None,
    sequence: str,
    parent: Parent,
) -> Part:
    """Runs one sequence; its files in `parts` have a new name, so that those of an earlier attempt do no harm."""
    frames = part_of(_source(opening, digests, parts), sequence)
    pipeline, tally, name = _pipeline(config, model_sha256, parts), Tally(), uuid.uuid4().hex
    own = copy.deepcopy(watcher)
    sinks: list[ResultSink] = [*part_sinks(parts, name), _ProgressSink(parent, sequence)]
    if own is not None:
        sinks.append(own)
    step_through(frames, pipeline, sinks, tally, lambda: parent.is_stopped)
    for sink in sinks:
        sink.close()
    num_lost = len(lost_parts(frames))
    return Part(name, tally, tuple(frames.skipped), num_lost, pipeline.dispatch, processor_name(), own)


@functools.lru_cache(maxsize=1)
def _source(opening: Opening, digests: tuple[tuple[Path, str], ...], parts: Path) -> FrameSource:  # noqa: ARG001
    """The source, opened once in each run and process: a later run may find other files.

    Raises:
        ValueError: If a file beside it has changed since the run was begun: other sequences may have had another one.
    """
    source, found = opening(), dict(opening.digests_beside())
    for path, digest in digests:
        if found.get(path) != digest:
            words = "expected the file that the run was begun with, there is another one now"
            raise ValueError(f"{path}: {words}; repeat the command")
    return source


@functools.lru_cache(maxsize=1)
def _pipeline(config: PipelineConfig, model_sha256: str | None, parts: Path) -> Pipeline:  # noqa: ARG001
    """The pipeline, made once in each run and process, as the file of a model may change; every sequence resets it.

    Raises:
        ValueError: If it has changed since the run was begun: other sequences may have been scored by another model.
    """
    pipeline = Pipeline(config)
    if model_digest(config.classifier.model) != model_sha256:
        words = "expected the model that the run was begun with, there is another one now"
        raise ValueError(f"{config.classifier.model}: {words}; repeat the command")
    return pipeline


class _ProgressSink:
    """A result sink that reports how many frames of a sequence are done."""

    def __init__(self, parent: Parent, sequence: str) -> None:
        self._parent, self._sequence = parent, sequence
        self._num_done = 0
        self._reported_s = time.monotonic()

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Counts one frame."""
        self._num_done += 1
        if time.monotonic() - self._reported_s > REPORT_S:
            self.close()

    def close(self) -> None:
        """Reports the number of frames."""
        self._parent.report_progress(self._sequence, self._num_done)
        self._reported_s = time.monotonic()

    def discard(self) -> None:
        """Reports nothing."""
