"""The learning rate at any time of a training, as a function of the recipe and the validation losses so far."""

from __future__ import annotations

import math
from collections.abc import Sequence

from foreglow.lab.learning.recipes import Recipe

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
