"""The rows of the detector's table, what the user decides about them, and their models: given, or trained here."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from foreglow.checksums import CHECKSUMS
from foreglow.classifier import OnnxClassifier
from foreglow.classifier.learnt import learnt_proposals
from foreglow.config import ClassifierConfig, PipelineConfig, preset
from foreglow.datasets import SplitName, open_labelled, split_folder
from foreglow.files import file_digest, read_plain_json
from foreglow.lab.learning.training_run import CONFIG, training_configuration
from foreglow.lab.studies.progress import Progress
from foreglow.wording import shortened

if TYPE_CHECKING:
    from foreglow.lab.learning.training_progress import RunProgress
    from foreglow.lab.learning.yolo import YoloRun

RowKind: TypeAlias = Literal["classifier", "yolo"]

THRESHOLD = 0.5
"""A box counts if its score is above. Source: published evaluation."""


@dataclass(frozen=True, slots=True)
class RowSpec:
    """One row of the table.

    Attributes:
        title: What the reader sees.
        kind: Proposals with a classifier, or a YOLO.
        preset: The proposals that are classified, or on whose labelled boxes the YOLO is trained.
        recipe: How the classifier is trained here, a name of `learning.recipes`; empty where it is only ever given.
        size: The YOLO's.
        option: The option of the command that gives a trained model.
        working_size_px: Width and height at which proposals are found; None for the preset's reduction.
    """

    title: str
    kind: RowKind
    preset: str
    option: str
    recipe: str = ""
    size: Literal["", "s", "x"] = ""
    working_size_px: tuple[int, int] | None = None

    @property
    def configuration(self) -> PipelineConfig:
        """The preset, at the row's size of the image."""
        return preset(self.preset).changed("proposals", working_size_px=self.working_size_px)


ROWS: dict[str, RowSpec] = {
    "baseline-small": RowSpec(
        "Baseline's preset at 345 x 240, paper's network",
        "classifier",
        "baseline",
        "--baseline-small-model",
        "paper",
        working_size_px=(345, 240),
    ),
    "baseline": RowSpec("Baseline's preset, paper's network", "classifier", "baseline", "--baseline-model", "paper"),
    "paper": RowSpec("Paper's preset and network", "classifier", "paper", "--paper-model", "paper"),
    # The weights are older than the paper: they were learnt on the baseline's boxes.
    "published": RowSpec("Baseline's preset, published weights", "classifier", "baseline", "--published"),
    "compact": RowSpec("Paper's preset, compact network", "classifier", "paper", "--compact-model", "compact"),
    "ours": RowSpec("Ours: preset foreglow, our network", "classifier", "foreglow", "--our-model", "foreglow"),
    "yolo-small": RowSpec("YOLO, small", "yolo", "paper", "--yolo-small", size="s"),
    "yolo-large": RowSpec("YOLO, large", "yolo", "paper", "--yolo-large", size="x"),
}
"""The table's rows by name, in its order."""

COMPARISONS = (
    ("paper", "baseline"),
    ("compact", "paper"),
    ("ours", "paper"),
    ("ours", "baseline"),
    ("ours", "yolo-small"),
)
"""Rows whose F is compared scene by scene: the first less the second."""


@dataclass(frozen=True, slots=True)
class DetectorPlan:
    """What is asked for.

    Attributes:
        rows: Names of rows, of `ROWS`.
        given: Trained models by row: an ONNX file or a folder of `train`, or for a YOLO a folder of `yolo train`.
        may_train: Whether rows without a given model are trained.
        with_yolo: Whether the YOLO rows are made.
        epochs: By recipe, how many to train; a recipe that is not named has its own number.
        patience: Training ends this many epochs after the best one; None for the recipe's.
        yolo_epochs: Passes over the training split for a YOLO that is trained here.
        yolo_image_size_px: Side of its images.
        device: `auto`, `cpu` or `cuda`.
        white_level: That of the camera, as of a pipeline's guard; a YOLO reads images of 8 bits only.
    """

    rows: tuple[str, ...] = tuple(ROWS)
    given: Mapping[str, Path] = field(default_factory=dict)
    split: SplitName = "test"
    may_train: bool = True
    with_yolo: bool = True
    epochs: Mapping[str, int] = field(default_factory=dict)
    patience: int | None = None
    seed: int = 1
    yolo_epochs: int = 3
    yolo_image_size_px: int = 320
    device: str = "auto"
    white_level: int | None = None

    def __post_init__(self) -> None:
        for name in (*self.rows, *self.given):
            if name not in ROWS:
                raise ValueError(f"rows: expected some of {', '.join(ROWS)}, got {name!r}")
        if len(set(self.rows)) < len(self.rows):
            raise ValueError(f"rows: expected each once, got {', '.join(self.rows)}")
        for name in self.given:
            if name not in self.rows or (ROWS[name].kind == "yolo" and not self.with_yolo):
                raise ValueError(
                    f"{ROWS[name].option}: expected its row {name} among those that are made, which are "
                    f"{', '.join(row for row in self.rows if self.with_yolo or ROWS[row].kind != 'yolo')}"
                )
        check_given(self.given, self.white_level)

    def configuration(self, spec: RowSpec) -> PipelineConfig:
        """That of a row, for this camera."""
        return spec.configuration.changed("guard", white_level=self.white_level)


