"""Scores of logits against labels, in plain NumPy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.directness import balanced_accuracy


@dataclass(frozen=True, slots=True)
class BoxScores:
    """How well boxes were classified at a score of 0.5; NaN where undefined.

    These count boxes; for light artifacts see `evaluation.evaluate_boxes`.

    Attributes:
        precision: Share of the accepted boxes that contain a light artifact.
        recall: Share of the boxes with a light artifact that are accepted.
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
    """Balanced accuracy of logits, shape (N, outputs), in separating lamps from their light on surfaces.

    `is_direct`, shape (N,), is 1 or 0, or NaN where neither applies. The result is NaN if there is only one output, or
    if one of the classes is missing.
    """
    is_known = ~np.isnan(is_direct)
    if logits.shape[1] < 2 or not is_known.any():
        return math.nan
    return balanced_accuracy(is_direct[is_known] == 1, logits[is_known, 1] > 0)
