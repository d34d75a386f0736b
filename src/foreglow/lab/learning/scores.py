"""Scores of logits against labels, and their calibration to probabilities by one or two parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logit

from foreglow.lab.evaluation.boxes.score_calibration import TEMPERATURE_LIMITS, fit_temperature, log_loss
from foreglow.wording import check_one_of


@dataclass(frozen=True, slots=True)
class BoxScores:
    """How well boxes were classified at a threshold; NaN where undefined.

    These count boxes; for light artifacts see `evaluation.evaluate_boxes`.

    Attributes:
        precision: Share of the accepted boxes that contain a light artifact.
        recall: Share of the boxes with a light artifact that are accepted.
        f1: Their harmonic mean.
    """

    precision: float
    recall: float
    f1: float


@dataclass(frozen=True, slots=True, eq=False)
class Counting:
    """How boxes are counted.

    Attributes:
        threshold: Boxes with a score above it are accepted.
        weights: Shape (N,): how many boxes each stands for; None if each is one.
    """

    threshold: float = 0.5
    weights: NDArray[np.float32] | None = None

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Counting:
        """The same for some of the boxes."""
        return Counting(self.threshold, None if self.weights is None else self.weights[chosen])

    def scores(self, logits: NDArray[Any], labels: NDArray[np.int8]) -> BoxScores:
        """Precision, recall and F of N logits; labels are 1 and 0.

        >>> EACH_AS_ONE.scores(np.array([2.0, 1.0, -1.0]), np.array([1, 0, 1], np.int8))
        BoxScores(precision=0.5, recall=0.5, f1=0.5)
        """
        is_accepted, is_positive = logits > logit(self.threshold), labels == 1
        counts = np.ones(len(labels)) if self.weights is None else self.weights.astype(np.float64)
        hits, accepted, positive = (
            float(counts[each].sum()) for each in (is_accepted & is_positive, is_accepted, is_positive)
        )
        return BoxScores(
            hits / accepted if accepted else math.nan,
            hits / positive if positive else math.nan,
            2 * hits / (accepted + positive) if accepted + positive else math.nan,
        )


EACH_AS_ONE = Counting()
"""Each box counts once, and is accepted at a score above 0.5."""


def light_logits(logits: NDArray[Any]) -> NDArray[Any]:
    """Logits of being light of a vehicle, shape (N,), of logits of it alone, (N, 1), or of all kinds, (N, 5)."""
    if logits.shape[1] == 1:
        return logits[:, 0]
    return np.asarray(np.logaddexp.reduce(logits[:, :-1], axis=1) - logits[:, -1])


def kind_accuracy(logits: NDArray[np.float32], kinds: NDArray[np.float32]) -> float:
    """Share of the boxes with light of a vehicle whose greatest kind gets the greatest logit, each kind counted alike.

    Args:
        logits: Shape (N, 1) or (N, 5); the kinds are compared without `none`.
        kinds: Shape (N, 5), shares of light; NaN where unknown. Boxes count with at least half of vehicles' light.

    Returns:
        NaN for a network that does not tell kinds, or without such boxes.
    """
    is_known = np.nan_to_num(kinds[:, -1], nan=1.0) <= 0.5
    if logits.shape[1] == 1 or not is_known.any():
        return math.nan
    truth, found = kinds[is_known, :-1].argmax(1), logits[is_known, :-1].argmax(1)
    return float(np.mean([(found[truth == kind] == kind).mean() for kind in np.unique(truth)]))


Calibration: TypeAlias = Literal["none", "temperature", "platt"]

MAX_TEMPERATURE = 100.0
"""Limit of the temperature and of its inverse when a shift is fitted as well; without errors there would be none."""


@dataclass(frozen=True, slots=True)
class Calibrator:
    """Calibrated logits are `logits / temperature`, and all but that of `none` are shifted.

    Attributes:
        temperature: Above 1 for a network that was overconfident.
        shift: 0 except for `platt`.
    """

    temperature: float = 1.0
    shift: float = 0.0

    def applied(self, logits: NDArray[Any]) -> NDArray[Any]:
        """The calibrated logits, shape (N, 1) or (N, 5)."""
        num_outputs = logits.shape[1]
        return np.asarray(logits / self.temperature + self.shift * (np.arange(num_outputs) < max(1, num_outputs - 1)))


def fit_calibrator(logits: NDArray[Any], labels: NDArray[np.int8], method: Calibration = "temperature") -> Calibrator:
    """The calibrator with the least mean log loss of being light, over all samples.

    Args:
        logits: Shape (N, 1) or (N, 5).
        labels: Shape (N,), 1 and 0.
        method: `temperature` only divides; `platt` shifts, too; `none` is the identity.

    Raises:
        ValueError: If a calibration is wanted and all labels are the same, or there is no such method.

    Source: Guo et al., On Calibration of Modern Neural Networks, arXiv 1706.04599, section 4.2; Platt, 1999.

    >>> fit_calibrator(np.array([[9.0], [9.0], [9.0], [-9.0]]), np.array([1, 1, 0, 0], np.int8)).temperature > 5
    True
    """
    check_one_of(method, Calibration, "method")
    if method == "none" or len(logits) == 0:
        return Calibrator()
    num = np.count_nonzero(labels)
    if not 0 < num < len(labels):
        raise ValueError(f"labels: expected boxes with and without an artifact, got {num} of {len(labels)}")
    values = np.asarray(logits, np.float64)
    if method == "temperature" and values.shape[1] == 1:
        return Calibrator(fit_temperature(values[:, 0], labels))

    def loss(parameters: NDArray[np.float64]) -> float:
        calibrator = Calibrator(math.exp(parameters[0]), parameters[1] if method == "platt" else 0.0)
        return log_loss(light_logits(calibrator.applied(values)), labels)

    # With a single logit the loss is convex in 1 / temperature and the shift; with more, the minimum is that next to
    # the uncalibrated logits.
    limit = math.log(MAX_TEMPERATURE)
    bounds = [(-limit, limit), (-50.0, 50.0)]
    found = minimize(loss, np.zeros(2), method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-12})
    return Calibrator(float(np.exp(found.x[0])), float(found.x[1]) if method == "platt" else 0.0)


def doubts_of(calibrator: Calibrator, logits: NDArray[Any], labels: NDArray[np.int8]) -> list[str]:
    """What is to be said of a calibrator that the boxes which it was fitted to say little of, one line each.

    Args:
        calibrator: The calibrator.
        logits: Shape (N,): the calibrated logits of being light.
        labels: Shape (N,), 1 and 0.
    """
    if calibrator == Calibrator():
        return []
    if calibrator.temperature > 0.99 * TEMPERATURE_LIMITS[1]:
        return [
            "the temperature is at its limit: by the validation boxes the scores tell nothing, and all are nearly the "
            "same now; train longer, or label more"
        ]
    if logits[labels == 1].min() > logits[labels != 1].max():
        return [
            "the validation boxes are told apart without an error, so that they do not say how sure the scores may be: "
            "most are nearly 0 or 1 now; label more in val"
        ]
    return []
