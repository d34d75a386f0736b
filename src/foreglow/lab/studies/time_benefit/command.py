"""`experiment time-benefit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from foreglow.command_line import argument, listed, option
from foreglow.options import PaperModelOption, PipelineOptions, ReportOption


def command(
    data: Annotated[Path, argument("DATA", "A data set at its full frame rate, or one of its splits.")],
    out: ReportOption,
    pipeline: PipelineOptions,
    split: Annotated[
        str | None,
        option("NAMES", "Splits of a whole data set to measure on together, such as val,test (default: test)."),
    ] = None,
    paper_model: PaperModelOption = None,
    production_category: Annotated[
        int, option("N", "PVDN's image category for the production system's detection.", min=0, max=7)
    ] = 6,
) -> None:
    """Measure how long before a production system and a human the first vehicle of each sequence is detected."""
    from foreglow.datasets import CategoryConfig, ImageCategory, SplitName, open_labelled, split_in
    from foreglow.datasets.pvdn import is_split
    from foreglow.datasets.simulated import has_truth
    from foreglow.display.progress import StepProgress
    from foreglow.files import check_each_once
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.paper_chain import paper_chain
    from foreglow.lab.studies.reproduction.claims import beside_paper
    from foreglow.lab.studies.time_benefit.page import summary_lines, write_report
    from foreglow.lab.studies.time_benefit.run import LEAST_RATE_HZ, run_experiment

    require_matplotlib()
    configuration = pipeline.configuration()
    paper = None if paper_model is None else paper_chain(paper_model, configuration.guard.white_level)
    if split is not None and is_split(data):
        raise ValueError(f"--split: expected a whole data set with it, {data} is a single split")
    folders = [split_in(data, cast("SplitName", name)) for name in listed("--split", split or "test")]
    check_each_once(folders, "--split")
    datasets = [open_labelled(folder) for folder in folders]
    for dataset in datasets:
        if dataset.mean_rate_hz < LEAST_RATE_HZ:
            raise ValueError(
                f"{dataset.root}: rate_hz: expected at least {LEAST_RATE_HZ:g}, as below it five frames take longer "
                f"than a human, got {dataset.mean_rate_hz:.3g} by the times of its images"
            )
    if production_category != CategoryConfig().low_beam_trigger and all(has_truth(each.root) for each in datasets):
        raise ValueError("--production-category: expected with labels as PVDN's; simulated drives say it themselves")
    categories = CategoryConfig(low_beam_trigger=ImageCategory(production_category))
    with StepProgress() as progress:
        results = run_experiment(datasets, configuration, categories, progress, paper)
    report = write_report(results, out)
    beside = beside_paper("time-benefit", out / "results.json")
    typer.echo("\n".join([*summary_lines(results), *beside, f"look in {report}"]))
