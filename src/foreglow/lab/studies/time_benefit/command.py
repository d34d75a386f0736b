"""`experiment time-benefit`."""

from __future__ import annotations

from typing import Annotated

import typer

from foreglow.options import PipelineOptions, ReportOption, SplitOptions, option


def command(
    data: SplitOptions,
    out: ReportOption,
    pipeline: PipelineOptions,
    production_category: Annotated[
        int, option("N", "PVDN's image category for the production system's detection.", min=0, max=7)
    ] = 6,
) -> None:
    """Measure how long before a production system and a human the first vehicle of each sequence is detected."""
    from foreglow.datasets import CategoryConfig, ImageCategory, open_labelled
    from foreglow.display.progress import StepProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.time_benefit.page import summary_lines, write_report
    from foreglow.lab.studies.time_benefit.run import run_experiment

    require_matplotlib()
    dataset = open_labelled(data.root())
    categories = CategoryConfig(low_beam_trigger=ImageCategory(production_category))
    with StepProgress() as progress:
        results = run_experiment(dataset, pipeline.configuration(), categories, progress)
    report = write_report(results, out)
    typer.echo("\n".join([*summary_lines(results), f"look in {report}"]))
