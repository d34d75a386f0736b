"""From the weights of a box's hypotheses to its range: weighted quantiles, in NumPy as specified and in C++.

The posterior of a box is a discrete distribution: hypothesis c has the log range v_c and the weight w_c
(`hypotheses`), with the weights of a box summing to 1. In the order of their ranges, each hypothesis stands for the
middle of its weight on the cumulative distribution,

    M_c = w_1 + ... + w_(c-1) + w_c / 2                                                                         (1)

and the quantile for the share p is linear between neighbours:

    q(p) = v_c + (v_(c+1) - v_c) (p - M_c) / (M_(c+1) - M_c)   where M_c <= p <= M_(c+1)                        (2)

It is the first value below M_1 and the last one above the greatest M. The range of a box is exp(q(0.5)) metres; its
standard deviation is half the distance between exp(q(0.159)) and exp(q(0.841)).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import foreglow._native as _native
from foreglow.distance import hypotheses
from foreglow.distance.hypotheses import BoxEvidence, Cells, Kind, Parameters, log_weights
from foreglow.distance.lamp_pairs import SPACING_LOG_SIGMA
from foreglow.distance.ribbon import PLACES_M, Ribbon
from foreglow.geometry import Floats

BELOW_ONE_SIGMA = 0.1587
"""Share of a Gaussian that lies below its mean minus one standard deviation."""

SHARES = (BELOW_ONE_SIGMA, 0.5, 1.0 - BELOW_ONE_SIGMA)
"""The quantiles that `weighed_ranges` gives: near end, median and far end."""


class Weigher:
    """`hypotheses.cells_along` and `weighed_ranges` in C++, for inference: the same results up to rounding.

    Scratch memory is kept between frames, so use one object per thread.
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
        """The hypotheses along `road`; without a road, no kind is tied to a line."""
        return Cells(*self._weigher.cells_along(road, camera_m.tolist(), pitch_sigma_rad))

    def ranges(self, cells: Cells, boxes: BoxEvidence) -> Floats:
        """Near end, median and far end of each box's range in metres, shape (3, N); the ends are one sigma away."""
        return np.exp(self._weigher.quantiles(cells, boxes, SHARES))


def weighed_ranges(parameters: Parameters, cells: Cells, boxes: BoxEvidence) -> Floats:
    """Near end, median and far end of each box's range in metres, shape (3, N); the ends are one sigma away."""
    weights = log_weights(parameters, cells, boxes)
    return np.asarray(np.exp(weighted_quantiles(cells.log_ranges, weights, SHARES)))


def weighted_quantiles(values: Floats, log_weights: NDArray[np.floating], shares: Sequence[float]) -> Floats:
    """Weighted quantiles by (1) and (2), one row for each share; shape (len(shares), N). Equal values keep their order.

    Args:
        values: Shape (C,), the same for all rows.
        log_weights: Shape (N, C), up to a constant in each row.
        shares: The quantiles that are wanted, between 0 and 1.

    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.zeros((1, 3)), [0.5, 1 / 3]).round(6).tolist()
    [[2.0], [1.5]]
    """
    order = np.argsort(values, kind="stable")
    values = values[order]
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))[:, order]
    weights /= weights.sum(axis=1, keepdims=True)
    # Laid end to end, the rows make one cumulative distribution in which row i runs from i to i + 1, so that a single
    # search finds the quantiles of all rows.
    ends = weights.ravel().cumsum(dtype=np.float64)
    middles = ends - 0.5 * weights.ravel()  # (1)
    wanted = np.arange(len(weights)) + np.asarray(shares)[:, None]
    firsts = np.arange(len(weights)) * len(values)
    after = np.minimum(np.maximum(middles.searchsorted(wanted), firsts + 1), firsts + len(values) - 1)
    low, high = middles[after - 1], middles[after]
    between = np.minimum(np.maximum((wanted - low) / np.maximum(high - low, 1e-30), 0.0), 1.0)
    after -= firsts
    return np.asarray(values[after - 1] + between * (values[after] - values[after - 1]))  # (2)
