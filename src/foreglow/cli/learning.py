"""`annotate`, `tune`, `train`, `fit-ranges` and `import-weights`: what makes a model."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import BY_OPTION, say_bits_of
from foreglow.command_line import argument, file, folder, option, output_file, shared_folder, with_options
from foreglow.folder_lock import locked
from foreglow.options import (
    ConfigOption,
    DeviceOption,
    PatienceOption,
    PipelineOptions,
    WhiteOption,
    WorkerOptions,
    check_boxes,
)
from foreglow.outputs import check_outputs
from foreglow.own_files import ANNOTATION, MODEL, RANGE_MODEL

if TYPE_CHECKING:
    from rich.table import Table

    from foreglow.lab.learning.annotation import Annotation
    from foreglow.lab.learning.fine_tuning import Judged
    from foreglow.lab.learning.model_import import StartingPoint
    from foreglow.lab.learning.tuning import Tuning


@app.command()
@with_options
def annotate(
    data: Annotated[Path, argument("DATA", "A data set in PVDN's format, or one of its splits.")],
    work: WorkerOptions,
    preset: Annotated[str, option("paper|baseline", "Preset of the proposals.")] = "paper",
    config: ConfigOption = None,
    split: Annotated[list[str] | None, option("train|val|test", "Only this split; repeatable.")] = None,
    json_file: Annotated[Path | None, output_file("Also write the numbers as JSON.", ANNOTATION, "--json")] = None,
) -> None:
    """Make labelled boxes of the key points, labels/bounding_boxes/*.json, and rate them."""
    import rich

    from foreglow.display.progress import StepProgress
    from foreglow.display.summary_lines import counted
    from foreglow.files import check_each_once, write_json_results
    from foreglow.lab.learning.annotation import annotate_split, check_boxes, splits_to_annotate

    workers = work.workers()
    configuration = PipelineOptions(preset=preset, config=config).configuration()
    check_each_once(split or (), "--split")
    roots = splits_to_annotate(data, tuple(split or ()))
    say_bits_of(roots, configuration.guard.white_level)
    annotations: list[Annotation] = []
    done: dict[Path, tuple[int, int]] = {}
    try:
        with locked({str(root): root / "labels" for root in roots}), StepProgress() as progress:
            for root in roots:
                check_boxes(root)
            for root in roots:

                def tell(task: str, num_done: int, num_all: int, root: Path = root) -> None:
                    done[root] = num_done, num_all
                    progress(task, num_done, num_all)

                annotations.append(annotate_split(root, configuration, preset, workers=workers, progress=tell))
    except BaseException as error:
        _tell_part(done, error)
        raise
    if json_file is not None:
        numbers = {annotation.root.name: annotation.to_json() for annotation in annotations}
        write_json_results(json_file, numbers, indent=2)
    rich.print(_annotation_table(annotations, preset if config is None else f"{preset} with {config}"))
    for each in annotations:
        if each.num_outside:
            points = counted(each.num_outside, "key point")
            typer.echo(f"{each.root}: outside the image, so that no box holds them: {points}")


def _tell_part(done: Mapping[Path, tuple[int, int]], error: BaseException) -> None:
    """A line for each split, by its folder, of which a part of the images is done: how many, and of how many.

    On stderr after an interrupt; beside an error, which is the only complaint there, on stdout.
    """
    for root, (num_done, num_all) in done.items():
        if 0 < num_done < num_all:
            told = f"a part is written, finished sequences with {num_done} of {num_all} images"
            words = f"{root / 'labels' / 'bounding_boxes'}: {told}; the same command continues from there"
            typer.echo(words, err=isinstance(error, KeyboardInterrupt))


def _annotation_table(annotations: Sequence[Annotation], parameters: str) -> Table:
    """The generated boxes, and how well the positive ones explain the key points: one column per split."""
    from rich.table import Table

    from foreglow.lab.reports.page import number

    caption = "P, R, F, q: of the positive boxes, the most that a classifier of these boxes can reach"
    table = Table("", title=f"boxes of {parameters}", caption=caption, title_justify="left", caption_justify="left")
    for split in annotations:
        table.add_column(split.root.resolve().name, justify="right")
    table.add_row("images", *(str(split.num_images) for split in annotations))
    table.add_row("boxes", *(str(split.num_boxes) for split in annotations))
    table.add_row("boxes an image", *(number(split.boxes_per_image, 4) for split in annotations))
    table.add_row("positive boxes", *(str(split.num_positive) for split in annotations))
    table.add_row("left out: doubtful light only", *(str(split.num_ignored) for split in annotations), end_section=True)
    for label, name in (("P", "precision"), ("R", "recall"), ("F", "f1"), ("q", "q")):
        table.add_row(label, *(number(getattr(split.quality, name), 4) for split in annotations))
    for label, name in (("q_K", "q_k"), ("q_B", "q_b")):
        pairs = ((getattr(split.quality, name), getattr(split.quality, f"{name}_std")) for split in annotations)
        table.add_row(label, *(f"{number(mean, 4)} ± {number(spread, 4)}" for mean, spread in pairs))
    return table


@app.command()
@with_options
def tune(
    data: Annotated[Path, argument("DATA", "A data set in PVDN's format with train, and perhaps val and test.")],
    work: WorkerOptions,
    trials: Annotated[int, option("N", "Total number of trials, including those of earlier calls.", min=1)] = 200,
    images: Annotated[int, option("N", "Number of images of train, spread over its scenes.", min=1)] = 600,
    objective: Annotated[str, option("q|q-only|light", "What to minimise.")] = "q",
    space: Annotated[str | None, option("paper|wide", "Parameters to vary (default: those of the objective).")] = None,
    seed: Annotated[int, option("N", "Seed of the search; with one job it repeats the same trials.", min=0)] = 0,
    white_level: WhiteOption = None,
    storage: Annotated[
        str | None, option("FILE|URL", "Optuna's journal or database, for many machines (default: in DIR).")
    ] = None,
    out: Annotated[Path, folder("Folder for the results; a search that was interrupted in it is continued.")] = Path(
        "tune_output"
    ),
) -> None:
    """Search the best parameters of the proposals: trials on train, choice on val, report on test."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.tuning import TuningSettings
    from foreglow.lab.learning.tuning import tune as search
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.reports.tuning_page import write_report
    from foreglow.lab.studies.reproduction.claims import beside_paper

    require_matplotlib()
    if storage is not None and "://" not in storage:
        check_outputs({"DATA": data}, {"--storage": Path(storage)}, {})
    settings = TuningSettings(trials, images, objective, space, seed, storage=storage, white_level=white_level)
    say_bits_of([data], white_level, BY_OPTION)
    with StepProgress() as progress:
        tuning = search(data, out, settings, progress, workers=work.workers())
    report = write_report(tuning, out)
    typer.echo("\n".join([*_tuning_lines(tuning), *beside_paper("tune", out / "summary.json")]))
    typer.echo(f"look in {report}; use it with --config {out / 'best.toml'}")


def _tuning_lines(tuning: Tuning) -> list[str]:
    """What came of a parameter search, compared with the paper's parameters."""
    from foreglow.display.summary_lines import counted
    from foreglow.lab.reports.page import number

    chosen, paper = tuning.chosen, tuning.paper
    num_pruned = sum(trial.state == "PRUNED" for trial in tuning.trials)
    papers = paper.config.model_dump()
    changes = ", ".join(
        f"{name} {value}" for name, value in chosen.config.model_dump().items() if value != papers[name]
    )
    lines = [
        f"{counted(len(tuning.trials), 'trial')} ({num_pruned} ended early), objective {tuning.settings.objective}; "
        f"the trials of this call took {tuning.seconds['trials']:.0f} s",
        f"chosen: {changes}" if changes else "chosen: the paper's parameters",
    ]
    for split in ("train", "val", "test"):
        found, beside = getattr(chosen, split), getattr(paper, split)
        if found is not None:
            names = {"q": "q", "recall": "R", "boxes_per_image": "boxes an image"}
            mine, its = ({name: number(each.figures[name], 3) for name in names} for each in (found, beside))
            parts = (f"{label} {mine[name]} (paper {its[name]})" for name, label in names.items())
            lines.append(f"{split}: {', '.join(parts)}")
    return lines


@app.command()
@with_options
def train(
    data: Annotated[
        list[Path], argument("DATA...", "Data sets in PVDN's format, with train and val; or single splits to train on.")
    ],
    out: Annotated[Path, folder("Folder for the model; a training that was interrupted in it is continued.")],
    from_: Annotated[
        Path | None,
        option("foreglow|FILE", "Go on from this model, in minutes, with old samples mixed in.", "--from"),
    ] = None,
    mix: Annotated[
        list[Path] | None,
        file("With --from: drives to mix in instead of the samples that ship; repeatable.", "--mix", metavar="DATA"),
    ] = None,
    teacher: Annotated[
        list[Path] | None,
        file("Model that the new one also learns from; of several, their mean; repeatable.", "--teacher"),
    ] = None,
    recipe: Annotated[
        str | None,
        option(
            "NAME",
            "How to train: paper, compact, related or foreglow (default: foreglow, or as with --from).",
        ),
    ] = None,
    recipe_file: Annotated[Path | None, file("TOML file whose fields override the recipe.")] = None,
    epochs: Annotated[int | None, option("N", "Train for at most N epochs.", min=1)] = None,
    patience: PatienceOption = None,
    seed: Annotated[int | None, option("N", "Seed of weights, order and augmentation.", min=0)] = None,
    max_negatives: Annotated[
        float | None,
        option("X", "At most X boxes without light per box with light in each epoch.", min=0.01, max=1000.0),
    ] = None,
    precision: Annotated[
        str | None, option("fp32|bf16", "Number format; bf16 is faster on hardware that has it.")
    ] = None,
    preset: Annotated[
        str | None,
        option("NAME", "Preset of the proposals (default: paper with the recipe paper, else foreglow)."),
    ] = None,
    config: ConfigOption = None,
    device: DeviceOption = "auto",
    cache: Annotated[Path | None, shared_folder("Folder for the samples (default: in that of the model).")] = None,
) -> None:
    """Train a classifier of light artifacts on DATA, and write it as an ONNX model for `run --model`."""
    from foreglow.config import PRESETS
    from foreglow.files import check_each_once
    from foreglow.lab.learning import recipes
    from foreglow.lab.learning.training_progress import TrainingBar
    from foreglow.lab.learning.training_run import train_model
    from foreglow.lab.reports.training_pictures import draw_training

    if from_ is None and mix is not None:
        raise ValueError("train: expected --from with --mix, which is for a model that goes on learning")
    if from_ is not None and teacher:
        raise ValueError("train: expected --teacher without --from, with which a model is its own teacher")
    base, start = recipes.recipe(recipe or "foreglow"), None
    if from_ is not None:
        from foreglow.lab.learning.fine_tuning import fine_tune, fine_tuning_recipe, fitting_recipe
        from foreglow.lab.learning.model_import import read_model

        start = read_model(from_)
        if recipe not in (None, fitting_recipe(start)):
            raise ValueError(
                f"train: expected the recipe {fitting_recipe(start)} with --from, got {recipe!r}, which has another "
                f"network than {from_}"
            )
        base = fine_tuning_recipe(start)
    chosen_preset = preset or next((name for name in (str(from_), recipe) if name in PRESETS), "foreglow")
    configuration = PipelineOptions(preset=chosen_preset, config=config).configuration()
    if from_ is not None and config is None:
        check_boxes("--from", from_, configuration)
    chosen = base if recipe_file is None else recipes.read_recipe(recipe_file, base)
    given: dict[str, Any] = {"epochs": epochs, "patience": patience, "seed": seed, "precision": precision}
    given["max_negatives_per_positive"] = max_negatives
    chosen = recipes.changed(chosen, {name: value for name, value in given.items() if value is not None})
    if from_ is None:
        from foreglow.lab.learning.networks import recipe_network

        recipe_network(chosen, "recipe" if recipe_file is None else str(recipe_file))
    judged: tuple[Judged, ...] = ()
    if len({path.resolve() for path in data}) < len(data):
        raise ValueError(f"{', '.join(map(str, data))}: expected each data set once")
    check_each_once(mix or (), "--mix")
    check_each_once(teacher or (), "--teacher")
    say_bits_of(data, configuration.guard.white_level)
    try:
        with TrainingBar() as progress:
            how: dict[str, Any] = {"device": device, "cache": cache, "progress": progress}
            how["draw"] = functools.partial(draw_training, out)
            if start is None:
                summary = train_model(data, chosen, configuration, out, teachers=teacher or (), **how)
            else:
                summary, judged = fine_tune(data, start, chosen, configuration, out, mix=mix or (), **how)
    except KeyboardInterrupt:
        typer.echo(f"{out}: the same command continues from the last whole epoch", err=True)
        with contextlib.suppress(ValueError):  # curves that were damaged before; the training makes them anew
            draw_training(out)
        raise
    if start is None:
        typer.echo("\n".join(_training_lines(summary, out)))
    else:
        _show_fine_tuning(summary, start, judged, out)


MAX_WORSE = 0.01
"""A loss of average precision on a user's held-out drives that is said."""


def _show_fine_tuning(summary: dict[str, Any], start: StartingPoint, judged: Sequence[Judged], folder: Path) -> None:
    """What came of a fine-tuning: a table of before and after, and a picture."""
    import rich
    from rich.table import Table

    from foreglow.lab.reports.page import number
    from foreglow.lab.reports.training_pictures import CHANGES

    own, old = _boxes_of(summary["samples"]["own"], summary["recipe"]), summary["samples"]["mixed_in"]
    if isinstance(summary["mixed_in"], list):  # of drives, in place of the samples that ship, which have no copies
        old = _boxes_of(old, summary["recipe"])
    mixed = f"{old['positive']} and {old['negative']} mixed in"
    typer.echo(f"learnt from {own['positive']} boxes with light and {own['negative']} without, {mixed}")
    table = Table(
        *("", "boxes", "", "P", "R", "F", "AP"),
        title=f"boxes that it has not learnt from, score > {summary['threshold']:g}",
        caption="precision, recall, F, average precision",
        title_justify="left",
        caption_justify="left",
    )
    for each in judged:
        before, after = each.figures()
        for name, count, when, figures in (
            (each.name, str(len(each.samples)), "before", before),
            ("", "", "after", after),
        ):
            table.add_row(name, count, when, *(number(value, 3) for value in dataclasses.astuple(figures)))
        table.add_section()
    rich.print(table)
    for line in (*_unlit_lines(summary), *_worse_lines(judged)):
        typer.echo(line)
    if len(judged) == 1:
        typer.echo("no drives of yours are held out: label one more into DATA/val to see what it gained on them")
    if any(each.is_changed.any() for each in judged if each.images is not None):
        typer.echo(f"what changed, before and after: look at {folder / CHANGES}")
    for line in _kept_lines(summary["kept"], summary["way"]):
        typer.echo(line)
    if summary["way"] == 0:
        typer.echo(
            "the model is as before: all that it learnt costs too much of what it knew; "
            "label more, or --mix drives like those that it learnt from"
        )
    if start.tells_direct:
        typer.echo(f"the new model does not tell lamps from their light, as {start.name} does")
    typer.echo(f"look in {folder}; use it with foreglow run SOURCE --config {folder}/config.toml")


def _boxes_of(counts: dict[str, int], recipe: dict[str, Any]) -> dict[str, int]:
    """How many boxes have each label, of the numbers of samples: copies of boxes are samples, too."""
    return {label: number // (1 + recipe["jitter"]["num_copies"]) for label, number in counts.items()}


def _unlit_lines(summary: dict[str, Any]) -> list[str]:
    """A line for each split of a training without any box with light, as one that nobody has labelled."""
    words = "no box with light: it says that nothing in it is light of a vehicle; is it labelled?"
    return [f"{each}: {words}" for each in summary["without_light"]]


def _worse_lines(judged: Sequence[Judged]) -> list[str]:
    """A line for each of the user's held-out sets, all but the last, on which the new model is worse."""
    lines = []
    for each in judged[:-1]:
        before, after = each.figures()
        if after.average_precision < before.average_precision - MAX_WORSE:
            lines.append(
                f"worse on {each.name}, which it has not learnt from: keep the model that you had, and look for "
                "missing and wrong points in both sets"
            )
    return lines


def _kept_lines(kept: dict[str, dict[str, list[float]]], way: float) -> Iterator[str]:
    """On which camera's drives the new model lost most of what it knew, and whether that held it back; none where
    nothing tells.
    """
    found = [(camera, before, after) for camera, pairs in kept.items() for before, after in pairs.values()]
    for camera, before, after in sorted(found, key=lambda each: each[2] - each[1])[:1]:
        held = "" if way in (0, 1) else f"; to keep so much, the weights moved {way:.0%} of the way to what it learnt"
        line = f"of what it knew, it kept least on {camera}: average precision {before:.3f} before, {after:.3f} after"
        yield line + held


def _training_lines(summary: dict[str, Any], folder: Path) -> list[str]:
    """What came of a training; the last line says how to use it."""
    from foreglow.display.summary_lines import counted
    from foreglow.lab.reports.page import number

    figures, best = summary["validation"], summary["best_epoch"]
    counts = summary["samples"] | {"train": _boxes_of(summary["samples"]["train"], summary["recipe"])}
    lines = [
        f"{name}: {counted(counts[name]['positive'], 'box')} with light, {counts[name]['negative']} without, "
        f"{counts[name]['ignored']} doubtful and left out"
        for name in ("train", "val")
    ]
    lines += _unlit_lines(summary)
    lines.append(f"{counted(summary['num_epochs'], 'epoch')}, the best is number {best['number']}")
    error, after = figures["calibration_error"], ""
    if summary["recipe"]["calibration"] == "none":
        lines.append(f"not calibrated, by its recipe: calibration error {error['after']:.3f}")
    else:
        after = ", calibrated"
        lines.append(
            f"calibrated with temperature {figures['temperature']:.2f} and shift {figures['shift']:.2f}: calibration "
            f"error {error['before']:.3f} before, {error['after']:.3f} after"
        )
    lines += [
        *figures.get("doubts", ()),  # not in those of earlier versions
        f"on the validation boxes{after}: P {number(figures['precision'], 3)}, R {number(figures['recall'], 3)}, "
        f"F {number(figures['f1'], 3)} at a score of {figures['threshold']:g}",
    ]
    if not (folder / "curves.png").is_file():
        lines.append("no picture of the curves: it needs pip install 'foreglow[plots]'")
    return [*lines, f"look in {folder}; use it with foreglow run SOURCE --config {folder}/config.toml"]


@app.command("fit-ranges")
@with_options
def fit_ranges(
    data: Annotated[Path, argument("DATA", "Simulated drives, with train and val.")],
    out: Annotated[Path, output_file("The model to write, a TOML file for `distance.model`.", RANGE_MODEL)],
    config: ConfigOption = None,
    seed: Annotated[int, option("N", "Seed of the order of the images.", min=0)] = 0,
) -> None:
    """Fit the model of the road-surface ranges to lights whose ranges are known."""
    from foreglow.display.progress import StepProgress
    from foreglow.lab.learning.ranges import fit_ranges, write_hypotheses

    with StepProgress() as progress:
        model = fit_ranges(data, PipelineOptions(config=config).configuration(), seed=seed, progress=progress)
    write_hypotheses(out, model)
    typer.echo(f"wrote {out}: fitted to {model.origin}")


@app.command("import-weights")
@with_options
def import_weights(
    weights: Annotated[Path, argument("WEIGHTS", "Weights of the published classifier, a plain state dict.")],
    out: Annotated[Path, output_file("The ONNX model to write.", MODEL)],
    fold: Annotated[
        float | None,
        option(
            "TOLERANCE",
            "Remove channels as long as no score changes by more than this, such as 1e-3.",
            min=0.0,
            max=0.999,
        ),
    ] = None,
) -> None:
    """Turn the published PVDN classifier into an ONNX model for `run --preset baseline --model`."""
    from foreglow.lab.learning import import_weights

    layers = import_weights(weights, out, fold)
    millions = layers.num_multiply_adds / 1e6
    typer.echo(f"wrote {out}: {layers.num_parameters} parameters, {millions:.1f} million multiply-adds a crop")
