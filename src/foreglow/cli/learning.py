"""`annotate`, `tune`, `train`, `fit-ranges`, `import-weights` and the YOLO commands: what makes a model."""

from __future__ import annotations

import contextlib
import functools
from pathlib import Path
from typing import Annotated, Any

import typer

from foreglow.cli.app import ClusterOption, JobsOption, app, argument, configuration_of, file, folder, yolo

BOXES_HELP = "Boxes of this preset (default: those that `annotate` wrote, else of paper)."


@app.command()
def annotate(
    data: Annotated[Path, argument(metavar="DATA", help="A data set in PVDN's format, or one split of it.")],
    preset: Annotated[str, typer.Option(metavar="paper|baseline", help="Parameters of the boxes.")] = "paper",
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
    split: Annotated[
        list[str] | None, typer.Option(metavar="train|val|test", help="Only this split; repeatable.")
    ] = None,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
    json_file: Annotated[Path | None, file("--json", help="Also write the numbers as JSON.")] = None,
) -> None:
    """Turn key points into labelled boxes, labels/bounding_boxes/*.json, and rate them."""
    import rich

    from foreglow.display.progress import StepProgress
    from foreglow.files import write_json_results
    from foreglow.lab.learning.annotate import annotate_split, splits_to_annotate
    from foreglow.lab.reports.tables import annotation_table
    from foreglow.parallel import workers_at

    workers = workers_at(jobs, cluster)
    configuration = configuration_of(preset, config, None)
    roots = splits_to_annotate(data, tuple(split or ()))
    with contextlib.closing(StepProgress()) as progress:
        made = [annotate_split(one, configuration, preset, workers=workers, progress=progress) for one in roots]
    if json_file is not None:
        numbers = {one.root.name: one.to_json() for one in made}
        write_json_results(json_file, numbers, indent=2)
    rich.print(annotation_table(made, preset if config is None else f"{preset} with {config}"))


@app.command()
def tune(
    data: Annotated[Path, argument(metavar="DATA", help="A data set in PVDN's format: train, and val and test.")],
    trials: Annotated[int, typer.Option(min=1, metavar="N", help="Trials in total, earlier calls included.")] = 200,
    images: Annotated[int, typer.Option(min=1, metavar="N", help="Images of train, spread over its scenes.")] = 600,
    objective: Annotated[str, typer.Option(metavar="q|q-only|light", help="What is minimised.")] = "q",
    space: Annotated[
        str | None, typer.Option(metavar="paper|wide", help="What is varied (default: the objective's own).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="With one job: the same seed, the same trials.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, metavar="N", help="Processes, on one study.")] = 1,
    cluster: ClusterOption = None,
    storage: Annotated[
        str | None,
        typer.Option(metavar="FILE|URL", help="Optuna's journal or database, for many machines (default: in DIR)."),
    ] = None,
    out: Annotated[Path, folder(help="Folder for the results; the same one goes on.")] = Path("tune_output"),
) -> None:
    """Search the parameters of the proposals: on train, chosen on val, reported on test."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.tuning import TuningSettings
    from foreglow.lab.learning.tuning import tune as search
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.reports.tables import tuning_lines
    from foreglow.lab.reports.tuning_page import write_report
    from foreglow.parallel import workers_at

    require_matplotlib()
    settings = TuningSettings(
        num_trials=trials, num_images=images, objective=objective, space=space, seed=seed, storage=storage
    )
    with contextlib.closing(StepProgress()) as progress:
        tuning = search(data, out, settings, progress, workers=workers_at(jobs, cluster))
    typer.echo("\n".join(tuning_lines(tuning)))
    typer.echo(f"look in {write_report(tuning, out)}; use it with --config {out / 'best.toml'}")


@app.command()
def train(
    data: Annotated[list[Path], argument(metavar="DATA...", help="Data sets in PVDN's format, with train and val.")],
    out: Annotated[Path, folder(help="Folder for the model; an interrupted training in it goes on.")],
    recipe: Annotated[
        str, typer.Option(metavar="paper|foreglow", help="How to train, and which network.")
    ] = "foreglow",
    recipe_file: Annotated[Path | None, file(help="TOML whose fields override the recipe.")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, metavar="N", help="Passes over the data, at most.")] = None,
    patience: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop N epochs after the best.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of all that is drawn.")] = None,
    max_negatives: Annotated[
        float | None, typer.Option(min=0.01, metavar="X", help="At most X boxes without light for each with, an epoch.")
    ] = None,
    precision: Annotated[
        str | None, typer.Option(metavar="fp32|bf16", help="bf16 is faster where there is it.")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="Preset of the proposals (default: the recipe's name).")
    ] = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
    device: Annotated[str, typer.Option(metavar="auto|cpu|cuda", help="Where to compute.")] = "auto",
    cache: Annotated[Path | None, folder(help="Where samples are kept (default: in the folder).")] = None,
) -> None:
    """Train a classifier of light artifacts on DATA, and write it as an ONNX model for `run --model`."""
    from foreglow.display.progress import TrainingBar
    from foreglow.lab.learning import recipes
    from foreglow.lab.learning.training_run import train_model
    from foreglow.lab.reports.tables import training_lines
    from foreglow.lab.reports.training_curves import draw_training

    chosen = recipes.recipe(recipe) if recipe_file is None else recipes.read_recipe(recipe_file, recipes.recipe(recipe))
    given: dict[str, Any] = {"epochs": epochs, "patience": patience, "seed": seed, "precision": precision}
    given["max_negatives_per_positive"] = max_negatives
    chosen = recipes.changed(chosen, {name: value for name, value in given.items() if value is not None})
    configuration = configuration_of(preset or recipe, config, None)
    try:
        with contextlib.closing(TrainingBar()) as progress:
            trained = train_model(data, chosen, configuration, out, device=device, cache=cache, progress=progress)
    except KeyboardInterrupt:
        typer.echo(f"{out}: the same command goes on from the last whole epoch", err=True)
        raise
    finally:  # also of a training that was interrupted
        draw_training(out)
    typer.echo("\n".join(training_lines(trained)))


@app.command("fit-ranges")
def fit_ranges(
    data: Annotated[Path, argument(metavar="DATA", help="Simulated drives, with train and val.")],
    out: Annotated[Path, file(help="The model to write, TOML for `distance.model`.")],
    config: Annotated[Path | None, file(help="TOML whose fields override the preset foreglow.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the order of the images.")] = 0,
) -> None:
    """Fit the model of the road-surface ranges to lights whose ranges are known."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.ranges import fit_ranges, write_hypotheses

    with contextlib.closing(StepProgress()) as progress:
        model = fit_ranges(data, configuration_of("foreglow", config, None), seed=seed, progress=progress)
    write_hypotheses(out, model)
    typer.echo(f"wrote {out}: fitted to {model.origin}")


