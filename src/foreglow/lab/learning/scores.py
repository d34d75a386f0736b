"""Scores of logits against labels, and their calibration to probabilities by one or two parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from foreglow.lab.evaluation.boxes.directness import balanced_accuracy
from foreglow.lab.evaluation.boxes.score_calibration import fit_temperature, log_loss


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


Kind: TypeAlias = Literal["none", "temperature", "platt"]

MAX_TEMPERATURE = 100.0
"""Limit of the temperature and of its inverse when a shift is fitted as well; without errors there would be none."""


@dataclass(frozen=True, slots=True)
class Calibrator:
    """Calibrated logits are `logits / temperature + shift`.

    Attributes:
        temperature: Above 1 for a network that was overconfident.
        shift: 0 except for `platt`.
    """

    temperature: float = 1.0
    shift: float = 0.0

    def applied(self, logits: NDArray[Any]) -> NDArray[Any]:
        """The calibrated logits."""
        return np.asarray(logits / self.temperature + self.shift)


def fit_calibrator(logits: NDArray[Any], labels: NDArray[np.int8], kind: Kind = "temperature") -> Calibrator:
    """The calibrator with the least mean log loss over all samples.

    Args:
        logits: Shape (N,).
        labels: Shape (N,), 1 and 0.
        kind: `temperature` keeps which scores are above 1/2; `platt` may change that; `none` is the identity.

    Raises:
        ValueError: If a temperature is wanted and all labels are the same.

    Source: Guo et al., On Calibration of Modern Neural Networks, arXiv 1706.04599, section 4.2; Platt, 1999.

    >>> fit_calibrator(np.array([9.0, 9.0, 9.0, -9.0]), np.array([1, 1, 0, 0], np.int8)).temperature > 5
    True
    """
    if kind == "none" or len(logits) == 0:
        return Calibrator()
    if kind == "temperature":
        return Calibrator(fit_temperature(logits, labels))
    values = np.asarray(logits, np.float64)

    def loss(parameters: NDArray[np.float64]) -> float:
        return log_loss(values * math.exp(-parameters[0]) + parameters[1], labels)

    # The loss is convex in 1 / temperature and the shift, so that any start leads to the same minimum.
    limit = math.log(MAX_TEMPERATURE)
    bounds = [(-limit, limit), (-50.0, 50.0)]
    found = minimize(loss, np.zeros(2), method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-12})
    return Calibrator(float(np.exp(found.x[0])), float(found.x[1]))
