"""`experiment distance`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.command_line import argument, file, flag, listed, option
from foreglow.options import ReportOption, SourceOptions, SplitOption, VehicleOptions

if TYPE_CHECKING:
    from foreglow.datasets import SplitName


def command(
    data: Annotated[Path, argument("DATA", "A simulated data set or one of its splits; with --boxes any images.")],
    out: ReportOption,
    vehicle: VehicleOptions,
    split: SplitOption = "test",
    estimators: Annotated[str | None, option("NAME,NAME", "Only these estimators (default: all).")] = None,
    seed: Annotated[int, option("N", "Seed of the confidence intervals.", min=0)] = 1,
    all_pixels: Annotated[
        bool, flag("--all-pixels", "Heuristics go by every pixel of a box, as in the paper.")
    ] = False,
    boxes: Annotated[Path | None, file("JSON lines with boxes of light, drawn by hand; needs --depth.")] = None,
    depth: Annotated[Path | None, file("Folder of a LiDAR's depth images, for --boxes.", metavar="DIR")] = None,
) -> None:
    """Measure the error of every estimator of ranges, with every heuristic, on lights whose range is known."""
    from foreglow.config import preset
    from foreglow.display.progress import StepProgress
    from foreglow.distance import ESTIMATORS
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.distance.lights import LidarLights
    from foreglow.lab.studies.distance.page import write_report
    from foreglow.lab.studies.distance.run import DistancePlan, run_experiment
    from foreglow.lab.studies.reproduction.claims import beside_paper

    if (boxes is None) != (depth is None):
        raise ValueError("--boxes and --depth: expected both or none")
    if boxes is None and vehicle != VehicleOptions():
        raise ValueError("--boxes: expected with a calibration or vehicle data; simulated drives bring their own")
    require_matplotlib()
    plan_config = preset("foreglow").changed("distance", all_pixels=all_pixels)
    names = tuple(ESTIMATORS) if estimators is None else listed("--estimators", estimators)
    plan = DistancePlan(split=cast("SplitName", split), estimators=names, seed=seed, config=plan_config)
    source = (
        data if boxes is None or depth is None else LidarLights(vehicle.equip(SourceOptions().open(data)), boxes, depth)
    )
    with StepProgress() as progress:
        results = run_experiment(source, plan, progress)
    report = write_report(results, out)
    typer.echo("\n".join([*beside_paper("distance", out / "results.json"), f"look in {report}"]))
