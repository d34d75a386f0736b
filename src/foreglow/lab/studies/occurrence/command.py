"""`experiment occurrence`."""

from __future__ import annotations

import typer

from foreglow.options import PipelineOptions, SplitOptions


def command(data: SplitOptions, pipeline: PipelineOptions) -> None:
    """Measure how well it is predicted where and when hidden vehicles come into sight (simulated drives)."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.studies.occurrence.run import report_lines, run_experiment

    root, configuration = data.root(), pipeline.configuration()
    with StepProgress() as progress:
        sightings = run_experiment(root, configuration, progress)
    for line in report_lines(sightings):
        typer.echo(line)
