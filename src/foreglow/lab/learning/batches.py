"""The samples of an epoch, their order and weights, and the learning rate at any time of a training."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.whose_light import MIN_VEHICLE_SHARE
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE
from foreglow.lab.learning.recipes import Recipe
from foreglow.lab.learning.samples import ARRAYS, NO_GROUP, Samples, set_bounds
from foreglow.types.kinds import direct_of_kinds


def epoch_indices(labels: NDArray[np.int8], recipe: Recipe, epoch: int) -> NDArray[np.intp]:
    """The samples of an epoch in the order of training, shape (M,), without ignored ones.

    They are all positives, and as many negatives as the recipe allows, drawn again in every epoch.
    """
    random = np.random.default_rng([recipe.seed, epoch])
    positives, negatives = np.flatnonzero(labels == POSITIVE), np.flatnonzero(labels == NEGATIVE)
    if recipe.max_negatives_per_positive is not None:
        num_kept = min(len(negatives), math.ceil(recipe.max_negatives_per_positive * len(positives)))
        negatives = random.choice(negatives, num_kept, replace=False)
    return random.permutation(np.concatenate([positives, negatives]))


def batches(indices: NDArray[np.intp], batch_size: int) -> Iterator[NDArray[np.intp]]:
    """All indices, batch by batch; a last batch of one sample is left out, since it has no batch statistics."""
    for start in range(0, len(indices), batch_size):
        if len(indices) - start > 1 or len(indices) == 1:
            yield indices[start : start + batch_size]


def set_batches(samples: Samples, recipe: Recipe, epoch: int) -> Iterator[NDArray[np.intp]]:
    """All sets with labelled samples batch by batch, at least one in each, in an order drawn for this epoch.

    Of a share of the sets, drawn again in every epoch, the boxes with a lamp in sight are left out, as
    `Recipe.without_lamps` says: those of whose contrast lamps make at least `MIN_VEHICLE_SHARE`.
    """
    random = np.random.default_rng([recipe.seed, epoch])
    is_labelled, is_lamp = samples.labels != IGNORED, direct_of_kinds(samples.kinds) >= MIN_VEHICLE_SHARE
    bounds = [(start, end) for start, end in set_bounds(samples.sets) if is_labelled[start:end].any()]
    batch: list[NDArray[np.intp]] = []
    num_samples = 0
    for start, end in random.permutation(bounds):
        chosen = np.arange(start, end)
        if random.random() < recipe.without_lamps:
            chosen = chosen[~is_lamp[start:end]]
        if not is_labelled[chosen].any():
            continue
        if batch and num_samples + len(chosen) > recipe.batch_size:
            yield np.concatenate(batch)
            batch, num_samples = [], 0
        batch.append(chosen)
        num_samples += len(chosen)
    if num_samples > 1:
        yield np.concatenate(batch)


def sample_weights(samples: Samples, group_balance: float) -> NDArray[np.float32]:
    """Weight of each sample, shape (N,): 1 for negatives; 1 on average over the positives."""
    is_positive = samples.labels == POSITIVE
    _, group, counts = np.unique(samples.groups[is_positive], return_inverse=True, return_counts=True)
    weights = np.ones(len(samples))
    found = counts[group] ** -float(group_balance)
    weights[is_positive] = found / found.mean()
    return weights.astype(np.float32)


def kind_targets(samples: Samples, unmarked_light: float) -> NDArray[np.float32]:
    """What is learnt of each sample's `KINDS`, shape (N, 5): shares of its light that sum to 1; NaN where unknown.

    Args:
        samples: The samples.
        unmarked_light: How much of vehicles' light counts in a box without any key point; the rest counts as none.
    """
    targets = samples.kinds.copy()
    is_unmarked = samples.groups == NO_GROUP
    targets[is_unmarked, :-1] *= np.float32(unmarked_light)
    targets[is_unmarked, -1] = 1.0 - targets[is_unmarked, :-1].sum(axis=1)
    return targets


def content_digest(samples: Samples) -> str:
    """SHA-256 of the samples' content."""
    digest = hashlib.sha256()
    for name in ARRAYS:
        digest.update(np.ascontiguousarray(getattr(samples, name)).data)
    return digest.hexdigest()


# As in torch's ReduceLROnPlateau, which the published code uses: a loss has to be lower by this share.
_PLATEAU_SHARE = 1e-4


def learning_rate(recipe: Recipe, epochs_done: float, val_losses: Sequence[float]) -> float:
    """The rate of the next step.

    Args:
        recipe: Rate and schedule.
        epochs_done: Passes over the data so far, fractions included.
        val_losses: Validation losses of the finished epochs, in order; used by the schedule `plateau` only.
    """
    if recipe.schedule == "plateau":
        factor = recipe.plateau_factor ** num_plateaus(val_losses, recipe.plateau_patience)
    elif epochs_done < recipe.warmup_epochs:
        factor = epochs_done / recipe.warmup_epochs
    elif recipe.schedule == "cosine":
        span = recipe.epochs - recipe.warmup_epochs
        factor = (1 + math.cos(math.pi * min((epochs_done - recipe.warmup_epochs) / span, 1))) / 2 if span else 1.0
    else:
        factor = 1.0
    return recipe.learning_rate * factor


def num_plateaus(losses: Sequence[float], patience: int) -> int:
    """How often the loss has not fallen for more than `patience` epochs in a row; counting restarts each time.

    >>> num_plateaus([1.0, 0.9, 0.95, 0.93, 0.92], patience=2)
    1
    """
    best, num_waited, num_found = math.inf, 0, 0
    for loss in losses:
        if loss < best * (1 - _PLATEAU_SHARE):
            best, num_waited = loss, 0
        else:
            num_waited += 1
        if num_waited > patience:
            num_found, num_waited = num_found + 1, 0
    return num_found
