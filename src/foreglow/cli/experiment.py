"""`experiment`: what `lab.studies` registers, each a command; `reproduce`: every number of the paper beside ours."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.command_line import argument, file, folder, option, with_options
from foreglow.folder_lock import check_folder
from foreglow.lab.studies import STUDIES
from foreglow.options import DeviceOption, PipelineOptions, WorkerOptions

experiment = typer.Typer(no_args_is_help=True, help="Run an experiment: figures, tables and a report in a folder.")
app.add_typer(experiment, name="experiment")

for _name, _module in STUDIES.items():
    experiment.command(_name)(with_options(importlib.import_module(_module).command))


ModelFile = Annotated[Path | None, file("Model for its row of the table, instead of training one.", metavar="MODEL")]
YoloRun = Annotated[Path | None, file("Folder of a finished `yolo train` for its row of the table.", metavar="RUN")]


@app.command()
@with_options
def reproduce(
    data: Annotated[Path, argument("DATA", "PVDN, or simulated drives; test at the full frame rate.")],
    out: Annotated[Path, folder("Folder for the page; what is finished in it is not run again.")],
    pipeline: PipelineOptions,
    work: WorkerOptions,
    baseline_small_model: ModelFile = None,
    baseline_model: ModelFile = None,
    paper_model: ModelFile = None,
    published: Annotated[Path | None, file("Published weights, converted by `import-weights`.")] = None,
    yolo_small: YoloRun = None,
    yolo_large: YoloRun = None,
    epochs: Annotated[
        int | None, option("N", "Epochs of the baseline's and the paper's network (default: the paper's).", min=1)
    ] = None,
    trials: Annotated[int, option("N", "Trials of the search for parameters.", min=1)] = 200,
    images: Annotated[int, option("N", "Images of train that it goes by.", min=1)] = 600,
    scenes: Annotated[
        int, option("N", "Simulated scenes with an oncoming vehicle to drive in closed loop.", min=1)
    ] = 8,
    straight: Annotated[
        list[Path] | None,
        option("DIR", "Drives of `simulate --mixture r48`, for detection by range; repeatable (default: DATA)."),
    ] = None,
    production_category: Annotated[
        int, option("N", "PVDN's image category for the production system's detection.", min=0, max=7)
    ] = 6,
    device: DeviceOption = "auto",
) -> None:
    """Put every table, figure and number of the paper beside ours: one page, and the experiments behind it.

    Exit code 2 means that an experiment was begun and could not be finished; the page says why, and has all others.
    """
    from foreglow.display.progress import StepProgress
    from foreglow.files import check_each_once
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS
    from foreglow.lab.studies.reproduction.page import answers, summary_lines, write_page
    from foreglow.lab.studies.reproduction.plan import MODELS, ReproductionPlan
    from foreglow.lab.studies.reproduction.run import run_experiments

    require_matplotlib()
    check_each_once(straight or (), "--straight")
    for name in EXPERIMENTS:
        check_folder(out / name)
    given = (baseline_small_model, baseline_model, paper_model, published, yolo_small, yolo_large)
    words = {"--preset": pipeline.preset, "--model": pipeline.model, "--config": pipeline.config}
    plan = ReproductionPlan(
        data=data,
        config=pipeline.configuration(),
        pipeline=tuple(str(word) for item in words.items() if item[1] is not None for word in item),
        models={name: path for name, path in zip(MODELS, given, strict=True) if path is not None},
        epochs=epochs,
        trials=trials,
        images=images,
        scenes=scenes,
        straight=tuple(straight or ()),
        device=device,
        production_category=production_category,
    )
    with StepProgress() as progress:
        outcomes = run_experiments(plan, out, workers=work.workers(), progress=progress)
    report = write_page(plan, outcomes, out)
    for name, outcome in outcomes.items():
        if outcome.has_failed:
            typer.echo(f"{name} could not be finished: {outcome.reason}", err=True)
    typer.echo("\n".join([*summary_lines(answers(plan, outcomes)), f"look in {report}"]))
    if any(outcome.has_failed for outcome in outcomes.values()):
        raise typer.Exit(2)
