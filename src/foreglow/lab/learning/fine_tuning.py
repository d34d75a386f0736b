"""The whole of `foreglow train MY --from MODEL`: a model goes on learning, from a user's own drives.

Some of what it learnt from is mixed in, so that it forgets nothing: its targets are what the model said of it before
(learning without forgetting, Li and Hoiem, arXiv 1606.09282; `training.Teacher`), and the weights move only as far from
those before as it allows (Wortsman et al., arXiv 2109.01903). The epochs are few and all of them are run: a user's
held-out drives choose nothing, so that the figures before and after are fair.
"""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource, SplitName, open_labelled, split_folder
from foreglow.datasets.pvdn import is_split
from foreglow.lab.learning.annotation import IGNORED, POSITIVE
from foreglow.lab.learning.old_samples import NUM_SAMPLES, chosen, read_old_samples, split_by_drive
from foreglow.lab.learning.recipes import RECIPES, Recipe, changed
from foreglow.lab.learning.samples import Samples, joined
from foreglow.lab.learning.scores import light_logits
from foreglow.lab.learning.training_progress import RunProgress
from foreglow.lab.learning.training_run import finish, labelled_samples, sample_counts, write_results
from foreglow.models import OLD_SAMPLES

if TYPE_CHECKING:
    import torch
    from torch import nn

    from foreglow.lab.learning.model_import import StartingPoint

FINE_TUNING: dict[str, Any] = {
    "epochs": 20,
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

WAYS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)
"""How far the weights move, of the way from those of the start to the trained ones: the first that loses little."""

MAX_LOSS = 0.002
"""Average precision that may be lost on what is held out of the old samples; other drives lose up to ten times that."""

MAX_REPEATS = 8
"""A user's samples are seen up to this often in an epoch, until they are as many as the old ones; or the old ones."""

OLD_WEIGHT = 24.0
"""Of an old sample in the loss; a user's box without light has 1. Less forgets more, more learns less."""


