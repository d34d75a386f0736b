"""`experiment detection-range`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from foreglow.command_line import argument
from foreglow.options import PipelineOptions, ReportOption, SplitOption


def command(
    data: Annotated[
        list[Path], argument("DATA...", "Simulated data sets or splits, best of `simulate --mixture r48`.")
    ],
    out: ReportOption,
    pipeline: PipelineOptions,
    split: SplitOption = "test",
) -> None:
    """Measure at what range vehicles in sight are detected, beside the 400 m and 100 m that UN R48 asks for."""
    from foreglow.datasets import SplitName, split_in
    from foreglow.display.progress import StepProgress
    from foreglow.files import check_each_once
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.detection_range.page import summary_lines, write_report
    from foreglow.lab.studies.detection_range.run import run_experiment
    from foreglow.lab.studies.reproduction.claims import beside_paper

    require_matplotlib()
    roots = [split_in(path, cast("SplitName", split)) for path in data]
    check_each_once(roots, "DATA")
    with StepProgress() as progress:
        views = run_experiment(roots, pipeline.configuration(), progress)
    report = write_report(views, roots, out)
    beside = beside_paper("detection-range", out / "results.json")
    typer.echo("\n".join([*summary_lines(views), *beside, f"look in {report}"]))
