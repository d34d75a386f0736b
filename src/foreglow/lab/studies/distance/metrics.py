"""How wrong ranges are, and how honest their sigmas."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.boxes.breakdown import RANGE_EDGES_M, plain

NUM_RESAMPLES = 1000


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Relative errors of some lights: (estimate - truth) / truth, positive where the light seems too far.

    Attributes:
        num: Lights.
        missing: Share of them without an estimate; NaN without lights.
        median: Median error of those with one, as all below; NaN without any.
        median_absolute: Median of its absolute value.
        lower_quartile: 25th percentile.
        upper_quartile: 75th percentile.
        within_one_sigma: Share whose truth is at most one sigma from the estimate, of those with a finite sigma.
        within_two_sigma: Likewise, two sigmas.
        absolute_low: Lower end of the 95 % interval of `median_absolute`; NaN where it was not asked for.
        absolute_high: Upper end.
    """

    num: int
    missing: float
    median: float
    median_absolute: float
    lower_quartile: float
    upper_quartile: float
    within_one_sigma: float
    within_two_sigma: float
    absolute_low: float = math.nan
    absolute_high: float = math.nan

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        return {name: plain(value) for name, value in dataclasses.asdict(self).items()}


def relative_errors(truth_m: Floats, ranges_m: Floats) -> Floats:
    """(estimate - truth) / truth; NaN without estimate.

    >>> relative_errors(np.array([50.0]), np.array([60.0])).tolist()
    [0.2]
    """
    return np.asarray((ranges_m - truth_m) / truth_m)


def summarise(truth_m: Floats, ranges_m: Floats, sigmas_m: Floats | None = None) -> ErrorSummary:
    """The errors of N lights; without sigmas, coverage is NaN.

    Args:
        truth_m: Shape (N,), positive.
        ranges_m: Shape (N,), NaN where there is no estimate.
        sigmas_m: Shape (N,).
    """
    is_known = ~np.isnan(ranges_m)
    errors = relative_errors(truth_m, ranges_m)[is_known]
    low, middle, high = np.percentile(errors, (25, 50, 75)).tolist() if len(errors) else (math.nan,) * 3
    one, two = math.nan, math.nan
    if sigmas_m is not None:
        is_told = is_known & np.isfinite(sigmas_m)
        off = np.abs(ranges_m - truth_m)[is_told] / sigmas_m[is_told]
        one, two = (_share(off <= limit) for limit in (1.0, 2.0))
    return ErrorSummary(
        num=len(truth_m),
        missing=_share(~is_known),
        median=middle,
        median_absolute=float(np.median(np.abs(errors))) if len(errors) else math.nan,
        lower_quartile=low,
        upper_quartile=high,
        within_one_sigma=one,
        within_two_sigma=two,
    )


def range_bins(truth_m: Floats) -> dict[str, NDArray[np.bool_]]:
    """For each bin of `RANGE_EDGES_M`, by its name such as `30-60 m`, which lights are in it; shape (N,) each."""
    return {f"{low:g}-{high:g} m": (truth_m >= low) & (truth_m < high) for low, high in pairwise(RANGE_EDGES_M)}


def median_interval(values: Floats, drives: NDArray[np.int64], seed: int = 0) -> tuple[float, float]:
    """The 95 % interval of the median, had other drives of the same sort been driven; NaN without values.

    Whole drives are drawn with replacement, since lights of a drive depend on each other.

    Args:
        values: Shape (N,); NaN ones are left out.
        drives: Shape (N,), the drive of each.
        seed: Of the draws.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13 (percentile interval).
    """
    names, places = np.unique(drives, return_inverse=True)
    is_known = ~np.isnan(values)
    if not is_known.any():
        return math.nan, math.nan
    order = np.argsort(values[is_known], kind="stable")
    ordered, its_drive = values[is_known][order], places[is_known][order]
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), NUM_RESAMPLES)
    cumulative = weights[:, its_drive].cumsum(axis=1)
    cumulative = cumulative[cumulative[:, -1] > 0]  # a resample may draw drives without values only
    middles = (2 * cumulative >= cumulative[:, -1:]).argmax(axis=1)
    low, high = np.percentile(ordered[middles], (2.5, 97.5)).tolist()
    return low, high


def _share(is_so: NDArray[np.bool_]) -> float:
    return float(is_so.mean()) if is_so.size else math.nan
