"""The whole of `foreglow train`: from a data set and a recipe to a folder with a model and its figures."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import io
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scipy.special import expit

from foreglow.checksums import check_as_written, replace_results
from foreglow.classifier.learnt import PROPOSALS, proposals_text
from foreglow.config import PipelineConfig, ProposalConfig, config_to_toml, read_config
from foreglow.datasets import LabelledSource, SplitName, open_labelled, split_folder
from foreglow.datasets.pvdn import is_split
from foreglow.files import check_each_once, json_text
from foreglow.lab.evaluation.boxes.score_calibration import expected_calibration_error, log_loss
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.recipes import Recipe, recipe_to_toml
from foreglow.lab.learning.sample_cache import cached_samples, samples_digest
from foreglow.lab.learning.samples import Jitter, SampleConfig, Samples, check_learnable, joined, joined_digest
from foreglow.lab.learning.scores import Calibrator, Counting, doubts_of, fit_calibrator, light_logits
from foreglow.lab.learning.training_progress import RunProgress, WithEventFiles
from foreglow.provenance import provenance
from foreglow.whole_files import write_atomic

if TYPE_CHECKING:
    from foreglow.lab.learning.training import TrainingResult

MODEL, WEIGHTS, SUMMARY, RECIPE, CONFIG = "model.onnx", "weights.pt", "summary.json", "recipe.toml", "config.toml"
"""Files that a training writes to its folder, besides `training.CURVES` and the checkpoint."""

TEXTS = (RECIPE, CONFIG, SUMMARY)
"""Those of them that a user may edit: a changed one stays. The others are made again of the checkpoint."""

LABELS = {"positive": POSITIVE, "negative": NEGATIVE, "ignored": IGNORED}

NUM_COMPARED = 400
"""Validation samples, about, on which an exported model is compared with its network."""


def train_model(
    data: Sequence[Path],
    recipe: Recipe,
    config: PipelineConfig,
    folder: Path,
    *,
    teachers: Sequence[Path] = (),
    device: str = "auto",
    cache: Path | None = None,
    progress: RunProgress | None = None,
    draw: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Trains the recipe's network on the proposals of `config` in every DATA/train, and selects it on every DATA/val.

    DATA may be single splits to train on, beside at least one data set with a split val.

    An interrupted run continues when it is called again with the same arguments. Returns what `summary.json` holds.

    Args:
        data: One or more data sets with the splits train and val, or single splits to train on.
        recipe: How to train.
        config: Its proposals are the boxes that the network is trained on.
        folder: Folder for all results; made if it does not exist.
        teachers: Models whose mean the network learns as well, as the recipe's `taught` says.
        device: `cpu`, `cuda`, or `auto` for a GPU if there is one.
        cache: Folder in which samples are kept between runs; None keeps them in `folder`.
        progress: Called after every image, step and epoch.
        draw: Writes pictures of the training; called before its summary appears.

    Raises:
        FileNotFoundError: If a split, one of its files or a teacher is missing.
        ValueError: If there is no such device, a split is broken or named twice, or must not be learnt from, a teacher
            reads something else than the network, the configuration has other crops, or the folder holds another
            training, or one with a changed text.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    import onnx  # noqa: F401  (fails early if it is missing)
    import torch  # noqa: F401

    from foreglow.lab.learning.checkpoints import NAME as CHECKPOINT
    from foreglow.lab.learning.checkpoints import check_begun
    from foreglow.lab.learning.teaching import read_teachers, taught_kinds
    from foreglow.lab.learning.training import torch_device, train

    started = time.perf_counter()
    check_as_written(folder, TEXTS)
    torch_device(device)  # known before samples are made
    check_support(recipe, config)
    models = read_teachers(teachers, recipe.inputs)
    if models and not recipe.kinds:
        raise ValueError("recipe: kinds: expected true with teachers, which tell them, got false")
    names: tuple[SplitName, ...] = ("train", "val")
    whole = [path for path in data if not is_split(path)]
    if not whole:
        raise ValueError(f"{data[0]}: expected at least one data set with a split val, got single splits alone")
    learnt = [path if is_split(path) else split_folder(path, "train") for path in data]
    check_each_once(learnt, "DATA")
    judging = [split_folder(path, "val") for path in whole]
    check_apart(learnt, judging, data)
    camera = {"white_level": config.guard.white_level}
    splits = {
        "train": [open_labelled(path, **camera) for path in learnt],
        "val": [open_labelled(path, **camera) for path in judging],
    }
    check_begun(folder, recipe.model_dump(mode="json") | camera)
    if (folder / CHECKPOINT).exists():  # else there is nothing that it could not go on from
        configs = {name: _sample_config(recipe, config, name) for name in names}
        digests = {name: [samples_digest(dataset, configs[name]) for dataset in splits[name]] for name in names}
        check_begun(folder, {f"{name} data": joined_digest(found) for name, found in digests.items()})
    folder.mkdir(parents=True, exist_ok=True)
    cache = cache or folder / "samples"
    parts = {
        name: [labelled_samples(dataset, recipe, config, name, cache, progress) for dataset in splits[name]]
        for name in names
    }
    samples = {name: joined(parts[name]) for name in names}
    for name in names:
        origin = ", ".join(str(dataset.root) for dataset in splits[name])
        check_learnable(samples[name], origin, has_kinds=recipe.kinds and name == "train")
    reported = WithEventFiles(folder, progress) if importlib.util.find_spec("tensorboard") else progress
    taught = taught_kinds(models, samples["train"]) if models else None
    how: dict[str, Any] = {"taught": taught, "about": camera, "device": device, "progress": reported}
    result = train(recipe, samples["train"], samples["val"], folder, **how)
    summary = {
        "data": [str(path) for path in data],
        "teachers": {model.name: model.digest for model in models},
        **finish(recipe, result, samples["val"], folder, Counting(config.classifier.score_threshold), config.proposals),
        "samples": {name: sample_counts(split) for name, split in samples.items()},
        "without_light": [origin for name in names for origin in without_light(splits[name], parts[name])],
        "seconds": round(time.perf_counter() - started, 1),
    }
    return write_results(folder, recipe, config, summary, draw)


def check_support(recipe: Recipe, config: PipelineConfig) -> None:
    """ValueError if a configuration has other crops than those of the recipe, which are the network's."""
    given, used = config.classifier.support, recipe.inputs.support
    if given not in (None, used):
        raise ValueError(f"classifier.support: expected none, or {used} as inputs.support of the recipe, got {given}")


