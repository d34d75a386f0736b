"""Runs of the pipeline over a source, as several commands do them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from foreglow.cli.sinks import progress_sink

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.options import SourceOptions, VehicleOptions
    from foreglow.parallel import Workers
    from foreglow.runtime import Opening, OutputFolder, ResultSink, RunSummary, Stepper


def open_frames(source: Path, reading: SourceOptions, vehicle: VehicleOptions) -> FrameSource:
    """The frames of `source`; workers call it, too."""
    return vehicle.equip(reading.open(source))


def run_frames(
    frames: FrameSource,
    name: str,
    out: Path,
    pipeline: Stepper,
    *,
    make_sinks: Callable[[OutputFolder], Sequence[ResultSink]] = lambda _: (),
    limit: int | None = None,
) -> RunSummary:
    """Runs the pipeline over `frames`, with a progress bar."""
    from foreglow.runtime import OutputFolder, run

    with OutputFolder(out) as folder:
        sinks = [progress_sink(frames, limit), *make_sinks(folder)]
        return run(frames, pipeline, folder, sinks=sinks, limit=limit, source_name=name)


def run_in_parallel(
    opening: Opening, name: str, out: Path, configuration: PipelineConfig, workers: Workers
) -> RunSummary:
    """Runs a pipeline over each sequence on its own, with a progress bar."""
    from foreglow.display.progress import PartsProgress
    from foreglow.runtime import OutputFolder, run_apart

    with PartsProgress(opening().num_frames) as progress:
        return run_apart(opening, configuration, OutputFolder(out), workers, progress=progress, source_name=name)


def finish(summary: RunSummary, out: Path) -> None:
    """Prints what came of a run; exits with 130 if it was interrupted."""
    from foreglow.display.summary_lines import run_lines

    typer.echo("\n".join(run_lines(summary, out)))
    if not summary.is_complete:
        raise typer.Exit(130)
