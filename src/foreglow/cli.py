"""The command `foreglow`: parses, calls, and turns errors into one line and an exit code.

Exit codes: 0 done, 2 bad input or arguments, 130 interrupted by Ctrl-C. What a command needs is imported when it runs,
so that help is there at once.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource, OnError, SplitName
    from foreglow.evaluation import Examination
    from foreglow.experiments.detector_plan import DetectorPlan
    from foreglow.runtime import OutputFolder, ResultSink, RunSummary
    from foreglow.simulation import Scene

EXTRAS = {
    **dict.fromkeys(("onnx", "torch", "optuna"), "train"),
    **dict.fromkeys(("mitsuba", "drjit"), "sim"),
    **dict.fromkeys(("libreyolo", "torchvision"), "yolo"),
    "matplotlib": "plots",
    "ultralytics": "ultralytics",
}
"""Optional modules, and the extra that installs each."""


DEMO_SCENARIO, DEMO_SEED = "curve", 0
"""The drive of `foreglow demo` without a source."""


class Commands(TyperGroup):
    """The sub-commands, with their errors turned into one line on stderr."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the sub-command.

        Raises:
            typer.Exit: With code 2 for bad input and 130 for Ctrl-C; with `--debug` the error itself is raised.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            line, code = "interrupted", 130
        except BrokenPipeError:  # whoever reads the output, such as `head`, has seen enough
            raise
        except (ValueError, OSError, ModuleNotFoundError) as error:
            is_ours = not isinstance(error, ModuleNotFoundError) or error.name in EXTRAS
            if ctx.params["debug"] or not is_ours:
                raise
            line, code = _one_line(error), 2
        typer.echo(f"foreglow: {line}", err=True)
        raise typer.Exit(code)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Foreglow: provident vehicle detection at night.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

experiments = typer.Typer(no_args_is_help=True, help="Experiments: figures, tables and a report in a folder.")
app.add_typer(experiments, name="experiment")

yolo = typer.Typer(no_args_is_help=True, help="A YOLO on the same boxes, to compare with.")
app.add_typer(yolo, name="yolo")

# readable=False leaves unreadable files to the readers, whose errors take one line.
_argument = functools.partial(typer.Argument, readable=False)
_file = functools.partial(typer.Option, readable=False, metavar="FILE")
_folder = functools.partial(typer.Option, readable=False, metavar="DIR")

_BOXES_HELP = "Boxes of this preset [default: those that `annotate` wrote, else of paper]."
_SOURCE_HELP = "An image, a folder of images, a video, a PVDN split (PVDN/day/val) or a PVDN sequence."
Source = Annotated[Path, _argument(metavar="SOURCE", help=_SOURCE_HELP)]
ModelOption = Annotated[Path | None, _file(help="ONNX model that classifies the proposals; overrides the file's.")]

TrainedOption = Annotated[Path | None, _file(metavar="MODEL", help="ONNX, or a folder of `train`, for this row.")]


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        import foreglow

        typer.echo(f"foreglow {foreglow.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None: ...


@app.command()
def run(
    source: Source,
    out: Annotated[Path, _folder(help="Folder for the results; made if need be.")],
    preset: Annotated[str, typer.Option(metavar="paper|baseline", help="Parameters to start from.")] = "paper",
    model: ModelOption = None,
    config: Annotated[Path | None, _file(help="TOML whose fields override the preset.")] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Also write annotated pictures: MP4, or PNG of one image.")
    ] = False,
    limit: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after N frames.")] = None,
    on_error: Annotated[str, typer.Option(metavar="stop|skip", help="What an unreadable file does.")] = "stop",
) -> None:
    """Find the light artifacts in SOURCE and write them to a folder."""
    configuration = _configuration(preset, config, model)
    frames = _opened(source, out, on_error)
    _finish(_run(frames, str(source), out, configuration, has_video=video, limit=limit), out)


