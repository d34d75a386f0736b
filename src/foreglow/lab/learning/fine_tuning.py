"""The whole of `foreglow train MY --from MODEL`: a model goes on learning, from a user's own drives.

Some of what it learnt from is mixed in, so that it forgets nothing: its targets are what the model said of it before
(learning without forgetting, Li and Hoiem, arXiv 1606.09282; `training.Teacher`), and the weights move only as far from
those before as the camera allows on whose drives most is lost (Wortsman et al., arXiv 2109.01903). All epochs are run,
and a user's held-out drives choose nothing, so that the figures before and after are fair.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from foreglow.checksums import check_as_written
from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource, SplitName, open_labelled, split_folder
from foreglow.datasets.pvdn import is_split
from foreglow.files import check_each_once
from foreglow.lab.learning.annotation import IGNORED, POSITIVE
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.old_samples import NUM_SAMPLES, HeldOut, chosen, read_old_samples
from foreglow.lab.learning.recipes import RECIPES, Recipe, changed
from foreglow.lab.learning.samples import NO_GROUP, Samples, joined
from foreglow.lab.learning.scores import Counting, light_logits
from foreglow.lab.learning.training_progress import RunProgress
from foreglow.lab.learning.training_run import (
    TEXTS,
    check_support,
    finish,
    labelled_samples,
    sample_counts,
    without_light,
    write_results,
)
from foreglow.models import OLD_SAMPLES

if TYPE_CHECKING:
    import torch
    from torch import nn

    from foreglow.lab.learning.model_import import StartingPoint

FINE_TUNING: dict[str, Any] = {
    "epochs": 60,
    "batch_size": 128,
    "learning_rate": 1e-3,
    "warmup_epochs": 0.5,
    "ema_decay": 0.0,
    "max_negatives_per_positive": None,
    "positive_weight": "balanced",  # what is labelled as light is what was missed
    "group_balance": 0.0,
    "best_by": "last",
    "calibration": "none",
}
"""What differs from the recipe `foreglow`."""

WAYS = tuple(way / 20 for way in range(20, -1, -1))
"""How far the weights move, of the way from those of the start to the trained ones: the first that loses little."""

MAX_LOSS = 0.008
"""Average precision that may be lost on the old samples of any camera, by either way to label them. They are few: the
worst of these twelve figures was .007 and .006 where whole drives had lost .002 and .006."""

MAX_REPEATS = 8
"""A user's samples are seen up to this often in an epoch, until they are as many as the old ones; or the old ones."""

MAX_SEEN = 600_000
"""Samples that all epochs together see: large data sets have fewer epochs. This many take some 150 s of a core."""

_SPLITS: tuple[SplitName, ...] = ("train", "val")

OLD_WEIGHT = 240.0
"""Of an old sample in the loss; a user's box without light has 1. Less forgets more, more learns less. On the two real
clips of docs/own_drive.md, 15 and 60 forget more for the same gain, and 1,000 gains half as much."""


