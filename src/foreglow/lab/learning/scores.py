"""What logits are worth against labels; plain NumPy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.directness import balanced_accuracy


@dataclass(frozen=True, slots=True)
class BoxScores:
    """How well boxes were classified at a score of 0.5; NaN where nothing was there to be rated.

    Boxes are counted, not light artifacts: for those see `evaluation.evaluate_boxes`.

    Attributes:
        precision: Of the accepted boxes, the share that hold a light artifact.
        recall: Of the boxes that hold one, the share that are accepted.
        f1: Their harmonic mean.
    """

    precision: float
    recall: float
    f1: float


def box_scores(logits: NDArray[Any], labels: NDArray[np.int8]) -> BoxScores:
    """Precision, recall and F of logits above 0; labels are 1 and 0.

    >>> box_scores(np.array([2.0, 1.0, -1.0]), np.array([1, 0, 1], np.int8))
    BoxScores(precision=0.5, recall=0.5, f1=0.5)
    """
    is_accepted, is_positive = logits > 0, labels == 1
    num_hits = int((is_accepted & is_positive).sum())
    num_accepted, num_positive = int(is_accepted.sum()), int(is_positive.sum())
    return BoxScores(
        num_hits / num_accepted if num_accepted else math.nan,
        num_hits / num_positive if num_positive else math.nan,
        2 * num_hits / (num_accepted + num_positive) if num_accepted + num_positive else math.nan,
    )


def direct_accuracy(logits: NDArray[np.float32], is_direct: NDArray[np.float32]) -> float:
    """How well logits, shape (N, outputs), tell lamps from their light on something: mean over the two.

    `is_direct`, shape (N,), is 1 or 0, NaN where nothing is to be told. NaN where the logits do not say, or one of the
    two is missing.
    """
    is_known = ~np.isnan(is_direct)
    if logits.shape[1] < 2 or not is_known.any():
        return math.nan
    return balanced_accuracy(is_direct[is_known] == 1, logits[is_known, 1] > 0)
