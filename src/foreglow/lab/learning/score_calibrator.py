"""Calibration: scores become probabilities by one or two parameters fitted on validation samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from foreglow.lab.evaluation.boxes.score_calibration import fit_temperature, log_loss

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
