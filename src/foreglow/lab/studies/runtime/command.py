"""`experiment runtime`."""

from __future__ import annotations

from typing import Annotated

import typer

from foreglow.command_line import option
from foreglow.options import PaperModelOption, PipelineOptions, ReportOption, SplitOptions

NUM_PACED = 1000
"""Of `--frames`, if it is not given."""


def command(
    data: SplitOptions,
    out: ReportOption,
    pipeline: PipelineOptions,
    on: Annotated[
        list[str] | None, option("process|live|node|ros2", "Measure only this; repeatable (default: all four).")
    ] = None,
    paper_model: PaperModelOption = None,
    frames: Annotated[int, option("N", "Number of frames for what runs at the frames' own rate.", min=1)] = NUM_PACED,
) -> None:
    """Measure the run-time of each stage, as in the paper's figure: in process, live, and over a ROS 2 network."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.paper_chain import paper_chain
    from foreglow.lab.studies.reproduction.claims import beside_paper
    from foreglow.lab.studies.runtime.page import summary_lines, write_report
    from foreglow.lab.studies.runtime.run import KINDS, run_experiment

    kinds = on or list(KINDS)
    if paper_model is not None and "process" not in kinds:
        raise ValueError("--paper-model: expected with --on process, as the paper's chain is measured there alone")
    if frames != NUM_PACED and set(kinds) == {"process"}:
        raise ValueError("--frames: expected with --on live, node or ros2; in process all frames are run")
    require_matplotlib()
    root, configuration = data.root(), pipeline.configuration()
    paper = None if paper_model is None else paper_chain(paper_model, configuration.guard.white_level)
    with StepProgress() as progress:
        results = run_experiment(root, configuration, kinds, frames, progress, paper)
    report = write_report(results, out)
    beside = beside_paper("runtime", out / "results.json")
    typer.echo("\n".join([*summary_lines(results), *beside, f"look in {report}"]))
