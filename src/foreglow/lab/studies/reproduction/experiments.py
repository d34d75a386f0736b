"""The experiments behind the page: what each runs, and the command that does the same."""

from __future__ import annotations

import functools
import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foreglow.config import PipelineConfig, preset
from foreglow.datasets import (
    SPLIT_NAMES,
    CategoryConfig,
    ImageCategory,
    SplitName,
    open_labelled,
)
from foreglow.datasets.pvdn import is_split
from foreglow.display.summary_lines import counted as counted_words
from foreglow.files import to_json, write_json_results
from foreglow.lab.evaluation.vehicles import HUMAN_DELAY_S
from foreglow.lab.studies.detector.rows import ROWS
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.lab.studies.progress import Progress
from foreglow.lab.studies.reproduction.plan import TRAINED, ReproductionPlan
from foreglow.lab.studies.time_benefit.metrics import HUMAN_AFTER_PRODUCTION_S
from foreglow.models import model_path
from foreglow.parallel import Workers
from foreglow.provenance import provenance
from foreglow.runtime.ros2 import STAGE_NODES
from foreglow.whole_files import write_atomic

if TYPE_CHECKING:
    from foreglow.lab.learning.training_progress import Epoch


@dataclass(frozen=True, slots=True)
class Experiment:
    """What is run for some claims.

    Attributes:
        results: The file with its results, in its folder.
        command: The command that does the same, of a plan and its own folder in that of the reproduction.
        run: Runs it into that folder.
        measured_on: What its results say of that, with fields as in a claim's `ours`.
        needs: Splits that it needs.
        is_simulated: Whether it needs simulated drives.
        runs_pipeline: Whether our pipeline has a part in it.
    """

    results: str
    command: Callable[[ReproductionPlan, Path], Sequence[object]]
    run: Callable[[ReproductionPlan, Path, Workers, Progress], None]
    measured_on: str = ""
    needs: tuple[SplitName, ...] = ("test",)
    is_simulated: bool = False
    runs_pipeline: bool = False

    def reason(self, plan: ReproductionPlan) -> str:
        """Why it cannot be run with this data; empty if it can."""
        missing = [name for name in self.needs if not plan.has(name)]
        if missing:
            return f"DATA has no {' and no '.join(missing)}"
        return "DATA is not simulated" if self.is_simulated and not plan.is_simulated else ""