@dataclass(frozen=True, slots=True)
class BoxFigures:
    """How well boxes are told, at a threshold; NaN where undefined."""

    precision: float
    recall: float
    f1: float
    average_precision: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Boxes that the training has not seen, before it and after it.

    Attributes:
        name: Where they are from.
        images: The data set that has their images; None if only samples are there.
        samples: The boxes.
        before: Shape (N,): the score of each box by the model that the training started from.
        after: Shape (N,): that by the new one.
        threshold: Boxes with a score above it are accepted.
    """

    name: str
    images: LabelledSource | None
    samples: Samples
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    threshold: float

    def figures(self) -> tuple[BoxFigures, BoxFigures]:
        """Before and after."""
        is_known = self.samples.labels != IGNORED
        is_light = self.samples.labels[is_known] == POSITIVE
        before, after = (
            box_figures(scores[is_known], is_light, self.threshold) for scores in (self.before, self.after)
        )
        return before, after


def box_figures(scores: NDArray[np.float64], is_light: NDArray[np.bool_], threshold: float) -> BoxFigures:
    """Figures of N boxes by their scores.

    >>> box_figures(np.array([0.9, 0.8, 0.3]), np.array([True, False, True]), 0.5)
    BoxFigures(precision=0.5, recall=0.5, f1=0.5, average_precision=0.8333333333333333)
    """
    is_accepted = scores > threshold
    hits, accepted, lights = (int(np.count_nonzero(each)) for each in (is_accepted & is_light, is_accepted, is_light))
    is_sorted_light = is_light[np.argsort(-scores, kind="stable")]
    precisions = np.cumsum(is_sorted_light) / np.arange(1, len(scores) + 1)
    return BoxFigures(
        precision=hits / accepted if accepted else float("nan"),
        recall=hits / lights if lights else float("nan"),
        f1=2 * hits / (accepted + lights) if accepted + lights else float("nan"),
        average_precision=float(precisions[is_sorted_light].mean()) if lights else float("nan"),
    )


def fine_tuning_recipe(start: StartingPoint) -> Recipe:
    """The recipe for going on from a model."""
    inputs = dataclasses.asdict(start.inputs)
    return changed(RECIPES["foreglow"], FINE_TUNING | {"inputs": inputs, "kinds": start.has_kinds})


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

    Raises:
        FileNotFoundError: If a split or one of its files is missing.
        ValueError: If one is broken, or the folder holds another training.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    from foreglow.lab.learning.training import Teacher, score_samples, torch_device, train

    started = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    cache = cache or folder / "samples"
    learnt = [open_labelled(path if is_split(path) else split_folder(path, "train")) for path in data]
    held_out = [open_labelled(split_folder(path, "val")) for path in data if _has_val(path)]
    own = joined([labelled_samples(each, recipe, config, "train", cache, progress) for each in learnt])
    if not mix:
        old, old_held_out = split_by_drive(read_old_samples(OLD_SAMPLES, recipe.inputs))
    else:
        names: tuple[SplitName, ...] = ("train", "val")
        sets = {name: [open_labelled(split_folder(path, name)) for path in mix] for name in names}
        drives = {
            name: [labelled_samples(each, recipe, config, name, cache, progress) for each in sets[name]]
            for name in names
        }
        old, old_held_out = chosen(drives["train"], NUM_SAMPLES), joined(drives["val"])
        old_held_out = old_held_out[old_held_out.labels != IGNORED]
    repeats, old_repeats = (
        max(1, min(MAX_REPEATS, round(ratio))) for ratio in (len(old) / max(1, len(own)), len(own) / max(1, len(old)))
    )
    parts: list[tuple[str, LabelledSource | None, Samples]] = [
        (str(each.root), each, labelled_samples(each, recipe, config, "val", cache, progress)) for each in held_out
    ]
    parts.append(("what it knew before", None, old_held_out))
    chosen_device = torch_device(device)
    before = [light_scores(score_samples(start.network, part, chosen_device)) for _, _, part in parts]
    judging = joined([part for _, _, part in parts])
    is_old = np.repeat([False, True], [repeats * len(own), old_repeats * len(old)])
    result = train(
        recipe,
        joined([own] * repeats + [old] * old_repeats),
        judging,
        folder,
        make_network=lambda _: copy.deepcopy(start.network),
        start=start.digest,
        teacher=Teacher(copy.deepcopy(start.network), is_old, OLD_WEIGHT),
        threshold=config.classifier.score_threshold,
        device=device,
        progress=progress,
    )
    way = _move(result.network, start.network, old_held_out, chosen_device)
    result = dataclasses.replace(result, val_logits=score_samples(result.network, judging, chosen_device))
    result.network.cpu()
    after = np.split(light_scores(result.val_logits), np.cumsum([len(part) for _, _, part in parts])[:-1])
    threshold = config.classifier.score_threshold
    judged = tuple(
        Judged(name, images, part, scores, later, threshold)
        for (name, images, part), scores, later in zip(parts, before, after, strict=True)
    )
    figures = {each.name: [dataclasses.asdict(found) for found in each.figures()] for each in judged}
    summary = {
        "data": [str(path) for path in data],
        "from": start.name,
        "from_sha256": start.digest,
        "mixed_in": [str(path) for path in mix] or OLD_SAMPLES.name,
        **finish(recipe, result, judging, folder),
        "way": way,
        "threshold": threshold,
        "before_and_after": figures,
        "samples": {"own": sample_counts(own), "mixed_in": sample_counts(old)},
        "repeats": {"own": repeats, "mixed_in": old_repeats},
        "seconds": round(time.perf_counter() - started, 1),
    }
    return write_results(folder, recipe, config, summary), judged


def _move(trained: nn.Module, start: nn.Module, old: Samples, device: torch.device) -> float:
    """Moves trained weights back towards those of the start until little is lost on old samples; says how far they are.

    Their mean is a good network, too, since the one was made of the other in a few steps.
    """
    from foreglow.lab.learning.training import score_samples

    def average_precision(network: nn.Module) -> float:
        scores = light_scores(score_samples(network.to(device), old, device))
        return box_figures(scores, old.labels == POSITIVE, 0.5).average_precision

    first, last = start.state_dict(), {name: value.clone() for name, value in trained.state_dict().items()}
    least = average_precision(start) - MAX_LOSS
    for way in WAYS:
        moved = {
            name: first[name].lerp(last[name], way) if last[name].is_floating_point() else last[name] for name in last
        }
        trained.load_state_dict(moved)
        if average_precision(trained) >= least:
            break
    return way


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
