"""`export-yolo` and `yolo`: a YOLO trained on the same boxes, for comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.command_line import argument, file, folder, option, output_file, with_options
from foreglow.own_files import PREDICTIONS

yolo = typer.Typer(no_args_is_help=True, help="Train and run a YOLO on the same boxes, for comparison.")
app.add_typer(yolo, name="yolo")

BoxesOption = Annotated[
    str | None, option("NAME", "Preset of the boxes (default: those `annotate` wrote, else preset paper).", "--preset")
]


@app.command("export-yolo")
@with_options
def export_yolo(
    data: Annotated[Path, argument("DATA", "A data set with train, val and test, such as PVDN/day.")],
    out: Annotated[Path, folder("Folder of the YOLO data set.")],
    preset: BoxesOption = None,
    size: Annotated[int, option("PX", "Side of the square images.", min=32, max=4096)] = 960,
) -> None:
    """Write the labelled boxes of DATA as a YOLO data set."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import export_yolo

    with StepProgress() as progress:
        export = export_yolo(data, out, preset_name=preset, size_px=size, progress=progress.of("images"))
    counts = ", ".join(f"{name} {count} ({export.num_boxes[name]} boxes)" for name, count in export.num_images.items())
    typer.echo(f"wrote {export.data_file}: images of {counts}; boxes: {export.settings.boxes}")


@yolo.command("train")
@with_options
def yolo_train(
    data: Annotated[Path, argument("DATA", "A data set, or what export-yolo made of one.")],
    out: Annotated[Path, folder("Folder of the run; one that was interrupted is continued.")],
    size: Annotated[str, option("n|t|s|m|l|x", "Size of the network; the paper has s and x.")] = "s",
    image_size: Annotated[int, option("PX", "Side of the images, a multiple of 32; the paper has 960.")] = 320,
    epochs: Annotated[int, option("N", "Number of epochs.")] = 3,
    batch: Annotated[int, option("N", "Images per training step.")] = 16,
    seed: Annotated[int, option("N", "Seed of weights, order and augmentation.")] = 0,
    device: Annotated[str, option("auto|cpu|N", "Device to train on; N is the number of a GPU.")] = "auto",
    backend: Annotated[str, option("libreyolo|ultralytics", "Library to train with.")] = "libreyolo",
    weights: Annotated[
        Path | None, file("Weights to start from, such as COCO's; with ultralytics (default: random).")
    ] = None,
    preset: BoxesOption = None,
) -> None:
    """Train a YOLO on the labelled boxes of DATA."""
    from foreglow.config import validated
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import YoloConfig, train_yolo

    fields = {"backend": backend, "size": size, "epochs": epochs, "batch": batch, "seed": seed, "device": device}
    config = validated(YoloConfig, fields | {"image_size_px": image_size, "weights": str(weights or "")}, "yolo train")
    with StepProgress() as progress:
        run = train_yolo(data, out, config, preset_name=preset, progress=progress.of("images exported"))
    millions, billions = run.results.num_parameters / 1e6, run.results.num_multiply_adds / 1e9
    typer.echo(f"wrote {run.weights}: {millions:.2f} million parameters, {billions:.2f} billion multiply-adds an image")


@yolo.command("predict")
@with_options
def yolo_predict(
    trained: Annotated[Path, argument("RUN", "Folder of a finished `yolo train`.")],
    split: Annotated[Path, argument("SPLIT", "A PVDN split, such as PVDN/day/val.")],
    out: Annotated[Path, output_file("The predictions to write, JSON for `evaluate --predictions`.", PREDICTIONS)],
) -> None:
    """Write what a trained YOLO finds in a split."""
    from foreglow.datasets import open_labelled
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import predict_yolo, read_yolo_run
    from foreglow.runs.predictions import write_predictions

    with StepProgress() as progress:
        found = predict_yolo(read_yolo_run(trained), open_labelled(split), progress=progress.of("images"))
    write_predictions(out, found.predictions)
    typer.echo(f"wrote {out}: {len(found.frame_ms)} images, {found.frame_ms.mean():.1f} ms an image")