@dataclass(frozen=True, slots=True)
class BoxFigures:
    """How well boxes are told, at a threshold; NaN where undefined."""

    precision: float
    recall: float
    f1: float
    average_precision: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Boxes that nothing was learnt from, by the model before and the one after.

    Attributes:
        name: Where they are from.
        images: The data set that has their images; None if only samples are there.
        samples: The boxes.
        before: Shape (N,): the score of each box by the model that the training started from.
        after: Shape (N,): that by the new one.
        threshold: Boxes with a score above it are accepted.
        weights: Shape (N,): how many boxes each stands for; None if each is one.
    """

    name: str
    images: LabelledSource | None
    samples: Samples
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    threshold: float
    weights: NDArray[np.float32] | None = None

    @property
    def is_changed(self) -> NDArray[np.bool_]:
        """Shape (N,): whether one of the models accepts a box and the other does not."""
        return np.asarray((self.before > self.threshold) != (self.after > self.threshold))

    def figures(self) -> tuple[BoxFigures, BoxFigures]:
        """Before and after."""
        is_known = self.samples.labels != IGNORED
        is_light = self.samples.labels[is_known] == POSITIVE
        weights = None if self.weights is None else self.weights[is_known]
        before, after = (
            box_figures(scores[is_known], is_light, self.threshold, weights) for scores in (self.before, self.after)
        )
        return before, after


def box_figures(
    scores: NDArray[np.float64],
    is_light: NDArray[np.bool_],
    threshold: float,
    weights: NDArray[np.floating[Any]] | None = None,
) -> BoxFigures:
    """Figures of N boxes by their scores, each of which stands for as many boxes as `weights` says, or for one.

    Boxes of equal scores are accepted together, whatever their order: if all are equal, the average precision is the
    share of the boxes with light.

    >>> box_figures(np.array([0.9, 0.8, 0.3]), np.array([True, False, True]), 0.5)
    BoxFigures(precision=0.5, recall=0.5, f1=0.5, average_precision=0.8333333333333333)
    """
    counts = np.ones(len(scores)) if weights is None else weights.astype(np.float64)
    is_accepted = scores > threshold
    hits, accepted, lights = (float(counts[each].sum()) for each in (is_accepted & is_light, is_accepted, is_light))
    distinct, score_of = np.unique(-scores, return_inverse=True)
    lights_of_score, boxes_of_score = (
        np.bincount(score_of, each, len(distinct)) for each in (counts * is_light, counts)
    )
    precisions = np.cumsum(lights_of_score) / np.cumsum(boxes_of_score)
    return BoxFigures(
        precision=hits / accepted if accepted else float("nan"),
        recall=hits / lights if lights else float("nan"),
        f1=2 * hits / (accepted + lights) if accepted + lights else float("nan"),
        average_precision=float((precisions * lights_of_score).sum() / lights) if lights else float("nan"),
    )


def fitting_recipe(start: StartingPoint) -> str:
    """Name of the recipe that has the model's network."""
    from foreglow.lab.learning.networks import BothNetwork

    if not start.inputs.together:
        return "compact"
    return "foreglow" if isinstance(start.network, BothNetwork) else "related"


def fine_tuning_recipe(start: StartingPoint) -> Recipe:
    """The recipe for going on from a model."""
    base = RECIPES[fitting_recipe(start)]
    inputs = dataclasses.asdict(start.inputs)
    return changed(base, FINE_TUNING | {"inputs": inputs, "kinds": start.has_kinds})


def _check_network(recipe: Recipe, start: StartingPoint) -> None:
    """ValueError if a recipe asks for another network than that of the model that goes on learning."""
    for field, known in (("network", RECIPES[fitting_recipe(start)].network), ("kinds", start.has_kinds)):
        given = getattr(recipe, field)
        if given != known:
            raise ValueError(f"recipe: {field}: expected {known!r}, that of {start.name}, which goes on, got {given!r}")