def _settings(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    """What the paper states of its settings, as they are here."""
    from foreglow.datasets.simulated.production import ProductionConfig
    from foreglow.lab.learning.recipes import recipe
    from foreglow.photometry import read_headlamps

    paper = recipe("paper")
    settings = {
        "paper": preset("paper"),
        "recipe": paper,
        "epochs": plan.epochs or paper.epochs,
        "production": ProductionConfig(),
        "headlamps": {"num_leds": read_headlamps(None).num_leds},
        "ros2": {"num_nodes": len(STAGE_NODES) + 1, "nodes": ", ".join(STAGE_NODES)},
        "human_s": HUMAN_DELAY_S,
        "human_after_production_s": HUMAN_AFTER_PRODUCTION_S,
    }
    write_json_results(folder / "results.json", {"made_with": provenance(), **to_json(settings)})


def counted_splits(plan: ReproductionPlan) -> dict[str, dict[str, Any]]:
    """How much is in each split of DATA, of both cycles."""
    folders = (path for name in SPLIT_NAMES for path in (plan.data / name, *plan.data.glob(f"*/{name}")))
    splits: dict[str, dict[str, Any]] = {}
    for path in sorted(filter(is_split, folders)):
        dataset = open_labelled(path)
        splits[str(path.relative_to(plan.data))] = {
            "num_images": len(dataset),
            "num_sequences": len(dataset.sequences),
            "rate_hz": dataset.rate_hz,
        }
    return splits


def _data(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    """What is in DATA."""
    splits = counted_splits(plan)
    test = open_labelled(plan.split("test"))
    height_px, width_px = test.read(test.frame_ids[0]).image.shape
    words = ", ".join(
        f"{name} {counted_words(about['num_images'], 'image')} of {counted_words(about['num_sequences'], 'drive')} "
        f"at {about['rate_hz']:g} Hz"
        for name, about in splits.items()
    )
    record = {
        "num_images": sum(about["num_images"] for about in splits.values()),
        "width_px": width_px,
        "height_px": height_px,
        "rate_hz": test.rate_hz,
        "splits": words,
        "test": splits[str(plan.split("test").relative_to(plan.data))],
    }
    write_json_results(folder / "results.json", {"made_with": provenance(), **record})


def _tune(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:
    from foreglow.lab.learning.tuning import TuningSettings, tune
    from foreglow.lab.reports.tuning_page import write_report

    seen: dict[str, Any] = {"num_images": plan.images, "white_level": plan.config.guard.white_level}
    settings = TuningSettings(num_trials=plan.trials, objective="q-only", **seen)
    write_report(tune(plan.root, folder, settings, progress, workers=workers), folder)


def _detector(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.detector.page import pictures, write_report
    from foreglow.lab.studies.detector.rows import DetectorPlan
    from foreglow.lab.studies.detector.run import run_experiment

    asked = DetectorPlan(
        rows=tuple(_detector_rows(plan)),
        given={name: model_path(path) for name, path in _detector_models(plan).items()},
        may_train=plan.may_train,
        epochs={} if plan.epochs is None else {"paper": plan.epochs},
        device=plan.device,
        white_level=plan.config.guard.white_level,
    )
    results = run_experiment(plan.root, folder, asked, progress=progress, training=_Training(progress))
    write_report(results, pictures(results, open_labelled(plan.split("test"))), folder)


@dataclass(frozen=True, slots=True)
class _Training:
    """Passes the progress of a training on: see `RunProgress`."""

    progress: Progress

    def samples(self, split: str, num_done: int, num_images: int) -> None:
        self.progress(f"{split} images", num_done, num_images)

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        self.progress(f"epoch {epoch}, steps", num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        self.progress("epochs", epoch.number, num_epochs)


def _detector_rows(plan: ReproductionPlan) -> list[str]:
    """Of the YOLOs those that are given: on a processor none can be trained that is worth its row."""
    trained = TRAINED if plan.may_train else ()
    return [name for name in ROWS if name in trained or name in _detector_models(plan)]


def _detector_models(plan: ReproductionPlan) -> dict[str, Path]:
    """The models that are given, and ours where it is one for the proposals of its row."""
    own, models = plan.config.classifier.model, dict(plan.models)
    if own is not None and plan.config.proposals == preset(ROWS["ours"].preset).proposals:
        models["ours"] = own
    return models


def _distance(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.distance.page import write_report
    from foreglow.lab.studies.distance.run import DistancePlan, run_experiment

    write_report(run_experiment(plan.root, DistancePlan(), progress), folder)


def _time_benefit(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.time_benefit.page import write_report
    from foreglow.lab.studies.time_benefit.run import run_experiment

    categories = CategoryConfig(low_beam_trigger=ImageCategory(plan.production_category))
    datasets = [open_labelled(plan.split(name)) for name in _pooled(plan)]
    write_report(run_experiment(datasets, plan.config, categories, progress, _chain(plan, folder)), folder)


def _pooled(plan: ReproductionPlan) -> list[SplitName]:
    """Validation and test, as in the paper, where both have the same frame rate."""
    names: list[SplitName] = ["val", "test"]
    rates = {name: _rate_hz(plan.split(name)) for name in names if plan.has(name)}
    return [name for name, rate_hz in rates.items() if rate_hz == rates["test"]]


@functools.cache
def _rate_hz(split: Path) -> float:
    return open_labelled(split).rate_hz


def _chain(plan: ReproductionPlan, folder: Path) -> PipelineConfig | None:
    model = plan.paper_model(folder.parent)
    return None if model is None else paper_chain(model, plan.config.guard.white_level)


def _drive(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.reproduction.drive import run_drive

    run_drive(plan.split("test"), plan.config.commanding(), folder, progress)


def _detection_range(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.detection_range.page import write_report
    from foreglow.lab.studies.detection_range.run import run_experiment

    roots = plan.straight_splits
    write_report(run_experiment(roots, plan.config, progress), roots, folder)


def _glare(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:
    from foreglow.lab.studies.glare.page import write_experiment
    from foreglow.lab.studies.glare.run import GlarePlan, run_experiment

    def show(number: int, num_done: int, num_all: int) -> None:
        progress(f"frames of scene {number}", num_done, num_all)

    scenes = write_oncoming_scenes(plan.split("test"), folder)
    asked = GlarePlan(num_scenes=plan.scenes, paper_model=plan.paper_model(folder.parent))
    config = plan.config.commanding()
    write_experiment(run_experiment(scenes, config, asked, folder, workers=workers, progress=show))


def write_oncoming_scenes(split: Path, folder: Path) -> Path:
    """A file of those scenes of `split` in which a vehicle comes towards us: only there anybody can be dazzled.

    Raises:
        ValueError: If there are none.
    """
    from foreglow.lab.simulation.writing.scene_files import read_scenes

    scenes = [
        {"sequence": number, "scene": scene.model_dump(mode="json")}
        for number, scene in read_scenes(split / "scenes.jsonl")
        if any(vehicle.lane == "oncoming" for vehicle in scene.vehicles)
    ]
    if not scenes:
        raise ValueError(f"{split}: expected a scene with an oncoming vehicle, found none")
    write_atomic(folder / SCENES, "".join(f"{json.dumps(scene)}\n" for scene in scenes).encode())
    return folder / SCENES


SCENES = "scenes.jsonl"
"""What the experiment on glare drives, in its folder."""


def _runtime(plan: ReproductionPlan, folder: Path, workers: Workers, progress: Progress) -> None:  # noqa: ARG001
    from foreglow.lab.studies.runtime.page import write_report
    from foreglow.lab.studies.runtime.run import run_experiment

    split, chain = plan.split("test"), _chain(plan, folder)
    write_report(run_experiment(split, plan.config, _networks(), NUM_PACED, progress, chain), folder)


def _networks() -> tuple[str, ...]:
    """What run-times are measured in: a ROS 2 network where it can be used."""
    try:
        importlib.import_module("rclpy")
    except ImportError:
        return ("process",)
    return ("process", "ros2")


NUM_PACED = 1000
"""Frames that are sent over ROS 2, at their own rate."""


def _chain_words(plan: ReproductionPlan, folder: Path) -> tuple[object, ...]:
    model = plan.paper_model(folder.parent)
    return () if model is None else ("--paper-model", model)


def _detector_words(plan: ReproductionPlan, folder: Path) -> list[object]:
    words: list[object] = [
        "experiment",
        "detector",
        plan.root,
        "--out",
        folder,
        "--rows",
        ",".join(_detector_rows(plan)),
    ]
    for name, path in _detector_models(plan).items():
        words += [ROWS[name].option, path]
    is_trained = plan.may_train and not plan.models.keys() >= set(TRAINED)
    words += ["--epochs-paper", plan.epochs] if plan.epochs is not None and is_trained else []
    words += _camera_words(plan)
    return words if plan.device == "auto" else [*words, "--device", plan.device]


def _camera_words(plan: ReproductionPlan) -> list[Any]:
    """The option for the camera's white, of commands that take no configuration."""
    white_level = plan.config.guard.white_level
    return [] if white_level is None else ["--white-level", white_level]


EXPERIMENTS: Mapping[str, Experiment] = {
    "settings": Experiment(
        "results.json", lambda plan, folder: ("reproduce", plan.data, "--out", folder.parent), _settings, needs=()
    ),
    "data": Experiment("results.json", lambda plan, folder: ("reproduce", plan.data, "--out", folder.parent), _data),
    "tune": Experiment(
        "summary.json",
        lambda plan, folder: (
            *("tune", plan.root, "--objective", "q-only", "--trials", plan.trials, "--images", plan.images),
            *("--out", folder),
            *_camera_words(plan),
        ),
        _tune,
        "{paper.train.num_images:#image} of train, {paper.val.num_images} of val",
        ("train", "val", "test"),
    ),
    "detector": Experiment(
        "results.json", _detector_words, _detector, "{num_images:#image} of {num_sequences:#drive}, {split}"
    ),
    "distance": Experiment(
        "results.json",
        lambda plan, folder: ("experiment", "distance", plan.root, "--out", folder),
        _distance,
        "{num_images:#image}, {num_lights:#light} with a box and a known range, {split}",
        is_simulated=True,
    ),
    "drive": Experiment(
        "results.json",
        lambda plan, folder: ("demo", plan.split("test"), "--out", folder, *plan.pipeline),
        _drive,
        "{sequence}",
        runs_pipeline=True,
    ),
    "detection-range": Experiment(
        "results.json",
        lambda plan, folder: (
            *("experiment", "detection-range", *(plan.straight or (plan.root,)), "--out", folder),
            *plan.pipeline,
        ),
        _detection_range,
        "drives with an oncoming vehicle in sight: {groups.oncoming.all[name=all].num_drives}, with one ahead: "
        "{groups.ahead.all[name=all].num_drives}",
        is_simulated=True,
        runs_pipeline=True,
    ),
    "time-benefit": Experiment(
        "results.json",
        lambda plan, folder: (
            *("experiment", "time-benefit", plan.root, "--out", folder, "--split", ",".join(_pooled(plan))),
            *plan.pipeline,
            *_chain_words(plan, folder),
            *(("--production-category", plan.production_category) if plan.production_category != 6 else ()),
        ),
        _time_benefit,
        "{num_sequences:#drive}, {name}",
        runs_pipeline=True,
    ),
    "glare": Experiment(
        "results.json",
        lambda plan, folder: (
            *("experiment", "glare", folder / SCENES, "--out", folder, "--scenes", plan.scenes),
            *plan.pipeline,
            *_chain_words(plan, folder),
        ),
        _glare,
        "{seconds:.0f} s of driving",
        is_simulated=True,
        runs_pipeline=True,
    ),
    "runtime": Experiment(
        "results.json",
        lambda plan, folder: (
            *(
                "experiment",
                "runtime",
                plan.root,
                "--out",
                folder,
                *(word for kind in _networks() for word in ("--on", kind)),
            ),
            *("--frames", NUM_PACED, *plan.pipeline),
            *_chain_words(plan, folder),
        ),
        _runtime,
        "{networks[name=in process].num_frames:#image}, {data}",
        runs_pipeline=True,
    ),
}
"""What is run, by the names of the claims' studies."""
