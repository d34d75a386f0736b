"""`experiment NAME`: figures, tables and a report in a folder."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    ClusterOption,
    JobsOption,
    ModelOption,
    PresetOption,
    argument,
    configuration_of,
    experiments,
    file,
    folder,
)

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import SplitName
    from foreglow.lab.studies.detector.plan import DetectorPlan
    from foreglow.lab.studies.glare.run import GlarePlan, NamedScene

TrainedOption = Annotated[Path | None, file(metavar="MODEL", help="ONNX, or a folder of `train`, for this row.")]


@experiments.command("simulator")
def experiment_simulator(
    data: Annotated[Path, argument(metavar="DATA", help="A simulated split, or a folder that holds one.")],
    out: Annotated[Path, folder(help="Folder for the report.")],
    real_labels: Annotated[
        Path | None, file(help="PVDN/night/val, or a JSON digest of its labels, to compare with.")
    ] = None,
    real_image: Annotated[Path | None, file(help="A real image of the same exposure, to compare with.")] = None,
) -> None:
    """Hold a simulated data set beside real drives: labels, pixels, and the time that indirect light leads."""
    from foreglow.lab.studies.simulator.page import write_report
    from foreglow.lab.studies.simulator.run import examine

    report = write_report(examine(data, real_labels, real_image), out)
    typer.echo(f"look in {report}")


@experiments.command("distance")
def experiment_distance(
    data: Annotated[Path, argument(metavar="DATA", help="A simulated data set, or one split of it.")],
    out: Annotated[Path, folder(help="Folder for the report.")],
    split: Annotated[str, typer.Option(metavar="train|val|test", help="What is measured on, of a data set.")] = "test",
    estimators: Annotated[
        str | None, typer.Option(metavar="NAME,NAME", help="Only these estimators (default: all).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the intervals.")] = 1,
) -> None:
    """Measure every estimator of ranges with every heuristic on lights whose range is known."""
    from foreglow.display.progress import StepProgress
    from foreglow.distance import ESTIMATORS
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.distance.page import write_report
    from foreglow.lab.studies.distance.run import DistancePlan, run_experiment

    require_matplotlib()
    names = tuple(ESTIMATORS) if estimators is None else tuple(estimators.split(","))
    plan = DistancePlan(split=cast("SplitName", split), estimators=names, seed=seed)
    with contextlib.closing(StepProgress()) as progress:
        results = run_experiment(data, plan, progress)
    typer.echo(f"look in {write_report(results, out)}")


@experiments.command("detector")
def experiment_detector(
    data: Annotated[Path, argument(metavar="DATA", help="A data set with train, val and test.")],
    out: Annotated[Path, folder(help="Folder for the report; an interrupted experiment in it goes on.")],
    baseline_model: TrainedOption = None,
    paper_model: TrainedOption = None,
    published: Annotated[Path | None, file(help="The published weights, by import-weights.")] = None,
    compact_model: TrainedOption = None,
    our_model: TrainedOption = None,
    yolo_small: Annotated[Path | None, file(metavar="RUN", help="A finished `yolo train`.")] = None,
    yolo_large: Annotated[Path | None, file(metavar="RUN", help="Likewise, of size x.")] = None,
    no_yolo: Annotated[bool, typer.Option("--no-yolo", help="Leave both YOLOs out.")] = False,
    no_training: Annotated[bool, typer.Option("--no-training", help="Only rows whose model is given.")] = False,
    rows: Annotated[str | None, typer.Option(metavar="NAME,NAME", help="Only these rows (default: all).")] = None,
    epochs_paper: Annotated[int | None, typer.Option(min=1, metavar="N", help="Epochs of recipe paper.")] = None,
    epochs_ours: Annotated[int | None, typer.Option(min=1, metavar="N", help="Epochs of recipe foreglow.")] = None,
    patience: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop N epochs after the best.")] = None,
    yolo_epochs: Annotated[int, typer.Option(min=1, metavar="N", help="Epochs of the YOLO.")] = 3,
    yolo_image_size: Annotated[int, typer.Option(metavar="PX", help="Side of the YOLO's images.")] = 320,
    seed: Annotated[int, typer.Option(min=0, help="Of all training and resampling.")] = 1,
    split: Annotated[str, typer.Option(metavar="train|val|test", help="What is measured on.")] = "test",
    device: Annotated[str, typer.Option(metavar="auto|cpu|cuda", help="Where to train.")] = "auto",
) -> None:
    """Make the paper's table of detectors: baseline, paper, ours and YOLO, measured alike."""
    from foreglow.lab.studies.detector.plan import ROWS, DetectorPlan

    paths = (baseline_model, paper_model, published, compact_model, our_model, yolo_small, yolo_large)
    epochs = {"paper": epochs_paper, "foreglow": epochs_ours}
    plan = DetectorPlan(
        rows=tuple(ROWS) if rows is None else tuple(rows.split(",")),
        given={name: path for name, path in zip(ROWS, paths, strict=True) if path is not None},
        split=cast("SplitName", split),
        may_train=not no_training,
        with_yolo=not no_yolo,
        epochs={name: number for name, number in epochs.items() if number is not None},
        patience=patience,
        seed=seed,
        yolo_epochs=yolo_epochs,
        yolo_image_size_px=yolo_image_size,
        device=device,
    )
    typer.echo(f"look in {_detector_report(data, out, plan)}")