@app.command()
def evaluate(
    split: Annotated[Path, _argument(metavar="SPLIT", help="A PVDN split, such as PVDN/day/val.")],
    predictions: Annotated[Path | None, _file(help="frames.jsonl of a run, or PVDN's JSON.")] = None,
    model: Annotated[Path | None, _file(help="ONNX model that is run on the split, in place of --predictions.")] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="paper|baseline", help="Parameters that --model runs with [default: paper].")
    ] = None,
    config: Annotated[Path | None, _file(help="TOML whose fields override the preset.")] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="A box counts when its score is above this [default: the configuration's, 0.5]."),
    ] = None,
    out: Annotated[Path | None, _folder(help="Folder for a report with all figures and plots.")] = None,
    json_file: Annotated[Path | None, _file("--json", help="Also write the paper's metrics as JSON.")] = None,
    robustness: Annotated[
        bool, typer.Option("--robustness", help="Also run on disturbed images: gain, noise, haze, rain, blur.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the disturbances.")] = 0,
) -> None:
    """Compare a model's boxes, or predicted ones, with a split's key points."""
    if robustness and predictions is not None:
        raise ValueError("evaluate: expected --model with --robustness, which runs on disturbed images")
    import json

    import rich

    from foreglow.files import write_atomic
    from foreglow.reports.evaluation_page import examination_lines, write_report
    from foreglow.reports.tables import box_quality_table

    configuration = _evaluated_configuration(predictions, model, preset, config, threshold)
    if out is not None:
        from foreglow.reports.figures import require_matplotlib

        require_matplotlib()
    if predictions is not None:
        examination = _examined_file(split, predictions, 0.5 if threshold is None else threshold)
    else:
        examination = _examined_model(split, configuration, out, seed if robustness else None)
    if json_file is not None:
        quality = examination.quality.to_json()
        write_atomic(json_file, (json.dumps(quality, indent=2, allow_nan=False) + "\n").encode())
    rich.print(box_quality_table(examination.quality, str(split)))
    typer.echo("\n".join(examination_lines(examination)))
    if out is not None:
        options = {"split": split, "predictions": predictions, "model": model, "preset": preset, "config": config}
        given = {name: None if value is None else str(value) for name, value in options.items()}
        typer.echo(f"look in {write_report(examination, out, given | {'seed': seed})}")


@app.command()
def annotate(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set in PVDN's format, or one split of it.")],
    preset: Annotated[str, typer.Option(metavar="paper|baseline", help="Parameters of the boxes.")] = "paper",
    config: Annotated[Path | None, _file(help="TOML whose fields override the preset.")] = None,
    split: Annotated[
        list[str] | None, typer.Option(metavar="train|val|test", help="Only this split; repeatable.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Threads.")] = 1,
    json_file: Annotated[Path | None, _file("--json", help="Also write the numbers as JSON.")] = None,
) -> None:
    """Turn key points into labelled boxes, labels/bounding_boxes/*.json, and rate them."""
    import json

    import rich

    from foreglow.files import write_atomic
    from foreglow.learning.annotate import annotate_split, splits_to_annotate
    from foreglow.reports.progress import StepProgress
    from foreglow.reports.tables import annotation_table

    configuration = _configuration(preset, config, None)
    roots = splits_to_annotate(data, tuple(split or ()))
    with contextlib.closing(StepProgress()) as progress:
        made = [annotate_split(one, configuration, preset, jobs=jobs, progress=progress) for one in roots]
    if json_file is not None:
        numbers = {one.root.name: one.to_json() for one in made}
        write_atomic(json_file, (json.dumps(numbers, indent=2, allow_nan=False) + "\n").encode())
    rich.print(annotation_table(made, preset if config is None else f"{preset} with {config}"))


