"""`experiment occurrence`."""

from __future__ import annotations

import typer

from foreglow.options import PipelineOptions, SplitOptions


def command(data: SplitOptions, pipeline: PipelineOptions) -> None:
    """Measure how well it is predicted where and when hidden vehicles come into sight (simulated drives)."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.studies.detector.tables import markdown
    from foreglow.lab.studies.glare.tables import occurrence_table
    from foreglow.lab.studies.occurrence.metrics import lead_scores
    from foreglow.lab.studies.occurrence.run import run_experiment

    root, configuration = data.root(), pipeline.configuration()
    with StepProgress() as progress:
        sightings = run_experiment(root, configuration, progress)
    for _, remark, table in occurrence_table(lead_scores(sightings)):
        typer.echo("\n".join([remark, *markdown(table)]))