def _detector_report(data: Path, out: Path, plan: DetectorPlan) -> Path:
    """Runs the experiment and writes its report, whose path it returns."""
    from foreglow.datasets import PVDN, split_folder
    from foreglow.display.progress import StepProgress, TrainingBar
    from foreglow.lab.studies.detector.figures import pictures
    from foreglow.lab.studies.detector.page import write_report
    from foreglow.lab.studies.detector.run import run_experiment

    with contextlib.closing(StepProgress()) as progress, contextlib.closing(TrainingBar()) as training:

        def show(step: str, num_done: int, num_all: int) -> None:
            training.close()  # one bar at a time; it comes back with the next training
            progress(step, num_done, num_all)

        results = run_experiment(data, out, plan, progress=show, training=training)
    return write_report(results, pictures(results, PVDN(split_folder(data, plan.split))), out)


@experiments.command("time-benefit")
def experiment_time_benefit(
    data: Annotated[Path, argument(metavar="DATA", help="A data set at its full frame rate, or one split of it.")],
    out: Annotated[Path, folder(help="Folder for the report.")],
    split: Annotated[str, typer.Option(metavar="train|val|test", help="What is measured on, of a data set.")] = "test",
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
    production_category: Annotated[
        int, typer.Option(min=0, max=7, help="PVDN's image category that marks the production system's report.")
    ] = 6,
) -> None:
    """How long before a production system and a human the first vehicle of each sequence is detected."""
    from foreglow.datasets import PVDN, CategoryConfig, ImageCategory, split_in
    from foreglow.display.progress import StepProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.time_benefit.page import summary_lines, write_report
    from foreglow.lab.studies.time_benefit.run import run_experiment

    require_matplotlib()
    dataset = PVDN(split_in(data, cast("SplitName", split)))
    categories = CategoryConfig(low_beam_trigger=ImageCategory(production_category))
    with contextlib.closing(StepProgress()) as progress:
        results = run_experiment(dataset, configuration_of(preset, config, model), categories, progress)
    report = write_report(results, out)
    typer.echo("\n".join([*summary_lines(results), f"look in {report}"]))


@experiments.command("runtime")
def experiment_runtime(
    data: Annotated[Path, argument(metavar="DATA", help="A data set at its full frame rate, or one split of it.")],
    out: Annotated[Path, folder(help="Folder for the report.")],
    split: Annotated[str, typer.Option(metavar="train|val|test", help="What is measured on, of a data set.")] = "test",
    on: Annotated[
        list[str] | None,
        typer.Option(metavar="process|live|node|ros2", help="Measure only this; repeatable (default: all four)."),
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, metavar="N", help="Of those that are run at their own rate: so many frames.")
    ] = 1000,
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
) -> None:
    """Run-time of each stage, as in the paper's figure: in process, live, and over a ROS 2 network."""
    from foreglow.datasets import split_in
    from foreglow.display.progress import StepProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.runtime.page import summary_lines, write_report
    from foreglow.lab.studies.runtime.run import KINDS, run_experiment

    require_matplotlib()
    configuration = configuration_of(preset, config, model)
    with contextlib.closing(StepProgress()) as progress:
        results = run_experiment(
            split_in(data, cast("SplitName", split)), configuration, on or list(KINDS), frames, progress
        )
    report = write_report(results, out)
    typer.echo("\n".join([*summary_lines(results), f"look in {report}"]))


