"""Calibration: scores that say how often they are right, by one or two numbers fitted on validation samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from foreglow.learning.scores import log_loss

Kind: TypeAlias = Literal["none", "temperature", "platt"]

MAX_TEMPERATURE = 100.0
"""Limit of the temperature, and of its inverse: logits without a single error would have none."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibrated logits are `logits / temperature + shift`.

    Attributes:
        temperature: Above 1 where the network was too sure of itself.
        shift: 0 but for `platt`.
    """

    temperature: float = 1.0
    shift: float = 0.0

    def applied(self, logits: NDArray[Any]) -> NDArray[Any]:
        """The calibrated logits."""
        return np.asarray(logits / self.temperature + self.shift)


def calibrate(logits: NDArray[Any], labels: NDArray[np.int8], kind: Kind = "temperature") -> Calibration:
    """The calibration with the least mean log loss, every sample counting alike.

    Args:
        logits: Shape (N,).
        labels: Shape (N,), 1 and 0.
        kind: `temperature` keeps which scores are above 1/2; `platt` may move them; `none` is the identity.

    Source: Guo et al., On Calibration of Modern Neural Networks, arXiv 1706.04599, section 4.2; Platt, 1999.

    >>> calibrate(np.array([9.0, 9.0, 9.0, -9.0]), np.array([1, 1, 0, 0], np.int8)).temperature > 5
    True
    """
    if kind == "none" or len(logits) == 0:
        return Calibration()
    values = np.asarray(logits, np.float64)

    def loss(parameters: NDArray[np.float64]) -> float:
        shift = parameters[1] if kind == "platt" else 0.0
        return log_loss(values * math.exp(-parameters[0]) + shift, labels)

    # The loss is convex in 1 / temperature and the shift, so any start ends at the same place.
    limit = math.log(MAX_TEMPERATURE)
    bounds = [(-limit, limit)] + [(-50.0, 50.0)] * (kind == "platt")
    found = minimize(loss, np.zeros(len(bounds)), method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-12})
    return Calibration(float(np.exp(found.x[0])), float(found.x[1]) if kind == "platt" else 0.0)