PAPER_YOLO = "960 px; its repository: 200 epochs from COCO weights"

_FORMAT = 3  # of a row's file; with another number all rows are made anew
_YOLO_FORMAT = 2  # the same of a YOLO's


@dataclass(frozen=True, slots=True)
class Workspace:
    """Where an experiment runs.

    Attributes:
        out: Everything that is made goes here.
        progress: Called as it goes on.
    """

    data: Path
    out: Path
    plan: DetectorPlan
    progress: Progress | None = None
    training: RunProgress | None = None

    def progress_of(self, step: str) -> Callable[[int, int], None] | None:
        """What to call as a step goes on, with how much is done and how much there is; None if nobody listens."""
        return None if self.progress is None else functools.partial(self.progress, step)


def check_given(given: Mapping[str, Path], white_level: int | None = None) -> None:
    """Passes models that can be used, by the names of their rows: so that none fails after hours of other rows.

    Raises:
        FileNotFoundError: If one is missing.
        ValueError: If one is broken, was trained on another preset's boxes or for another white level, or says that it
            is another network.
        ModuleNotFoundError: If the library of a YOLO is not installed.
    """
    for name, path in given.items():
        spec = ROWS[name]
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such model, given with {spec.option}")
        file = _model_file(path, spec.kind)
        if spec.kind == "yolo":
            from foreglow.lab.learning.yolo import check_usable, read_yolo_run

            check_usable(read_yolo_run(path))
        else:
            _check_network(file, OnnxClassifier(ClassifierConfig(model=file)).metadata, spec)
            known = _configuration(path, spec).guard.white_level
            if known not in (None, white_level):
                raise ValueError(f"{path}: guard.white_level: expected that of the table, {white_level}, got {known}")