@app.command()
def tune(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set in PVDN's format: train, and val and test.")],
    trials: Annotated[int, typer.Option(min=1, metavar="N", help="Trials in total, earlier calls included.")] = 200,
    images: Annotated[int, typer.Option(min=1, metavar="N", help="Images of train, spread over its scenes.")] = 600,
    objective: Annotated[str, typer.Option(metavar="q|q-only|light", help="What is minimised.")] = "q",
    space: Annotated[
        str | None, typer.Option(metavar="paper|wide", help="What is varied [default: the objective's own].")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="With one job: the same seed, the same trials.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    storage: Annotated[
        str | None,
        typer.Option(metavar="FILE|URL", help="Optuna's journal or database, for many machines [default: in DIR]."),
    ] = None,
    out: Annotated[Path, _folder(help="Folder for the results; the same one goes on.")] = Path("tune_output"),
) -> None:
    """Search the parameters of the proposals: on train, chosen on val, reported on test."""
    from foreglow.learning.tuning import TuningSettings
    from foreglow.learning.tuning import tune as search
    from foreglow.reports.figures import require_matplotlib
    from foreglow.reports.progress import StepProgress
    from foreglow.reports.tables import tuning_lines
    from foreglow.reports.tuning_page import write_report

    require_matplotlib()
    settings = TuningSettings(
        num_trials=trials, num_images=images, objective=objective, space=space, seed=seed, jobs=jobs, storage=storage
    )
    with contextlib.closing(StepProgress()) as progress:
        tuning = search(data, out, settings, progress)
    typer.echo("\n".join(tuning_lines(tuning)))
    typer.echo(f"look in {write_report(tuning, out)}; use it with --config {out / 'best.toml'}")


@app.command("import-weights")
def import_weights(
    weights: Annotated[
        Path, _argument(metavar="WEIGHTS", help="The published classifier's weights, a plain state dict.")
    ],
    out: Annotated[Path, _file(help="The ONNX model to write.")],
    fold: Annotated[
        float | None,
        typer.Option(
            metavar="TOLERANCE", help="Remove channels while no score changes by more than this, such as 1e-3."
        ),
    ] = None,
) -> None:
    """Turn the published PVDN classifier into an ONNX model for `run --model`."""
    from foreglow.learning import import_weights

    model = import_weights(weights, out, fold)
    millions = model.num_multiply_adds / 1e6
    typer.echo(f"wrote {model.path}: {model.num_parameters} parameters, {millions:.1f} million multiply-adds a crop")


@app.command()
def train(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set in PVDN's format, with train and val.")],
    out: Annotated[Path, _folder(help="Folder for the model; an interrupted training in it goes on.")],
    recipe: Annotated[
        str, typer.Option(metavar="paper|foreglow", help="How to train, and which network.")
    ] = "foreglow",
    recipe_file: Annotated[Path | None, _file(help="TOML whose fields override the recipe.")] = None,
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
        str | None, typer.Option(metavar="NAME", help="Preset of the proposals [the recipe's name].")
    ] = None,
    config: Annotated[Path | None, _file(help="TOML whose fields override the preset.")] = None,
    device: Annotated[str, typer.Option(metavar="auto|cpu|cuda", help="Where to compute.")] = "auto",
    cache: Annotated[Path | None, _folder(help="Where samples are kept [default: in the folder].")] = None,
) -> None:
    """Train a classifier of light artifacts on DATA, and write it as an ONNX model for `run --model`."""
    from foreglow.learning import recipes
    from foreglow.learning.training_run import train_model
    from foreglow.reports.progress import TrainingBar
    from foreglow.reports.tables import training_lines
    from foreglow.reports.training_curves import draw_training

    chosen = recipes.recipe(recipe) if recipe_file is None else recipes.read_recipe(recipe_file, recipes.recipe(recipe))
    given: dict[str, Any] = {"epochs": epochs, "patience": patience, "seed": seed, "precision": precision}
    given["max_negatives_per_positive"] = max_negatives
    chosen = recipes.changed(chosen, {name: value for name, value in given.items() if value is not None})
    configuration = _configuration(preset or recipe, config, None)
    try:
        with contextlib.closing(TrainingBar()) as progress:
            trained = train_model(data, chosen, configuration, out, device=device, cache=cache, progress=progress)
    finally:  # also of a training that was interrupted
        draw_training(out)
    typer.echo("\n".join(training_lines(trained)))


