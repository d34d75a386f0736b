"""Ratios, shares and percentiles that are NaN where there is nothing to rate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats


def ratio(part: SupportsFloat, whole: SupportsFloat) -> float:
    """Part over whole; NaN unless the whole is positive.

    >>> ratio(1, 4), ratio(1, 0)
    (0.25, nan)
    """
    return float(part) / float(whole) if float(whole) > 0 else math.nan


def ratios(parts: ArrayLike, wholes: ArrayLike) -> Floats:
    """`ratio` element by element, for arrays whose shapes are broadcast."""
    parts, wholes = np.broadcast_arrays(np.asarray(parts, np.float64), np.asarray(wholes, np.float64))
    return np.asarray(np.divide(parts, wholes, out=np.full(wholes.shape, np.nan), where=wholes > 0))


def share(is_member: NDArray[np.bool_] | Sequence[bool]) -> float:
    """The share that is true; NaN of nothing.

    >>> share([True, False]), share([])
    (0.5, nan)
    """
    return ratio(np.count_nonzero(is_member), len(is_member))


def mean(values: Iterable[float]) -> float:
    """The mean of the values that are not NaN; NaN of nothing."""
    known = _known(values)
    return float(known.mean()) if len(known) else math.nan


def median(values: Iterable[float]) -> float:
    """The median of the values that are not NaN; NaN of nothing."""
    known = _known(values)
    return float(np.median(known)) if len(known) else math.nan


def percentiles(values: Iterable[float], ranks: Sequence[float]) -> tuple[float, ...]:
    """The percentiles at `ranks` of the values that are not NaN, linear in between; NaN of nothing.

    >>> percentiles([1.0, 2.0, math.nan, 6.0], (0, 50))
    (1.0, 2.0)
    """
    known = _known(values)
    return tuple(np.percentile(known, ranks).tolist()) if len(known) else (math.nan,) * len(ranks)


def _known(values: Iterable[float]) -> Floats:
    array = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.float64)
    return array[~np.isnan(array)]
