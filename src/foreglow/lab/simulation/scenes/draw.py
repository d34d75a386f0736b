"""Random numbers as scenarios need them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

Value = TypeVar("Value")


class Draw:
    """Draws from a seed; numbers are rounded, so that a scene is readable and the same after TOML and JSON."""

    def __init__(self, *seeds: int) -> None:
        """Starts the stream of the given seeds, such as the data set's seed and the number of the scene."""
        self._rng = np.random.default_rng(seeds)

    def uniform(self, low: float, high: float) -> float:
        """Between `low` and `high`."""
        return self._rounded(self._rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """Between `low` and `high`, uniform in the logarithm."""
        return self._rounded(np.exp(self._rng.uniform(np.log(low), np.log(high))))

    def normal(self, mean: float, deviation: float, limit: float = 2.5) -> float:
        """Gaussian, clipped at `limit` standard deviations."""
        return self._rounded(mean + deviation * float(np.clip(self._rng.normal(), -limit, limit)))

    def integer(self, low: int, high: int) -> int:
        """From `low` to `high`, both included."""
        return int(self._rng.integers(low, high + 1))

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self._rng.random() < probability)

    def choice(self, values: Sequence[Value], weights: Sequence[float] | None = None) -> Value:
        """One of `values`, with probabilities proportional to `weights`."""
        shares = None if weights is None else np.array(weights) / np.sum(weights)
        return values[int(self._rng.choice(len(values), p=shares))]

    @staticmethod
    def _rounded(value: float) -> float:
        return float(f"{value:.5g}")