@app.command()
def download(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="The data set: pvdn.")],
    out: Annotated[Path, _folder(help="Where to put it.")] = Path("PVDN"),
) -> None:
    """Fetch a data set."""
    if dataset != "pvdn":
        raise ValueError(f"download: expected pvdn, got {dataset!r}")
    from foreglow.datasets import download_pvdn

    typer.echo(f"PVDN is in {download_pvdn(out)}")


@app.command()
def demo(
    source: Annotated[Path | None, _argument(metavar="SOURCE", help="What to run on, as in `run`.")] = None,
    out: Annotated[Path, _folder(help="Folder for the results.")] = Path("demo_output"),
    model: ModelOption = None,
) -> None:
    """Run on SOURCE, or on a simulated drive, with annotated pictures, and say where to look."""
    frames = _simulated_drive() if source is None else _opened(source, out)
    name = frames.name if source is None else str(source)
    _finish(_run(frames, name, out, _configuration("paper", None, model), has_video=True), out)


@app.command()
def simulate(
    out: Annotated[Path | None, _folder(help="Folder of the data set, or of the preview.")] = None,
    scenes: Annotated[int, typer.Option(min=1, metavar="N", help="How many drives to draw.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is drawn: the same seed, the same bytes.")] = 7,
    split: Annotated[str, typer.Option(metavar="train|val|test", help="The split, with drives of its own.")] = "train",
    scene: Annotated[list[Path] | None, _file(help="Your own scene, TOML, in place of drawn ones; repeatable.")] = None,
    preview: Annotated[str | None, typer.Option(metavar="NAME", help="Only show one drive of this scenario.")] = None,
    print_scene: Annotated[
        str | None, typer.Option("--print", metavar="NAME", help="Only write a drawn scenario as TOML to stdout.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images [default: 1280x960].")] = None,
    cycle: Annotated[str, typer.Option(metavar="day|night", help="Short or long exposure of the night.")] = "day",
    fps: Annotated[float, typer.Option(min=0.1, max=1000.0, help="Frames a second.")] = 18.0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; one uses all cores and is quickest up to four.")] = 1,
    quality: Annotated[str, typer.Option(metavar="fast|training|fine", help="How finely it renders.")] = "training",
) -> None:
    """Simulate night drives: a data set in PVDN's format with the truth beside it, or a preview of one drive."""
    from foreglow import simulation

    if print_scene is not None:
        typer.echo(simulation.scene_to_toml(simulation.scenario(print_scene, seed)), nl=False)
    elif preview is not None:
        drawn = _own_scenes(scene) or (simulation.scenario(preview, seed),)
        _preview(_adapted(drawn, size or "640x480", fps, cycle)[0], out or Path("preview_output") / preview, quality)
    else:
        drawn = _own_scenes(scene) or simulation.draw_scenes(scenes, seed, cast("simulation.Split", split))
        _simulate(_adapted(drawn, size or "1280x960", fps, cycle), out, (seed, split, cycle), jobs, quality)


@app.command("export-yolo")
def export_yolo(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set with train, val and test, such as PVDN/day.")],
    out: Annotated[Path, _folder(help="Folder of the YOLO data set.")],
    preset: Annotated[str | None, typer.Option(metavar="NAME", help=_BOXES_HELP)] = None,
    size: Annotated[int, typer.Option(min=32, max=4096, help="Side of the square images, pixels.")] = 960,
) -> None:
    """Write the labelled boxes of DATA as a YOLO data set."""
    from foreglow.learning.yolo import export_yolo
    from foreglow.reports.progress import CountProgress

    with contextlib.closing(CountProgress("images")) as progress:
        export = export_yolo(data, out, preset_name=preset, size_px=size, progress=progress)
    counts = ", ".join(f"{name} {count} ({export.num_boxes[name]} boxes)" for name, count in export.num_images.items())
    typer.echo(f"wrote {export.data_file}: images of {counts}; boxes: {export.settings.boxes}")


