"""`evaluate`: how good a model or predictions are on a split."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import bits_notes, boxes_notes, look_sink, run_in_parallel, say_lack
from foreglow.command_line import argument, file, flag, folder, option, output_file, with_options
from foreglow.options import PipelineOptions, WorkerOptions
from foreglow.own_files import QUALITY

if TYPE_CHECKING:
    from rich.table import Table

    from foreglow.config import PipelineConfig
    from foreglow.lab.evaluation import BoxQuality, Examination
    from foreglow.lab.evaluation.boxes.directness import KindConfusion
    from foreglow.parallel import Workers


@app.command()
@with_options
def evaluate(
    split: Annotated[
        Path, argument("SPLIT", "A PVDN split, such as PVDN/day/val, or labels of a tool (docs: own data).")
    ],
    pipeline: PipelineOptions,
    work: WorkerOptions,
    predictions: Annotated[
        Path | None, file("Boxes to evaluate instead of running a model: frames.jsonl of a run, or PVDN's JSON.")
    ] = None,
    threshold: Annotated[
        float | None,
        option("SCORE", "Count boxes with a score above this (default: that of the run).", min=0.0, max=1.0),
    ] = None,
    out: Annotated[Path | None, folder("Folder for a report with all figures and plots.")] = None,
    json_file: Annotated[
        Path | None,
        output_file("Also write the figures of the table, and those by whose light, as JSON.", QUALITY, "--json"),
    ] = None,
    robustness: Annotated[
        bool, flag("--robustness", "Also run on disturbed images: gain, noise, haze, rain, blur.")
    ] = False,
    seed: Annotated[int | None, option("N", "Seed of the disturbances (default: 0).", min=0)] = None,
) -> None:
    """Compare the boxes of a model, or of --predictions, with the key points of a split."""
    if robustness and predictions is not None:
        raise ValueError("evaluate: expected --model with --robustness, which runs on disturbed images")
    if robustness and out is None:
        raise ValueError("evaluate: expected --out with --robustness, whose figures are in the report alone")
    if seed is not None and not robustness:
        raise ValueError("evaluate: expected --robustness with --seed, which is that of its disturbances")
    if work.is_parallel and predictions is not None:
        raise ValueError("evaluate: expected --jobs and --cluster with a model, predictions need no work")

    import rich

    from foreglow.datasets.pvdn.splits import found_name
    from foreglow.files import to_json, write_json_results
    from foreglow.lab.reports.evaluation_page import examination_lines, write_report
    from foreglow.runs.predictions import run_threshold
    from foreglow.whole_files import together

    workers = work.workers()
    configuration = _configuration(pipeline, predictions, threshold)
    if out is not None:
        from foreglow.lab.reports.figures import require_matplotlib

        require_matplotlib()
    if predictions is not None:
        examination = _examined_file(split, predictions, run_threshold(predictions) if threshold is None else threshold)
    else:
        examination = _examined_model(split, configuration, out, (seed or 0) if robustness else None, workers)
    typer.echo("\n".join([*examination.notes, COMPARED]))
    rich.print(_table(examination.quality, found_name(split)))
    typer.echo("\n".join(examination_lines(examination)))
    if examination.kinds is not None:
        rich.print(_kinds_table(examination.kinds))
    with together():
        if json_file is not None:
            by_light = {"whose_light": examination.whose_light, "kinds": examination.kinds}
            told = {name: found for name, found in by_light.items() if found is not None}
            figures = to_json(examination.quality) | {"is_complete": examination.is_complete} | told
            write_json_results(json_file, figures, indent=2)
        if out is not None:
            paths = {"split": split, "predictions": predictions, "model": pipeline.model}
            options = paths | {"preset": pipeline.preset, "config": pipeline.config}
            given = {name: None if value is None else str(value) for name, value in options.items()}
            page = write_report(examination, out, given | {"seed": seed or 0})
    if out is not None:
        typer.echo(f"look in {page}")


def _configuration(options: PipelineOptions, predictions: Path | None, threshold: float | None) -> PipelineConfig:
    """What `evaluate` runs on the split, unless it is given predictions."""
    if predictions is not None:
        for name, value in dataclasses.asdict(options).items():
            if value is not None:
                raise ValueError(f"evaluate: expected --predictions or --{name}, got both")
    configuration = options.configuration().detector_only
    if configuration.classifier.model is None and predictions is None:
        raise ValueError("evaluate: expected --predictions FILE or --model FILE, got neither")
    if threshold is None:
        return configuration
    from foreglow.config import ClassifierConfig

    classifier = ClassifierConfig(**(configuration.classifier.model_dump() | {"score_threshold": threshold}))
    return configuration.model_copy(update={"classifier": classifier})


def _examined_file(split: Path, predictions: Path, threshold: float) -> Examination:
    from foreglow.datasets import open_labelled
    from foreglow.lab.evaluation import examine, read_predictions, read_split_labels
    from foreglow.lab.evaluation.boxes.box_quality import compared_labels
    from foreglow.lab.evaluation.boxes.breakdown import num_beyond, num_twin_boxes
    from foreglow.lab.evaluation.boxes.directness import directness, read_cameras
    from foreglow.runs.frames_file import has_tracks, read_tracks

    compared, found = compared_labels(predictions, read_predictions(predictions), split, open_labelled(split))
    dataset = compared.dataset
    labels = read_split_labels(dataset, with_shares=True)
    examination = examine(labels, found, threshold, str(predictions))
    notes = (*compared.lines, *examination.notes)
    examination = dataclasses.replace(
        examination,
        num_beyond=num_beyond(dataset, found),
        num_twin_boxes=num_twin_boxes(dataset, found),
        notes=notes,
    )
    if predictions.name == "frames.jsonl" and say_lack(predictions.parent, len(found.scores)):
        examination = dataclasses.replace(examination, is_complete=False)
    if not has_tracks(predictions):
        return examination
    tracks = compared.by_image(read_tracks(predictions))
    of_tracks = directness(labels, found, threshold, tracks, read_cameras(dataset))
    return dataclasses.replace(examination, directness=of_tracks)


def _examined_model(
    split: Path, configuration: PipelineConfig, out: Path | None, seed: int | None, workers: Workers
) -> Examination:
    """All figures of a pipeline that is run on the split; with a `seed`, on disturbed images, too."""
    from foreglow.datasets import open_labelled
    from foreglow.display.progress import ProgressSink
    from foreglow.display.summary_lines import counted
    from foreglow.lab.evaluation import examine, read_predictions, read_split_labels
    from foreglow.lab.evaluation.boxes.robustness import robustness
    from foreglow.lab.reports.evaluation_page import REPORT
    from foreglow.runtime import Opening
    from foreglow.whole_files import remove_file

    dataset = open_labelled(split)
    labels = read_split_labels(dataset, with_shares=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = out or Path(temporary)
        looks = look_sink(dataset, None, configuration)
        opening = Opening(open_labelled, (split,))
        summary = run_in_parallel(opening, str(split), folder, configuration, workers, looks)
        for name in REPORT:  # of an earlier evaluation there: whatever comes now, it is of another run
            remove_file(folder / name)
        if summary.is_interrupted:
            if out is not None:
                typer.echo(f"interrupted after {counted(summary.num_frames, 'image')}: {out} has these, and no report")
            raise KeyboardInterrupt
        found = read_predictions(folder / "frames.jsonl")
    classifier = configuration.classifier
    examination = examine(labels, found, classifier.score_threshold, str(classifier.model), summary.run_time_ms)
    notes = [*bits_notes(looks.brightest, configuration.guard.white_level), *boxes_notes(configuration)]
    examination = dataclasses.replace(examination, notes=(*dataset.notes, *examination.notes, *notes))
    if seed is None:
        return examination
    with ProgressSink(dataset.num_frames) as progress:
        rows = robustness(dataset, labels, configuration, seed=seed, progress=progress.write)
    return dataclasses.replace(examination, robustness=rows)


COMPARED = (
    "Boxes are compared with the key points that were labelled: a box is right if a key point lies in it, "
    "and a key point is found if it lies in an accepted box."
)


def _table(quality: BoxQuality, title: str) -> Table:
    """The numbers of `quality`, with a dash for undefined ones, and the counts behind them."""
    from rich.table import Table

    from foreglow.lab.reports.evaluation_page import quality_words
    from foreglow.lab.reports.page import number

    caption = "\n".join(quality_words(quality))
    table = Table("figure", "value", "std", title=title, caption=caption, title_justify="left", caption_justify="left")
    table.columns[1].justify = "right"
    for name, value in (("precision", quality.precision), ("recall", quality.recall), ("F", quality.f1)):
        table.add_row(name, number(value, 4))
    table.add_section()
    table.add_row("q", number(quality.q, 4))
    table.add_row("q_K", number(quality.q_k, 4), f"± {number(quality.q_k_std, 4)}")
    table.add_row("q_B", number(quality.q_b, 4), f"± {number(quality.q_b_std, 4)}")
    table.add_section()
    table.add_row("TP (key points in a box)", str(quality.tp))
    table.add_row("FN (key points in none)", str(quality.fn))
    table.add_row("FP (boxes without key point)", str(quality.fp))
    return table


def _kinds_table(confusion: KindConfusion) -> Table:
    """What boxes are, in the rows, against what they are called, in the columns."""
    from rich.table import Table

    from foreglow.lab.reports.evaluation_page import kinds_rows, kinds_words

    head, *rows = kinds_rows(confusion)
    table = Table(title="kinds of light", caption=kinds_words(confusion), title_justify="left", caption_justify="left")
    for index, name in enumerate(head):
        table.add_column(name, justify="right" if index else "left")
    for row in rows:
        table.add_row(*row)
    return table
