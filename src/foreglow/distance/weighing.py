"""The hypotheses of a frame and their weights for each box: the quantiles of its range, as specified, and in C++."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow import _native
from foreglow.distance import hypotheses
from foreglow.distance.hypotheses import BoxEvidence, Cells, Kind, Parameters, log_weights
from foreglow.distance.lamp_pairs import SPACING_LOG_SIGMA
from foreglow.distance.ribbon import PLACES_M, Ribbon
from foreglow.geometry import Floats

BELOW_ONE_SIGMA = 0.1587
"""Share of a Gaussian."""

SHARES = (BELOW_ONE_SIGMA, 0.5, 1.0 - BELOW_ONE_SIGMA)
"""Of the weight that lies nearer than what `weighed_ranges` gives."""


class Weigher:
    """`hypotheses.cells_along` and `weighed_ranges` in C++, for inference; the same to rounding.

    Scratch memory is kept between frames, so use one object a thread.
    """

    def __init__(self, parameters: Parameters) -> None:
        numbers = {name: values.tolist() for name, values in parameters._asdict().items()}
        of_kinds = {name: numbers.pop(name) for name in (*Kind.model_fields, "feature_slopes") if name in numbers}
        shared = {
            "kinds": [dict(zip(of_kinds, kind, strict=True)) for kind in zip(*of_kinds.values(), strict=True)],
            "places_m": PLACES_M.tolist(),
            "cell_sigmas_m": hypotheses.CELL_SIGMAS_M.tolist(),
            "log_cells": hypotheses.LOG_CELLS.tolist(),
            "anywhere_sigma_rad": hypotheses.ANYWHERE_SIGMA_RAD,
            "plane_sigma_rad": hypotheses.PLANE_SIGMA_RAD,
            "roll_sigma_rad": hypotheses.ROLL_SIGMA_RAD,
            "impossible": hypotheses.IMPOSSIBLE,
            "reference_log_range": hypotheses.REFERENCE_LOG_RANGE,
            "spacing_log_sigma": SPACING_LOG_SIGMA,
            "pair_share": hypotheses.PAIR_SHARE,
            "pair_log_sigma": hypotheses.PAIR_LOG_SIGMA,
            "pair_log_mean": hypotheses.PAIR_LOG_MEAN,
        }
        self._weigher = _native.HypothesisWeigher(numbers | shared)

    def cells_along(self, road: Ribbon | None, camera_m: Floats, pitch_sigma_rad: float) -> Cells:
        """The hypotheses along `road`, or without one."""
        return Cells(*self._weigher.cells_along(road, camera_m.tolist(), pitch_sigma_rad))

    def ranges(self, cells: Cells, boxes: BoxEvidence) -> Floats:
        """Near end, median and far end of each box's range in metres, shape (3, N)."""
        return np.exp(self._weigher.quantiles(cells, boxes, SHARES))


def weighed_ranges(parameters: Parameters, cells: Cells, boxes: BoxEvidence) -> Floats:
    """Near end, median and far end of each box's range in metres, shape (3, N): one sigma to either side."""
    weights = log_weights(parameters, cells, boxes)
    return np.asarray(np.exp(weighted_quantiles(cells.log_ranges, weights, SHARES)))


def weighted_quantiles(values: Floats, log_weights: NDArray[np.floating], shares: Sequence[float]) -> Floats:
    """For each share, the value that so much of the weight lies below, shape (len(shares), N).

    Every value stands for the middle of its weight; between two of them it is linear. Equal values keep their order.

    Args:
        values: Shape (C,).
        log_weights: Shape (N, C), to a constant in each row.
        shares: Between 0 and 1.

    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.zeros((1, 3)), [0.5, 1 / 3]).round(6).tolist()
    [[2.0], [1.5]]
    """
    order = np.argsort(values, kind="stable")
    values = values[order]
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))[:, order]
    weights /= weights.sum(axis=1, keepdims=True)
    # One after another the rows make one rising line, on which all is looked up at once: row i goes from i to i + 1.
    ends = weights.ravel().cumsum(dtype=np.float64)
    middles = ends - 0.5 * weights.ravel()
    wanted = np.arange(len(weights)) + np.asarray(shares)[:, None]
    firsts = np.arange(len(weights)) * len(values)
    after = np.minimum(np.maximum(middles.searchsorted(wanted), firsts + 1), firsts + len(values) - 1)
    low, high = middles[after - 1], middles[after]
    between = np.minimum(np.maximum((wanted - low) / np.maximum(high - low, 1e-30), 0.0), 1.0)
    after -= firsts
    return np.asarray(values[after - 1] + between * (values[after] - values[after - 1]))