@yolo.command("train")
def yolo_train(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set, or what export-yolo made of one.")],
    out: Annotated[Path, _folder(help="Folder of the run; an interrupted one goes on.")],
    size: Annotated[str, typer.Option(metavar="n|t|s|m|l|x", help="Size of the network; s and x in the paper.")] = "s",
    image_size: Annotated[int, typer.Option(help="Side of the images, a multiple of 32; 960 in the paper.")] = 320,
    epochs: Annotated[int, typer.Option(help="Passes over the training split.")] = 3,
    batch: Annotated[int, typer.Option(help="Images a step.")] = 16,
    seed: Annotated[int, typer.Option(help="Of weights, order and augmentation.")] = 0,
    device: Annotated[str, typer.Option(metavar="auto|cpu|N", help="Where to train; N is a GPU.")] = "auto",
    backend: Annotated[str, typer.Option(metavar="libreyolo|ultralytics", help="Which library.")] = "libreyolo",
    preset: Annotated[str | None, typer.Option(metavar="NAME", help=_BOXES_HELP)] = None,
) -> None:
    """Train a YOLO from random weights on the labelled boxes of DATA."""
    from foreglow.config import validated
    from foreglow.learning.yolo import YoloConfig, train_yolo
    from foreglow.reports.progress import CountProgress

    fields = {"backend": backend, "size": size, "epochs": epochs, "batch": batch, "seed": seed, "device": device}
    config = validated(YoloConfig, fields | {"image_size_px": image_size}, "yolo train")
    with contextlib.closing(CountProgress("images exported")) as progress:
        run = train_yolo(data, out, config, preset_name=preset, progress=progress)
    millions, billions = run.num_parameters / 1e6, run.num_multiply_adds / 1e9
    typer.echo(f"wrote {run.weights}: {millions:.2f} million parameters, {billions:.2f} billion multiply-adds an image")


@yolo.command("predict")
def yolo_predict(
    trained: Annotated[Path, _argument(metavar="RUN", help="Folder of a finished `yolo train`.")],
    split: Annotated[Path, _argument(metavar="SPLIT", help="A PVDN split, such as PVDN/day/val.")],
    out: Annotated[Path, _file(help="The predictions to write, JSON for `evaluate --predictions`.")],
) -> None:
    """Write what a trained YOLO finds in a split."""
    from foreglow.datasets import PVDN
    from foreglow.evaluation.predictions import write_predictions
    from foreglow.learning.yolo import predict_yolo, read_yolo_run
    from foreglow.reports.progress import CountProgress

    with contextlib.closing(CountProgress("images")) as progress:
        found = predict_yolo(read_yolo_run(trained), PVDN(split), progress=progress)
    write_predictions(out, found.predictions)
    typer.echo(f"wrote {out}: {len(found.frame_ms)} images, {found.frame_ms.mean():.1f} ms an image")


@experiments.command("simulator")
def experiment_simulator(
    data: Annotated[Path, _argument(metavar="DATA", help="A simulated split, or a folder that holds one.")],
    out: Annotated[Path, _folder(help="Folder for the report.")],
    real_labels: Annotated[
        Path | None, _file(help="PVDN/night/val, or a JSON digest of its labels, to compare with.")
    ] = None,
    real_image: Annotated[Path | None, _file(help="A real image of the same exposure, to compare with.")] = None,
) -> None:
    """Hold a simulated data set beside real drives: labels, pixels, and the time that indirect light leads."""
    from foreglow.experiments.simulator import examine
    from foreglow.reports.simulator_page import write_report

    report = write_report(examine(data, real_labels, real_image), out)
    typer.echo(f"look in {report}")


