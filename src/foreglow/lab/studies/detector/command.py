"""`experiment detector`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.command_line import argument, file, flag, folder, listed, option
from foreglow.options import DeviceOption, PatienceOption, SplitOption, WhiteOption

if TYPE_CHECKING:
    from collections.abc import Mapping

    from foreglow.datasets import SplitName
    from foreglow.lab.studies.detector.rows import DetectorPlan

TrainedOption = Annotated[
    Path | None,
    file("Model for its row of the table, instead of training one: ONNX or a folder of `train`.", metavar="MODEL"),
]
YoloOption = Annotated[
    Path | None, file("Folder of a finished `yolo train` for its row, instead of training one.", metavar="RUN")
]

YOLO_EPOCHS, YOLO_IMAGE_SIZE_PX = 3, 320
"""Of `--yolo-epochs` and `--yolo-image-size`, if they are not given."""


def command(
    data: Annotated[Path, argument("DATA", "A data set with train, val and test.")],
    out: Annotated[Path, folder("Folder for the report; an interrupted experiment in it is continued.")],
    baseline_small_model: TrainedOption = None,
    baseline_model: TrainedOption = None,
    paper_model: TrainedOption = None,
    published: Annotated[Path | None, file("Published weights, converted by `import-weights`.")] = None,
    compact_model: TrainedOption = None,
    our_model: TrainedOption = None,
    yolo_small: YoloOption = None,
    yolo_large: YoloOption = None,
    no_yolo: Annotated[bool, flag("--no-yolo", "Leave out both YOLOs.")] = False,
    no_training: Annotated[bool, flag("--no-training", "Only rows whose model is given.")] = False,
    rows: Annotated[str | None, option("NAME,NAME", "Only these rows (default: all).")] = None,
    epochs_paper: Annotated[int | None, option("N", "At most N epochs of training by recipe paper.", min=1)] = None,
    epochs_ours: Annotated[int | None, option("N", "At most N epochs of training our networks.", min=1)] = None,
    patience: PatienceOption = None,
    yolo_epochs: Annotated[int, option("N", "Number of epochs of the YOLOs.", min=1)] = YOLO_EPOCHS,
    yolo_image_size: Annotated[int, option("PX", "Side of the YOLOs' images, a multiple of 32.")] = (
        YOLO_IMAGE_SIZE_PX
    ),
    seed: Annotated[int, option("N", "Seed of the training and the resampling.", min=0)] = 1,
    split: SplitOption = "test",
    device: DeviceOption = "auto",
    white_level: WhiteOption = None,
) -> None:
    """Make the paper's table of detectors: baseline, paper, ours and YOLO, all measured in the same way."""
    from foreglow.datasets import open_labelled, split_folder
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.training_progress import TrainingBar
    from foreglow.lab.studies.detector.page import pictures, write_report
    from foreglow.lab.studies.detector.rows import ROWS, DetectorPlan, missing_reason
    from foreglow.lab.studies.detector.run import run_experiment
    from foreglow.lab.studies.reproduction.claims import beside_paper
    from foreglow.models import model_path

    given = {
        "baseline-small": baseline_small_model,
        "baseline": baseline_model,
        "paper": paper_model,
        "published": published,
        "compact": compact_model,
        "ours": our_model,
        "yolo-small": yolo_small,
        "yolo-large": yolo_large,
    }
    epochs = {"paper": epochs_paper, "compact": epochs_ours, "foreglow": epochs_ours}
    plan = DetectorPlan(
        rows=tuple(ROWS) if rows is None else listed("--rows", rows),
        given={name: model_path(path) for name, path in given.items() if path is not None},
        split=cast("SplitName", split),
        may_train=not no_training,
        with_yolo=not no_yolo,
        epochs={name: number for name, number in epochs.items() if number is not None},
        patience=patience,
        seed=seed,
        yolo_epochs=yolo_epochs,
        yolo_image_size_px=yolo_image_size,
        device=device,
        white_level=white_level,
    )
    _check_used(
        plan,
        {
            "--epochs-paper": epochs_paper is not None,
            "--epochs-ours": epochs_ours is not None,
            "--patience": patience is not None,
            "--yolo-epochs": yolo_epochs != YOLO_EPOCHS,
            "--yolo-image-size": yolo_image_size != YOLO_IMAGE_SIZE_PX,
        },
    )
    reasons = {name: missing_reason(name, plan) for name in plan.rows}
    if all(reasons.values()):
        name, reason = next(iter(reasons.items()))
        raise ValueError(f"rows: expected one whose model is given or trained, got none: {name}: {reason}")
    with StepProgress() as progress, TrainingBar() as training:

        def show(step: str, num_done: int, num_all: int) -> None:
            training.close()  # one bar at a time; it comes back with the next training
            progress(step, num_done, num_all)

        results = run_experiment(data, out, plan, progress=show, training=training)
    report = write_report(results, pictures(results, open_labelled(split_folder(data, plan.split))), out)
    typer.echo("\n".join([*beside_paper("detector", out / "results.json"), f"look in {report}"]))


def _check_used(plan: DetectorPlan, given: Mapping[str, bool]) -> None:
    """ValueError if an option about training was given, by its name, and no row is trained that it is about."""
    from foreglow.lab.studies.detector.rows import ROWS

    trained = [ROWS[name] for name in plan.rows if plan.may_train and name not in plan.given]
    recipes = {spec.recipe for spec in trained if spec.recipe}
    has_yolo = plan.with_yolo and any(spec.kind == "yolo" for spec in trained)
    is_used = {
        "--epochs-paper": "paper" in recipes,
        "--epochs-ours": bool(recipes - {"paper"}),
        "--patience": bool(recipes),
        "--yolo-epochs": has_yolo,
        "--yolo-image-size": has_yolo,
    }
    for name, is_given in given.items():
        if is_given and not is_used[name]:
            raise ValueError(f"{name}: expected with a row that is trained by it, none is")