@experiments.command("glare")
def experiment_glare(
    scenes: Annotated[Path, argument(metavar="SCENES", help="A simulated split, or its scenes.jsonl.")],
    out: Annotated[Path, folder(help="Folder for the report; an interrupted experiment in it goes on.")],
    num: Annotated[int | None, typer.Option("--scenes", min=1, metavar="N", help="Only the first N scenes.")] = None,
    empty: Annotated[int, typer.Option(min=0, metavar="N", help="Drive the first N again without traffic.")] = 0,
    camera_delay: Annotated[float, typer.Option(metavar="S", help="From exposure to the command on the bus.")] = 0.05,
    lamp_delay: Annotated[float, typer.Option(metavar="S", help="From there to the light.")] = 0.1,
    video: Annotated[str | None, typer.Option(metavar="NAME", help="Also film this scene, such as S00004.")] = None,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
    quality: Annotated[str, typer.Option(metavar="fast|training|fine", help="How finely it renders.")] = "training",
    seed: Annotated[int, typer.Option(min=0, help="Of the intervals.")] = 1,
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
) -> None:
    """Drive scenes in closed loop with six beam policies, and measure the light at other drivers' eyes in lux."""
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.glare.loop import Delays
    from foreglow.lab.studies.glare.page import summary_lines, write_experiment
    from foreglow.lab.studies.glare.run import GlarePlan, named_scenes, run_experiment
    from foreglow.parallel import workers_at

    require_matplotlib()
    workers = workers_at(jobs, cluster)
    delays = Delays(camera_s=camera_delay, lamp_s=lamp_delay)
    plan = GlarePlan(num_scenes=num, num_empty=empty, delays=delays, quality=quality, seed=seed)
    wanted = named_scenes(scenes, plan)
    if video not in (None, *(one.name for one in wanted)):
        raise ValueError(f"--video: expected one of the scenes, {wanted[0].name} to {wanted[-1].name}, got {video!r}")
    configuration = configuration_of(preset, config, model)
    with contextlib.closing(SceneProgress(len(wanted), sum(one.scene.num_frames for one in wanted))) as progress:
        experiment = run_experiment(scenes, configuration, plan, out, workers=workers, progress=progress)
    if video is not None:
        _film(next(one for one in wanted if one.name == video), configuration, plan, out)
    report = write_experiment(experiment)
    typer.echo("\n".join([*summary_lines(experiment.results), f"look in {report}"]))


@experiments.command("occurrence")
def experiment_occurrence(
    data: Annotated[Path, argument(metavar="DATA", help="A simulated data set at its full frame rate, or one split.")],
    split: Annotated[str, typer.Option(metavar="train|val|test", help="What is measured on, of a data set.")] = "test",
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
) -> None:
    """How well it is told where and when hidden vehicles come into sight, before they do."""
    from foreglow.datasets import split_in
    from foreglow.display.progress import StepProgress
    from foreglow.lab.studies.occurrence.page import report_lines
    from foreglow.lab.studies.occurrence.run import run_experiment

    with contextlib.closing(StepProgress()) as progress:
        sightings = run_experiment(
            split_in(data, cast("SplitName", split)), configuration_of(preset, config, model), progress
        )
    for line in report_lines(sightings):
        typer.echo(line)


def _film(named: NamedScene, config: PipelineConfig, plan: GlarePlan, out: Path) -> None:
    """Drives a scene once more and films it."""
    from foreglow.lab.studies.glare.film import write_film
    from foreglow.lab.studies.glare.simulate import Drives
    from foreglow.photometry import read_headlamps

    drives = Drives(plan.delays.known_to(config), plan.delays, plan.quality)
    titles, rate_hz = ("paper", "foreglow"), named.scene.rate_hz
    headlamps = read_headlamps(config.beam.headlamps)
    write_film(drives.pairs(named.scene), titles, headlamps, rate_hz, out / f"film_{named.name}.mp4")
