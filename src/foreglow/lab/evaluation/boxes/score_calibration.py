"""Whether scores are probabilities: reliability, calibration error, Brier score, likelihood, and a temperature."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.ratios import ratio

SMALLEST_SCORE = 1e-7
"""Scores are kept this far from 0 and 1 before their logit is taken: single precision knows nothing beyond."""

TEMPERATURE_LIMITS = (0.02, 50.0)
"""The fit ends here where scores divide the classes without a fault, or say nothing of them."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Boxes of similar scores.

    Attributes:
        share: Share of them that hold a light artifact.
    """

    num: int
    mean_score: float
    share: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """How close scores are to the probability of a light artifact in the box.

    Attributes:
        num: Boxes with a score; those with only doubtful light are left out.
        share: Share of them that hold a light artifact.
        ece: Expected calibration error: mean over the boxes of |share - mean score| of their bin.
        brier: Mean of (score - label)^2.
        nll: Mean of -log of the probability given to the label, in nats; scores kept 1e-7 from 0 and 1.
        temperature: What the logits have to be divided by for the lowest nll: above 1 for too sure a classifier.
        bins: The reliability diagram, by score, in bins of equal counts: the figures are theirs.
        tenths: The diagram in bins of a tenth of the score, without empty bins: most boxes have low scores, so bins of
            equal counts say little of the high ones.
    """

    num: int
    share: float
    ece: float
    brier: float
    nll: float
    temperature: float
    nll_at_temperature: float
    ece_at_temperature: float
    bins: tuple[Bin, ...]
    tenths: tuple[Bin, ...]


def calibration(scores: ArrayLike, labels: ArrayLike, num_bins: int = 15) -> Calibration:
    """How close `scores` are to the probability of `labels`.

    Args:
        scores: Shape (N,), from 0 to 1.
        labels: Shape (N,), true where the box holds a light artifact.
        num_bins: Of the reliability diagram.

    Raises:
        ValueError: If there are not both classes, or scores and labels do not fit.
    """
    from scipy.special import expit

    given, truth = _checked(scores, labels)
    logits = logits_of(given)
    temperature = fit_temperature(logits, truth)
    bins = reliability(given, truth, num_bins)
    return Calibration(
        num=len(given),
        share=float(truth.mean()),
        ece=_ece(bins),
        brier=float(np.mean((given - truth) ** 2)),
        nll=log_loss(logits, truth),
        temperature=temperature,
        nll_at_temperature=log_loss(logits / temperature, truth),
        ece_at_temperature=_ece(reliability(expit(logits / temperature), truth, num_bins)),
        bins=bins,
        tenths=_tenths(given, truth),
    )


def reliability(scores: ArrayLike, labels: ArrayLike, num_bins: int = 15) -> tuple[Bin, ...]:
    """Boxes in `num_bins` bins of as equal counts as ties allow: equal scores share a bin; fewer bins if need be.

    >>> [(part.num, part.share) for part in reliability([0.1, 0.2, 0.8, 0.9], [False, False, True, False], 2)]
    [(2, 0.0), (2, 0.5)]
    """
    given, truth = np.asarray(scores, np.float64), np.asarray(labels, np.float64)
    order = np.argsort(given, kind="stable")
    given, truth = given[order], truth[order]
    starts = np.round(np.arange(num_bins) * len(given) / num_bins).astype(int)
    edges = np.unique([*np.searchsorted(given, given[starts[starts < len(given)]]), len(given)])
    return tuple(
        Bin(stop - start, float(given[start:stop].mean()), float(truth[start:stop].mean()))
        for start, stop in itertools.pairwise(edges.tolist())
    )


def expected_calibration_error(scores: ArrayLike, labels: ArrayLike) -> float:
    """Mean over the boxes of |share of artifacts - mean score| of their bin of equal counts; NaN of nothing."""
    return _ece(reliability(scores, labels))


def fit_temperature(logits: ArrayLike, labels: ArrayLike) -> float:
    """The temperature T, from 0.02 to 50, for which sigmoid(logits / T) gives `labels` the highest likelihood.

    The likelihood is log-concave in 1 / T, so there is one best T; 1 where all logits are 0, and every T as good.

    Raises:
        ValueError: If there are not both classes, or logits and labels do not fit.

    Source: Guo et al., On Calibration of Modern Neural Networks, ICML 2017, section 4.2.

    >>> round(fit_temperature([2.0, 2.0, 2.0, -2.0, -2.0, -2.0], [1, 1, 0, 0, 0, 1]), 3)  # 2 / log(2)
    2.885
    """
    from scipy.optimize import minimize_scalar

    given, truth = _checked(logits, labels)
    if not given.any():
        return 1.0
    low, high = (math.log(1.0 / limit) for limit in reversed(TEMPERATURE_LIMITS))
    best = minimize_scalar(
        lambda log_slope: log_loss(given * math.exp(log_slope), truth),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(math.exp(-best.x))


def logits_of(scores: ArrayLike) -> Floats:
    """log(s / (1 - s)) of scores, kept 1e-7 from 0 and 1."""
    from scipy.special import logit

    return np.asarray(logit(np.clip(np.asarray(scores, np.float64), SMALLEST_SCORE, 1.0 - SMALLEST_SCORE)))


def _tenths(scores: Floats, labels: Floats) -> tuple[Bin, ...]:
    """Boxes by the first decimal of their score; that of 1 is in the last bin."""
    tenths = np.minimum((scores * 10.0).astype(int), 9)
    return tuple(
        Bin(int(is_in.sum()), float(scores[is_in].mean()), float(labels[is_in].mean()))
        for is_in in (tenths == tenth for tenth in np.unique(tenths))
    )


def _checked(values: ArrayLike, labels: ArrayLike) -> tuple[Floats, Floats]:
    given, truth = np.asarray(values, np.float64), np.asarray(labels, np.float64)
    if given.shape != truth.shape or given.ndim != 1:
        raise ValueError(f"labels: expected one a score, shape {given.shape}, got {truth.shape}")
    if not 0.0 < truth.sum() < len(truth):
        raise ValueError(f"labels: expected boxes with and without an artifact, got {truth.sum():g} of {len(truth)}")
    return given, truth


def log_loss(logits: NDArray[Any], labels: NDArray[Any], positive_weight: float = 1.0) -> float:
    """Mean binary cross-entropy in nats, positives weighted, divided by the number of samples as torch does.

    Args:
        logits: Shape (N,).
        labels: Shape (N,), 1 and 0.
        positive_weight: Of a sample with label 1.

    Returns:
        Mean of log(1 + exp(-z)) where the label is 1, and of log(1 + exp(z)) where it is 0; NaN of nothing.
    """
    signed = np.where(labels == 1, logits, -logits).astype(np.float64)
    weights = np.where(labels == 1, positive_weight, 1.0)
    return float(np.mean(weights * np.logaddexp(0, -signed))) if len(labels) else math.nan


def _ece(bins: tuple[Bin, ...]) -> float:
    return ratio(sum(part.num * abs(part.share - part.mean_score) for part in bins), sum(part.num for part in bins))