@experiments.command("detector")
def experiment_detector(
    data: Annotated[Path, _argument(metavar="DATA", help="A data set with train, val and test.")],
    out: Annotated[Path, _folder(help="Folder for the report; an interrupted experiment in it goes on.")],
    baseline_model: TrainedOption = None,
    paper_model: TrainedOption = None,
    published: Annotated[Path | None, _file(help="The published weights, by import-weights.")] = None,
    compact_model: TrainedOption = None,
    our_model: TrainedOption = None,
    yolo_small: Annotated[Path | None, _file(metavar="RUN", help="A finished `yolo train`.")] = None,
    yolo_large: Annotated[Path | None, _file(metavar="RUN", help="Likewise, of size x.")] = None,
    no_yolo: Annotated[bool, typer.Option("--no-yolo", help="Leave both YOLOs out.")] = False,
    no_training: Annotated[bool, typer.Option("--no-training", help="Only rows whose model is given.")] = False,
    rows: Annotated[str | None, typer.Option(metavar="NAME,NAME", help="Only these rows [default: all].")] = None,
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
    from foreglow.experiments.detector_plan import ROWS, DetectorPlan

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


def main() -> None:
    """Runs the command line."""
    app()


def _one_line(error: Exception) -> str:
    """What is wrong, in one line."""
    if isinstance(error, ModuleNotFoundError):
        extra = EXTRAS[str(error.name)]
        return f"{error.name} is not installed; this command needs: pip install 'foreglow[{extra}]'"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _configuration(preset: str, file: Path | None, model: Path | None) -> PipelineConfig:
    """The preset's configuration, overridden by the file's fields, and by the model given."""
    from foreglow import config

    configuration = config.preset(preset)
    if file is not None:
        configuration = config.read_config(file, configuration)
    if model is not None:
        classifier = configuration.classifier.model_copy(update={"model": model})
        configuration = configuration.model_copy(update={"classifier": classifier})
    return configuration


def _evaluated_configuration(
    predictions: Path | None, model: Path | None, preset: str | None, config: Path | None, threshold: float | None
) -> PipelineConfig:
    """What `evaluate` runs on the split, if it has no predictions already."""
    given = {"model": model, "preset": preset, "config": config}
    for name in [name for name, value in given.items() if value is not None and predictions is not None]:
        raise ValueError(f"evaluate: expected --predictions or --{name}, got both")
    configuration = _configuration(preset or "paper", config, model)
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
    from foreglow.evaluation import examine, read_predictions, read_split_labels

    found = read_predictions(predictions)
    return examine(read_split_labels(PVDN(split)), found, threshold, str(predictions))


def _examined_model(split: Path, configuration: PipelineConfig, out: Path | None, seed: int | None) -> Examination:
    """All figures of a pipeline that runs on the split now; with `seed`, on disturbed images too."""
    from foreglow.datasets import PVDN
    from foreglow.evaluation import examine, read_predictions, read_split_labels
    from foreglow.evaluation.robustness import robustness
    from foreglow.reports.progress import ProgressSink

    dataset = PVDN(split)
    labels = read_split_labels(dataset)
    with tempfile.TemporaryDirectory() as temporary:
        folder = out or Path(temporary)
        summary = _run(dataset, str(split), folder, configuration, has_video=False)
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


def _detector_report(data: Path, out: Path, plan: DetectorPlan) -> Path:
    """Runs the experiment and writes its report, whose path it returns."""
    from foreglow.datasets import PVDN, split_folder
    from foreglow.experiments.detector import run_experiment
    from foreglow.experiments.detector_pictures import pictures
    from foreglow.reports.detector_page import write_report
    from foreglow.reports.progress import CountProgress, TrainingBar

    with contextlib.closing(CountProgress()) as progress, contextlib.closing(TrainingBar()) as training:

        def show(things: str, num_done: int, num_things: int) -> None:
            training.close()  # one bar at a time; it comes back with the next training
            progress.show(things, num_done, num_things)

        results = run_experiment(data, out, plan, progress=show, training=training)
    return write_report(results, pictures(results, PVDN(split_folder(data, plan.split))), out)


def _opened(source: Path, out: Path, on_error: str = "stop") -> FrameSource:
    """The frames of `source`, which must not be what the results in `out` overwrite."""
    from foreglow.datasets import open_source
    from foreglow.runtime import RESULT_NAMES

    if source.resolve() in [(out / name).resolve() for name in RESULT_NAMES]:
        raise ValueError(f"{source}: expected a source that the results in {out} do not overwrite")
    if source.resolve() == out.resolve() and source.is_dir():  # a picture in it would be a source of the next run
        raise ValueError(f"{out}: expected another folder for the results than the source")
    return open_source(source, on_error=cast("OnError", on_error))


def _simulated_drive() -> FrameSource:
    """A drive that is worth seeing: a bend, from behind which a car comes."""
    from foreglow.simulation import adapted, scenario, simulate

    return simulate(adapted(scenario(DEMO_SCENARIO, DEMO_SEED), (640, 480), 9.0, "day"))


def _run(
    frames: FrameSource,
    name: str,
    out: Path,
    configuration: PipelineConfig,
    *,
    has_video: bool,
    limit: int | None = None,
) -> RunSummary:
    """Runs the pipeline over `frames`, with a progress bar where there is a terminal."""
    from foreglow.pipeline import Pipeline
    from foreglow.reports.progress import ProgressSink
    from foreglow.runtime import OutputFolder, run

    pipeline = Pipeline(configuration)
    folder = OutputFolder(out)
    num_frames = frames.num_frames if limit is None else min(limit, frames.num_frames or limit)
    sinks = [ProgressSink(num_frames), *_picture_sinks(frames, folder, has_video)]
    return run(frames, pipeline, folder, sinks=sinks, limit=limit, source_name=name)


def _picture_sinks(frames: FrameSource, folder: OutputFolder, has_video: bool) -> list[ResultSink]:
    """The sink for the annotated pictures, if they are wanted: a picture of a single image, else a video."""
    if not has_video:
        return []
    from foreglow.reports.video import PictureSink, VideoSink

    if frames.num_frames == 1:
        return [PictureSink(folder.partial("overlay.png"))]
    return [VideoSink(folder.partial("overlay.mp4"), frames.rate_hz)]


def _own_scenes(files: list[Path] | None) -> tuple[Scene, ...]:
    """The scenes in the given files."""
    from foreglow.simulation import read_scene

    return tuple(read_scene(file) for file in files or ())


def _adapted(scenes: tuple[Scene, ...], size: str, fps: float, cycle: str) -> tuple[Scene, ...]:
    """The scenes with the size, the frame rate and the exposure that were asked for."""
    from foreglow.simulation import adapted

    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"size: expected WIDTHxHEIGHT such as 1280x960, got {size!r}")
    return tuple(adapted(scene, (int(width), int(height)), fps, cycle) for scene in scenes)