def training_configuration(model: Path, base: PipelineConfig | None = None) -> PipelineConfig | None:
    """The configuration that a training has written beside its model; None for a model elsewhere.

    Raises:
        ValueError: If it is broken.
    """
    file = model.with_name(CONFIG)
    return read_config(file, base) if model.name == MODEL and file.is_file() else None


def sample_counts(samples: Samples) -> dict[str, int]:
    """How many samples have each label; copies of boxes are samples, too."""
    return {kind: samples.num_labelled(label) for kind, label in LABELS.items()}


def without_light(splits: Sequence[LabelledSource], parts: Sequence[Samples]) -> list[str]:
    """Those of the splits that have no box with light among their samples: perhaps nobody has labelled them."""
    return [str(each.root) for each, part in zip(splits, parts, strict=True) if not part.num_labelled(POSITIVE)]


def write_results(
    folder: Path,
    recipe: Recipe,
    config: PipelineConfig,
    about: Mapping[str, Any],
    draw: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Writes the recipe, the configuration with the new model, and `summary.json`, whose content is returned.

    They appear together, and last: after all else that came of the training, and the pictures that `draw` writes.

    Raises:
        ValueError: If one is there that was changed since it was written.
    """
    camera = {"white_level": config.guard.white_level}
    summary = {**provenance(), **about, **camera, "recipe": recipe.model_dump(mode="json")}
    used = config.classifier.model_copy(update={"model": folder / MODEL, "support": recipe.inputs.support})
    texts = (
        recipe_to_toml(recipe),
        config_to_toml(config.model_copy(update={"classifier": used})),
        json_text(summary, indent=2),
    )
    if draw is not None:
        draw()
    replace_results(folder, dict(zip(TEXTS, map(str.encode, texts), strict=True)))
    return summary


def finish(
    recipe: Recipe, result: TrainingResult, val: Samples, folder: Path, counting: Counting, proposals: ProposalConfig
) -> dict[str, Any]:
    """Calibrates the network, writes it as weights and as an ONNX model, compares the two, and rates it.

    Args:
        recipe: How it was trained.
        result: What came of it.
        val: The validation samples.
        folder: Where to write.
        counting: How the figures count the validation samples; its threshold is the pipeline's.
        proposals: Whose boxes the samples are, as the model says of itself then.

    Returns:
        Figures for `summary.json`, by name.

    Raises:
        ValueError: If the exported model does not compute what the network does.
    """
    import torch

    from foreglow.lab.learning.model_export import calibrated, largest_difference, write_model
    from foreglow.lab.learning.training import score_samples

    is_labelled = val.labels != IGNORED
    logits, labels = result.val_logits[is_labelled], val.labels[is_labelled]
    calibrator = fit_calibrator(logits, labels, recipe.calibration)
    network = calibrated(result.network, calibrator)
    made_with = {f"foreglow_{name}" if name == "version" else name: str(value) for name, value in provenance().items()}
    about = {"recipe": recipe.model_dump_json(), "seed": str(recipe.seed), PROPOSALS: proposals_text(proposals)}
    about |= made_with
    write_model(network, recipe.inputs, folder / MODEL, about)
    chosen = val.whole_sets(NUM_COMPARED)
    difference = largest_difference(folder / MODEL, chosen, score_samples(network, chosen, torch.device("cpu")))
    weights = io.BytesIO()
    torch.save(network.state_dict(), weights)
    write_atomic(folder / WEIGHTS, weights.getvalue())
    model_bytes = (folder / MODEL).read_bytes()
    return {
        "network": recipe.network,
        "num_parameters": sum(parameter.numel() for parameter in network.parameters()),
        "seed": recipe.seed,
        "num_epochs": len(result.epochs),
        "best_epoch": dataclasses.asdict(result.best),
        "validation": _figures(logits, labels, calibrator, counting[is_labelled]),
        "largest_difference_of_export": difference,
        "model_bytes": len(model_bytes),
        "model_sha256": hashlib.sha256(model_bytes).hexdigest(),
        "training_seconds": round(sum(epoch.seconds for epoch in result.epochs), 1),
        "device": result.device,
        "machine": platform.machine(),
        "num_threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }


def labelled_samples(
    dataset: LabelledSource,
    recipe: Recipe,
    config: PipelineConfig,
    split: SplitName,
    cache: Path,
    progress: RunProgress | None,
) -> Samples:
    """The samples of a split for a recipe, from `cache` or made and kept there; only those of train have copies."""

    def report(num_done: int, num_images: int) -> None:
        if progress is not None:
            progress.samples(split, num_done, num_images)

    return cached_samples(dataset, _sample_config(recipe, config, split), cache, report)


def _sample_config(recipe: Recipe, config: PipelineConfig, split: SplitName) -> SampleConfig:
    jitter = recipe.jitter if split == "train" else Jitter()
    return SampleConfig(proposals=config.proposals, inputs=recipe.inputs, jitter=jitter, by_light=recipe.by_light)


def _figures(logits: Any, labels: Any, calibrator: Calibrator, counting: Counting) -> dict[str, Any]:
    """Figures of the validation boxes before and after calibration; precision, recall and F after it."""
    before, after = light_logits(logits), light_logits(calibrator.applied(logits))
    errors = [expected_calibration_error(expit(values), labels) for values in (before, after)]
    return {
        **dataclasses.asdict(counting.scores(after, labels)),
        "threshold": counting.threshold,
        "temperature": calibrator.temperature,
        "shift": calibrator.shift,
        "doubts": doubts_of(calibrator, after, labels),
        "log_loss": {"before": log_loss(before, labels), "after": log_loss(after, labels)},
        "calibration_error": dict(zip(("before", "after"), errors, strict=True)),
    }