@app.command("import-weights")
def import_weights(
    weights: Annotated[
        Path, argument(metavar="WEIGHTS", help="The published classifier's weights, a plain state dict.")
    ],
    out: Annotated[Path, file(help="The ONNX model to write.")],
    fold: Annotated[
        float | None,
        typer.Option(
            metavar="TOLERANCE", help="Remove channels while no score changes by more than this, such as 1e-3."
        ),
    ] = None,
) -> None:
    """Turn the published PVDN classifier into an ONNX model for `run --model`."""
    from foreglow.lab.learning import import_weights

    model = import_weights(weights, out, fold)
    millions = model.num_multiply_adds / 1e6
    typer.echo(f"wrote {model.path}: {model.num_parameters} parameters, {millions:.1f} million multiply-adds a crop")


@app.command("export-yolo")
def export_yolo(
    data: Annotated[Path, argument(metavar="DATA", help="A data set with train, val and test, such as PVDN/day.")],
    out: Annotated[Path, folder(help="Folder of the YOLO data set.")],
    preset: Annotated[str | None, typer.Option(metavar="NAME", help=BOXES_HELP)] = None,
    size: Annotated[int, typer.Option(min=32, max=4096, help="Side of the square images, pixels.")] = 960,
) -> None:
    """Write the labelled boxes of DATA as a YOLO data set."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import export_yolo

    with contextlib.closing(StepProgress()) as progress:
        told = functools.partial(progress, "images")
        export = export_yolo(data, out, preset_name=preset, size_px=size, progress=told)
    counts = ", ".join(f"{name} {count} ({export.num_boxes[name]} boxes)" for name, count in export.num_images.items())
    typer.echo(f"wrote {export.data_file}: images of {counts}; boxes: {export.settings.boxes}")


@yolo.command("train")
def yolo_train(
    data: Annotated[Path, argument(metavar="DATA", help="A data set, or what export-yolo made of one.")],
    out: Annotated[Path, folder(help="Folder of the run; an interrupted one goes on.")],
    size: Annotated[str, typer.Option(metavar="n|t|s|m|l|x", help="Size of the network; s and x in the paper.")] = "s",
    image_size: Annotated[int, typer.Option(help="Side of the images, a multiple of 32; 960 in the paper.")] = 320,
    epochs: Annotated[int, typer.Option(help="Passes over the training split.")] = 3,
    batch: Annotated[int, typer.Option(help="Images a step.")] = 16,
    seed: Annotated[int, typer.Option(help="Of weights, order and augmentation.")] = 0,
    device: Annotated[str, typer.Option(metavar="auto|cpu|N", help="Where to train; N is a GPU.")] = "auto",
    backend: Annotated[str, typer.Option(metavar="libreyolo|ultralytics", help="Which library.")] = "libreyolo",
    preset: Annotated[str | None, typer.Option(metavar="NAME", help=BOXES_HELP)] = None,
) -> None:
    """Train a YOLO from random weights on the labelled boxes of DATA."""
    from foreglow.config import validated
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import YoloConfig, train_yolo

    fields = {"backend": backend, "size": size, "epochs": epochs, "batch": batch, "seed": seed, "device": device}
    config = validated(YoloConfig, fields | {"image_size_px": image_size}, "yolo train")
    with contextlib.closing(StepProgress()) as progress:
        told = functools.partial(progress, "images exported")
        run = train_yolo(data, out, config, preset_name=preset, progress=told)
    millions, billions = run.num_parameters / 1e6, run.num_multiply_adds / 1e9
    typer.echo(f"wrote {run.weights}: {millions:.2f} million parameters, {billions:.2f} billion multiply-adds an image")


@yolo.command("predict")
def yolo_predict(
    trained: Annotated[Path, argument(metavar="RUN", help="Folder of a finished `yolo train`.")],
    split: Annotated[Path, argument(metavar="SPLIT", help="A PVDN split, such as PVDN/day/val.")],
    out: Annotated[Path, file(help="The predictions to write, JSON for `evaluate --predictions`.")],
) -> None:
    """Write what a trained YOLO finds in a split."""
    from foreglow.datasets import PVDN
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.yolo import predict_yolo, read_yolo_run
    from foreglow.runs.predictions import write_predictions

    with contextlib.closing(StepProgress()) as progress:
        told = functools.partial(progress, "images")
        found = predict_yolo(read_yolo_run(trained), PVDN(split), progress=told)
    write_predictions(out, found.predictions)
    typer.echo(f"wrote {out}: {len(found.frame_ms)} images, {found.frame_ms.mean():.1f} ms an image")