def _preview(scene: Scene, out: Path, quality: str) -> None:
    """Renders one drive with its labels drawn, and says where to look."""
    from foreglow.reports.preview import preview
    from foreglow.reports.progress import SceneProgress
    from foreglow.simulation import drive_frames

    out.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(SceneProgress(1, scene.num_frames)) as progress:
        sheet, movie = preview(drive_frames(scene, quality), scene.num_frames, scene.rate_hz, out, progress)
    typer.echo(f"{scene.num_frames} frames of {scene.name}: {sheet} and {movie}")


def _simulate(
    scenes: tuple[Scene, ...], out: Path | None, origin: tuple[int, str, str], jobs: int, quality: str
) -> None:
    """Writes the data set, and says what is in it."""
    from foreglow.reports.progress import SceneProgress
    from foreglow.reports.tables import dataset_lines
    from foreglow.simulation import DatasetConfig, drive_frames, simulate_dataset

    if out is None:
        raise ValueError("simulate: expected --out DIR, --preview NAME or --print NAME")
    seed, split, cycle = origin
    config = DatasetConfig.of(seed=seed, split=split, cycle=cycle, quality=quality)
    drive = functools.partial(drive_frames, quality=quality)
    with contextlib.closing(SceneProgress(len(scenes), sum(one.num_frames for one in scenes))) as progress:
        summary = simulate_dataset(out, scenes, drive, config, jobs=jobs, progress=progress)
    typer.echo("\n".join(dataset_lines(summary)))


def _finish(summary: RunSummary, out: Path) -> None:
    """Says on stdout what came of a run; exits with 130 where it was interrupted."""
    from foreglow.reports.tables import run_lines

    typer.echo("\n".join(run_lines(summary, out)))
    if not summary.is_complete:
        raise typer.Exit(130)


if __name__ == "__main__":
    main()
