"""What logits are worth against labels; plain NumPy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
