"""`experiment distance`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.options import ReportOption, SplitOption, argument, option

if TYPE_CHECKING:
    from foreglow.datasets import SplitName


def command(
    data: Annotated[Path, argument("DATA", "A simulated data set, or one of its splits.")],
    out: ReportOption,
    split: SplitOption = "test",
    estimators: Annotated[str | None, option("NAME,NAME", "Only these estimators (default: all).")] = None,
    seed: Annotated[int, option("N", "Seed of the confidence intervals.", min=0)] = 1,
) -> None:
    """Measure the error of every estimator of ranges, with every heuristic, on lights whose range is known."""
    from foreglow.display.progress import StepProgress
    from foreglow.distance import ESTIMATORS
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.distance.page import write_report
    from foreglow.lab.studies.distance.run import DistancePlan, run_experiment

    require_matplotlib()
    names = tuple(ESTIMATORS) if estimators is None else tuple(estimators.split(","))
    plan = DistancePlan(split=cast("SplitName", split), estimators=names, seed=seed)
    with StepProgress() as progress:
        results = run_experiment(data, plan, progress)
    typer.echo(f"look in {write_report(results, out)}")