def _check_network(file: Path, metadata: Mapping[str, str], spec: RowSpec) -> None:
    """ValueError if a model says by its recipe, as `train` writes it, that it is not of this row."""
    from foreglow.lab.learning.recipes import RECIPES

    if "recipe" not in metadata:
        return
    try:
        network = json.loads(metadata["recipe"])["network"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{file}: metadata: recipe: expected that of a training, as JSON") from None
    networks = {recipe.network for recipe in RECIPES.values()}
    if spec.recipe == "foreglow":
        wanted = networks - {RECIPES["paper"].network}  # ours, before and after a change of the recipe
    else:
        wanted = {RECIPES[spec.recipe].network} if spec.recipe else set()
    if network not in wanted:
        words = f"a network {' or '.join(sorted(wanted))}" if wanted else "weights of `import-weights`"
        raise ValueError(f"{file}: metadata: recipe: expected {words} with {spec.option}, got {shortened(network)}")


def missing_reason(name: str, plan: DetectorPlan) -> str | None:
    """Why row `name` cannot be made with this plan on this machine, and what to do; None if it can."""
    spec = ROWS[name]
    if spec.kind == "yolo" and not plan.with_yolo:
        return "left out (--no-yolo)"
    if name in plan.given:
        return None
    if not spec.recipe and spec.kind == "classifier":
        return f"not given ({spec.option} FILE.onnx, made by import-weights)"
    if not plan.may_train:
        return f"not given ({spec.option}), and nothing is trained (--no-training)"
    if spec.kind == "yolo":
        if spec.size == "x" and not _has_gpu(plan):
            command = "foreglow yolo train DATA --size x --image-size 960 --epochs 200 --out RUN"
            return f"needs a GPU: run there {command}, and give it with {spec.option} RUN"
        if not has_library():
            return "needs pip install 'foreglow[yolo]'"
    return None


def row_key(name: str, workspace: Workspace) -> str:
    """Digest of what decides the figures of row `name`: a row with the same key need not be made again."""
    spec, plan = ROWS[name], workspace.plan
    parts: list[Any] = [_FORMAT, split_digest(split_folder(workspace.data, plan.split)), THRESHOLD]
    parts.append(spec.configuration.proposals.model_dump(mode="json"))
    parts += [_YOLO_FORMAT] if spec.kind == "yolo" else []
    parts += [] if plan.white_level is None else [{"white_level": plan.white_level}]
    if name in plan.given:
        parts.append(given_digest(name, plan.given[name]))
    else:
        parts += [split_digest(split_folder(workspace.data, split)) for split in ("train", "val")]
        if spec.kind == "yolo":
            parts.append([plan.yolo_epochs, plan.yolo_image_size_px, plan.seed, spec.size])
        else:
            parts.append(_recipe(spec.recipe, plan).model_dump(mode="json"))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def given_digest(name: str, given: Path) -> str:
    """Digest of what decides what the given model of row `name` finds, wherever it lies.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If it is broken, or was trained on another preset's boxes.
    """
    spec = ROWS[name]
    parts: list[Any] = [file_digest(_model_file(given, spec.kind))]
    if spec.kind == "yolo":
        from foreglow.lab.learning.yolo import read_yolo_run

        run = read_yolo_run(given)
        settings = run.settings.model_dump(mode="json", exclude={"weights_sha256"})  # of what it started from
        parts += [settings, run.results.model_dump(mode="json", exclude={"seconds"})]
    else:
        used = _with_model(_configuration(given, spec), Path())
        parts.append(used.model_dump(mode="json", include={"proposals", "classifier", "standing"}))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def classifier_model(name: str, workspace: Workspace) -> tuple[PipelineConfig, str]:
    """The pipeline with the classifier of row `name`, as given or trained now, and how that came about.

    An interrupted training goes on.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a given model was trained on another preset's boxes.
        ModuleNotFoundError: If training needs an extra that is not installed.
    """
    spec = ROWS[name]
    given = workspace.plan.given.get(name)
    if given is None:
        given = workspace.out / "models" / name
        _train(name, workspace, given)
    model = _model_file(given, spec.kind)
    note = _note(given) if given.is_dir() else f"given: {given.name}, SHA-256 {file_digest(given)[:12]}"
    used = _configuration(given, spec).changed("guard", white_level=workspace.plan.white_level)
    return _with_model(used, model), note


def _configuration(given: Path, spec: RowSpec) -> PipelineConfig:
    """That of the row, or for the folder of a training that of the training, which has the row's proposals.

    Raises:
        FileNotFoundError: If such a folder has none.
        ValueError: If a model was trained on other boxes, as far as it or its training's folder tells.
    """
    wanted, file = spec.configuration, _model_file(given, spec.kind)
    learnt = learnt_proposals(file)
    if learnt is not None and learnt != wanted.proposals:
        raise ValueError(f"{file}: metadata: proposals: expected those of {spec.title}")
    trained = training_configuration(file, wanted)
    if trained is None:
        if given.is_dir():
            raise FileNotFoundError(f"{given / CONFIG}: no such file, expected a finished training")
        return wanted
    if trained.proposals.model_dump() != wanted.proposals.model_dump():
        raise ValueError(f"{file.with_name(CONFIG)}: proposals: expected those of {spec.title}")
    return trained if given.is_dir() else wanted


def yolo_run(name: str, workspace: Workspace) -> YoloRun:
    """The YOLO of row `name`, as given or trained now; an interrupted training goes on.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a file is broken.
        ModuleNotFoundError: If the library is not installed.
    """
    from foreglow.lab.learning.yolo import YoloConfig, read_yolo_run, train_yolo

    spec, plan = ROWS[name], workspace.plan
    if name in plan.given:
        return read_yolo_run(plan.given[name])
    config = YoloConfig(
        size=spec.size or "s",
        image_size_px=plan.yolo_image_size_px,
        epochs=plan.yolo_epochs,
        seed=plan.seed,
        device={"cuda": "0"}.get(plan.device, plan.device),
    )
    progress = workspace.progress_of(f"{name}: images exported")
    folder = workspace.out / "models" / name
    return train_yolo(workspace.data, folder, config, preset_name=spec.preset, progress=progress)


def yolo_note(run: YoloRun) -> str:
    """How a YOLO came about, for the reader."""
    config = run.settings.training
    return (
        f"{config.backend}, size {config.size}, {config.image_size_px} px, {config.epochs} epochs "
        f"(paper: {PAPER_YOLO}), boxes: {run.settings.boxes}, seed {config.seed}"
    )


_BESIDE_IMAGES = ("labels", "scenes.jsonl", "simulation")
"""What belongs to a split beside its images."""


def split_digest(split: Path) -> str:
    """SHA-256 of what is in a split, wherever it lies: images, labels, and what a simulator wrote beside them."""
    digest = hashlib.sha256()
    dataset = open_labelled(split)
    images = [dataset.image_path(image_id) for image_id in dataset.frame_ids]
    earlier = (
        path.with_name(before.file_name)
        for image_id, path in zip(dataset.frame_ids, images, strict=True)
        if (before := dataset.image(image_id).earlier) is not None
    )
    beside = (path for name in _BESIDE_IMAGES for path in [dataset.root / name, *(dataset.root / name).rglob("*")])
    for path in (*images, *earlier, *sorted(beside)):
        # Checksums say nothing new, and what is hidden is being written.
        if path.is_file() and path.name != CHECKSUMS and not path.name.startswith("."):
            digest.update(f"{path.relative_to(dataset.root)} {file_digest(path)}\n".encode())
    return digest.hexdigest()


def _train(name: str, workspace: Workspace, folder: Path) -> None:
    from foreglow.lab.learning.training_run import train_model

    spec, plan = ROWS[name], workspace.plan
    train_model(
        [workspace.data],
        _recipe(spec.recipe, plan),
        plan.configuration(spec),
        folder,
        device=plan.device,
        cache=workspace.out / "samples",
        progress=workspace.training,
    )


def _recipe(name: str, plan: DetectorPlan) -> Any:
    from foreglow.lab.learning import recipes

    fields: dict[str, Any] = {"seed": plan.seed}
    if name in plan.epochs:
        fields["epochs"] = plan.epochs[name]
    if plan.patience is not None:
        fields["patience"] = plan.patience
    return recipes.changed(recipes.recipe(name), fields)


def _with_model(config: PipelineConfig, model: Path) -> PipelineConfig:
    """`config` with this model, at the table's threshold, on one thread of the processor."""
    fields = {"model": model, "score_threshold": THRESHOLD, "num_threads": 1, "device": "cpu"}
    return config.model_copy(update={"classifier": config.classifier.model_copy(update=fields)})


def _note(folder: Path) -> str:
    """What the summary of a training says: epochs made of those allowed, the best epoch, the seed."""
    path = folder / "summary.json"
    try:
        summary = read_plain_json(path)
        planned, recipe = summary["recipe"]["epochs"], summary["recipe"]["network"]
        epochs, best = summary["num_epochs"], summary["best_epoch"]["number"]
        return f"network {recipe}, {epochs} of {planned} epochs, best {best}, seed {summary['seed']}"
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file, expected a finished training") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: expected the summary of a training: {error!r}") from error


def _model_file(given: Path, kind: str) -> Path:
    """The file that decides what a given model does."""
    if kind == "yolo":
        from foreglow.lab.learning.yolo import read_yolo_run

        return read_yolo_run(given).weights
    path = given / "model.onnx" if given.is_dir() else given
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected an ONNX model")
    return path


def has_library() -> bool:
    """Whether the library that trains YOLOs is installed."""
    return "libreyolo" in sys.modules or importlib.util.find_spec("libreyolo") is not None


def _has_gpu(plan: DetectorPlan) -> bool:
    if importlib.util.find_spec("torch") is None:
        return False
    import torch

    return plan.device != "cpu" and torch.cuda.is_available()