def fine_tune(
    data: Sequence[Path],
    start: StartingPoint,
    recipe: Recipe,
    config: PipelineConfig,
    folder: Path,
    *,
    mix: Sequence[Path] = (),
    device: str = "auto",
    cache: Path | None = None,
    progress: RunProgress | None = None,
    draw: Callable[[Sequence[Judged]], None] | None = None,
) -> tuple[dict[str, Any], tuple[Judged, ...]]:
    """Trains the model further on the proposals of `config` in every DATA/train, and judges it on every DATA/val.

    An interrupted run continues when it is called again with the same arguments. Returns what `summary.json` holds, and
    the boxes that it was judged by.

    Args:
        data: A user's data sets with a split train, and perhaps val; or single splits to train on.
        start: The model to go on from.
        recipe: How to train, as of `fine_tuning_recipe`.
        config: Its proposals are the boxes that the network is trained on, and its threshold is that of the figures.
        folder: Folder for all results; made if it does not exist.
        mix: Data sets with the splits train and val to be mixed in; without any, the samples that ship.
        device: `cpu`, `cuda`, or `auto` for a GPU if there is one.
        cache: Folder in which samples are kept between runs; None keeps them in `folder`.
        progress: Called after every image, step and epoch.
        draw: Writes pictures of the training and of the boxes that it was judged by; called before its summary appears.

    Raises:
        FileNotFoundError: If a split or one of its files is missing.
        ValueError: If there is no such device, the recipe or the crops are of another network, a split is broken or
            must not be learnt from, no box of DATA has light, or the folder holds another training, or one with a
            changed text.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    from foreglow.lab.learning.checkpoints import check_begun
    from foreglow.lab.learning.training import Teacher, score_samples, torch_device, train

    started = time.perf_counter()
    check_as_written(folder, TEXTS)
    chosen_device = torch_device(device)
    _check_network(recipe, start)
    check_support(recipe, config)
    roots = [path if is_split(path) else split_folder(path, "train") for path in data]
    check_each_once(roots, "DATA")
    val_splits = [split_folder(path, "val") for path in data if _has_val(path)]
    mixed_in = {name: [split_folder(path, name) for path in mix] for name in _SPLITS}
    check_apart([*roots, *mixed_in["train"]], [*val_splits, *mixed_in["val"]], data)
    check_each_once([*roots, *mixed_in["train"]], "DATA and --mix")
    given = recipe.model_dump(mode="json")
    del given["epochs"]  # those of the training follow from the number of samples
    camera = {"white_level": config.guard.white_level}
    about = {"start": start.digest, **camera}
    check_begun(folder, given | about)
    folder.mkdir(parents=True, exist_ok=True)
    cache = cache or folder / "samples"
    learnt = [open_labelled(root, **camera) for root in roots]
    held_out = [open_labelled(path, **camera) for path in val_splits]
    own_parts = [labelled_samples(each, recipe, config, "train", cache, progress) for each in learnt]
    own = joined(own_parts)
    if not own.num_labelled(POSITIVE):
        raise ValueError(f"{', '.join(map(str, roots))}: expected light artifacts among {len(own)} boxes, found none")
    unlit: list[str] = []
    if not mix:
        shipped = read_old_samples(OLD_SAMPLES, recipe.inputs)
        old, judge = shipped.learn, shipped.judge
    else:
        sets = {name: [open_labelled(path, **camera) for path in mixed_in[name]] for name in _SPLITS}
        drives = {
            name: [labelled_samples(each, recipe, config, name, cache, progress) for each in sets[name]]
            for name in _SPLITS
        }
        old = chosen(drives["train"], NUM_SAMPLES)
        unlit = [origin for name in _SPLITS for origin in without_light(sets[name], drives[name])]
        judge = tuple(
            HeldOut(str(path), part, np.ones(len(part), np.float32))
            for path, part in zip(mix, drives["val"], strict=True)
        )
    repeats, old_repeats = (
        max(1, min(MAX_REPEATS, round(ratio))) for ratio in (len(old) / max(1, len(own)), len(own) / max(1, len(old)))
    )
    num_seen = sum(
        times * (len(each) - each.num_labelled(IGNORED)) for times, each in ((repeats, own), (old_repeats, old))
    )
    recipe = changed(recipe, {"epochs": max(1, min(recipe.epochs, round(MAX_SEEN / num_seen)))})
    parts: list[tuple[str, LabelledSource | None, Samples]] = [
        (str(each.root), each, labelled_samples(each, recipe, config, "val", cache, progress)) for each in held_out
    ]
    parts.append(("what it knew before", None, joined([each.samples for each in judge])))
    before = [light_scores(score_samples(start.network, part, chosen_device)) for _, _, part in parts]
    judging = joined([part for _, _, part in parts])
    judge_weights = np.concatenate([each.weights for each in judge])
    weights = [*(None for _ in held_out), judge_weights]
    is_old = np.repeat([False, True], [repeats * len(own), old_repeats * len(old)])
    threshold = config.classifier.score_threshold
    counts = np.concatenate([np.ones(len(judging) - len(judge_weights), np.float32), judge_weights])
    counting = Counting(threshold, counts)
    result = train(
        recipe,
        joined([own] * repeats + [old] * old_repeats),
        judging,
        folder,
        make_network=lambda _: copy.deepcopy(start.network),
        about=about,
        teacher=Teacher(copy.deepcopy(start.network), is_old, OLD_WEIGHT),
        counting=counting,
        device=device,
        progress=progress,
    )
    way, kept = _move(result.network, start.network, judge, chosen_device)
    result = dataclasses.replace(result, val_logits=score_samples(result.network, judging, chosen_device))
    result.network.cpu()
    after = np.split(light_scores(result.val_logits), np.cumsum([len(part) for _, _, part in parts])[:-1])
    judged = tuple(
        Judged(name, images, part, scores, later, threshold, its_weights)
        for (name, images, part), scores, later, its_weights in zip(parts, before, after, weights, strict=True)
    )
    figures = {each.name: [dataclasses.asdict(found) for found in each.figures()] for each in judged}
    summary = {
        "data": [str(path) for path in data],
        "from": start.name,
        "from_sha256": start.digest,
        "mixed_in": [str(path) for path in mix] or OLD_SAMPLES.name,
        **finish(recipe, result, judging, folder, counting, config.proposals),
        "way": way,
        "threshold": threshold,
        "before_and_after": figures,
        "kept": kept,
        "samples": {"own": sample_counts(own), "mixed_in": sample_counts(old)},
        "without_light": without_light([*learnt, *held_out], [*own_parts, *(part for _, _, part in parts[:-1])])
        + unlit,
        "repeats": {"own": repeats, "mixed_in": old_repeats},
        "seconds": round(time.perf_counter() - started, 1),
    }
    pictures = None if draw is None else functools.partial(draw, judged)
    return write_results(folder, recipe, config, summary, pictures), judged


def _move(
    trained: nn.Module, start: nn.Module, judge: Sequence[HeldOut], device: torch.device
) -> tuple[float, dict[str, dict[str, list[float]]]]:
    """Moves trained weights back towards those of the start until no camera loses much; says how far they are.

    Their mean is a good network, too, since the one was made of the other in a few steps. Also returns the average
    precision before and after, by camera and by `_labels`.
    """

    def average_precisions(network: nn.Module) -> list[dict[str, float]]:
        return [_average_precisions(network.to(device), each, device) for each in judge]

    first, last = start.state_dict(), {name: value.clone() for name, value in trained.state_dict().items()}
    before = average_precisions(start)
    for way in WAYS:
        moved = {
            name: first[name].lerp(last[name], way) if last[name].is_floating_point() else last[name] for name in last
        }
        trained.load_state_dict(moved)
        after = average_precisions(trained)
        losses = [known[name] - now[name] for known, now in zip(before, after, strict=True) for name in known]
        if max(losses, default=0.0) <= MAX_LOSS:
            break
    kept = {
        each.camera: {name: [known[name], now[name]] for name in known}
        for each, known, now in zip(judge, before, after, strict=True)
    }
    return way, kept


def _average_precisions(network: nn.Module, held_out: HeldOut, device: torch.device) -> dict[str, float]:
    """By each way to label a camera's boxes that has some with light."""
    from foreglow.lab.learning.training import score_samples

    scores = light_scores(score_samples(network, held_out.samples, device))
    is_known = held_out.samples.labels != IGNORED
    return {
        name: box_figures(scores[is_known], is_light[is_known], 0.5, held_out.weights[is_known]).average_precision
        for name, is_light in _labels(held_out.samples).items()
        if is_light[is_known].any()
    }


def _labels(samples: Samples) -> dict[str, NDArray[np.bool_]]:
    """Which boxes are light of a vehicle: by their labels, and by what a person would mark, shape (N,)."""
    return {"light": samples.labels == POSITIVE, "marks": samples.groups != NO_GROUP}


def light_scores(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    """The score of each box, shape (N,), of logits of shape (N, 1) or (N, 5)."""
    return np.asarray(expit(light_logits(logits.astype(np.float64))))


def _has_val(path: Path) -> bool:
    if is_split(path):
        return False
    try:
        split_folder(path, "val")
    except FileNotFoundError:
        return False
    return True
