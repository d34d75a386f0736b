"""`evaluate`: what predictions or a model are worth on a split."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    ClusterOption,
    JobsOption,
    app,
    argument,
    configuration_of,
    file,
    folder,
    run_by_workers,
)

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.lab.evaluation import Examination
    from foreglow.parallel import Workers


@app.command()
def evaluate(
    split: Annotated[Path, argument(metavar="SPLIT", help="A PVDN split, such as PVDN/day/val.")],
    predictions: Annotated[Path | None, file(help="frames.jsonl of a run, or PVDN's JSON.")] = None,
    model: Annotated[Path | None, file(help="ONNX model that is run on the split, in place of --predictions.")] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="Parameters that --model runs with (default: foreglow).")
    ] = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="A box counts when its score is above this (default: the configuration's)."),
    ] = None,
    out: Annotated[Path | None, folder(help="Folder for a report with all figures and plots.")] = None,
    json_file: Annotated[Path | None, file("--json", help="Also write the paper's metrics as JSON.")] = None,
    robustness: Annotated[
        bool, typer.Option("--robustness", help="Also run on disturbed images: gain, noise, haze, rain, blur.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the disturbances.")] = 0,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
) -> None:
    """Compare a model's boxes, or predicted ones, with a split's key points."""
    if robustness and predictions is not None:
        raise ValueError("evaluate: expected --model with --robustness, which runs on disturbed images")

    import rich

    from foreglow.files import write_json_results
    from foreglow.lab.reports.evaluation_page import examination_lines, write_report
    from foreglow.lab.reports.tables import box_quality_table
    from foreglow.parallel import workers_at

    workers = workers_at(jobs, cluster)
    configuration = _evaluated_configuration(predictions, model, preset, config, threshold)
    if out is not None:
        from foreglow.lab.reports.figures import require_matplotlib

        require_matplotlib()
    if predictions is not None:
        examination = _examined_file(split, predictions, 0.5 if threshold is None else threshold)
    else:
        examination = _examined_model(split, configuration, out, seed if robustness else None, workers)
    if json_file is not None:
        quality = examination.quality.to_json()
        write_json_results(json_file, quality, indent=2)
    rich.print(box_quality_table(examination.quality, str(split)))
    typer.echo("\n".join(examination_lines(examination)))
    if out is not None:
        options = {"split": split, "predictions": predictions, "model": model, "preset": preset, "config": config}
        given = {name: None if value is None else str(value) for name, value in options.items()}
        typer.echo(f"look in {write_report(examination, out, given | {'seed': seed})}")


def _evaluated_configuration(
    predictions: Path | None, model: Path | None, preset: str | None, config: Path | None, threshold: float | None
) -> PipelineConfig:
    """What `evaluate` runs on the split, if it has no predictions already."""
    given = {"model": model, "preset": preset, "config": config}
    for name in [name for name, value in given.items() if value is not None and predictions is not None]:
        raise ValueError(f"evaluate: expected --predictions or --{name}, got both")
    configuration = configuration_of(preset or DEFAULT_PRESET, config, model).detector_only
    if configuration.classifier.model is None and predictions is None:
        raise ValueError("evaluate: expected --predictions FILE or --model FILE, got neither")
    if threshold is None:
        return configuration
    from foreglow.config import ClassifierConfig

    classifier = ClassifierConfig(**(configuration.classifier.model_dump() | {"score_threshold": threshold}))
    return configuration.model_copy(update={"classifier": classifier})


def _examined_file(split: Path, predictions: Path, threshold: float) -> Examination:
    """All figures of predictions in a file."""
    from foreglow.datasets import PVDN
    from foreglow.lab.evaluation import examine, read_predictions, read_split_labels
    from foreglow.lab.evaluation.boxes.directness import directness, read_cameras
    from foreglow.runs.frames_file import has_tracks, read_tracks

    dataset = PVDN(split)
    found, labels = read_predictions(predictions), read_split_labels(dataset)
    examination = examine(labels, found, threshold, str(predictions))
    if not has_tracks(predictions):
        return examination
    of_tracks = directness(labels, found, threshold, read_tracks(predictions), read_cameras(dataset))
    return dataclasses.replace(examination, directness=of_tracks)


def _examined_model(
    split: Path, configuration: PipelineConfig, out: Path | None, seed: int | None, workers: Workers
) -> Examination:
    """All figures of a pipeline that runs on the split now; with `seed`, on disturbed images too."""
    from foreglow.datasets import PVDN
    from foreglow.display.progress import ProgressSink
    from foreglow.lab.evaluation import examine, read_predictions, read_split_labels
    from foreglow.lab.evaluation.boxes.robustness import robustness
    from foreglow.runtime import Opening

    dataset = PVDN(split)
    labels = read_split_labels(dataset)
    with tempfile.TemporaryDirectory() as temporary:
        folder = out or Path(temporary)
        summary = run_by_workers(Opening(PVDN, (split,)), str(split), folder, configuration, workers)
        if not summary.is_complete:
            raise KeyboardInterrupt
        found = read_predictions(folder / "frames.jsonl")
    classifier = configuration.classifier
    examination = examine(labels, found, classifier.score_threshold, str(classifier.model), summary.run_time_ms)
    if seed is None:
        return examination
    with contextlib.closing(ProgressSink(dataset.num_frames)) as progress:
        rows = robustness(dataset, labels, configuration, seed=seed, progress=progress.write)
    return dataclasses.replace(examination, robustness=rows)
