"""What logits are worth against labels; plain NumPy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit


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


def log_loss(logits: NDArray[Any], labels: NDArray[np.int8], positive_weight: float = 1.0) -> float:
    """Mean binary cross-entropy in nats, positives weighted, divided by the number of samples as torch does."""
    signed = np.where(labels == 1, logits, -logits).astype(np.float64)
    weights = np.where(labels == 1, positive_weight, 1.0)
    return float(np.mean(weights * np.logaddexp(0, -signed))) if len(labels) else math.nan


def calibration_error(logits: NDArray[Any], labels: NDArray[np.int8], num_bins: int = 15) -> float:
    """Expected calibration error: mean distance between score and share of positives, over bins of equal width.

    Source: Guo et al., On Calibration of Modern Neural Networks, arXiv 1706.04599, equation 3, for two classes.
    """
    scores = expit(np.asarray(logits, np.float64))
    bins = np.minimum((scores * num_bins).astype(int), num_bins - 1)
    gaps = np.bincount(bins, scores - (labels == 1), num_bins)
    return float(np.abs(gaps).sum() / len(scores)) if len(scores) else math.nan
