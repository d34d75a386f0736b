"""Ratios of nothing are not defined, and neither is what is made of them."""

from __future__ import annotations

import math

import numpy as np

from foreglow.lab.evaluation.ratios import mean, median, percentiles, ratio, ratios, share


def test_nothing_is_nan() -> None:
    assert all(
        math.isnan(value) for value in (ratio(0, 0), ratio(1, math.nan), share([]), mean([]), median([math.nan]))
    )
    assert all(map(math.isnan, percentiles([], (25, 75))))
    assert np.isnan(ratios([1.0, 2.0], 0.0)).all()


def test_by_hand() -> None:
    assert ratios([1.0, 2.0], [4.0, 0.0])[0] == 0.25
    assert share(np.array([True, False, False, True])) == 0.5
    assert (mean([1.0, math.nan, 4.0]), median([5.0, 1.0, math.nan, 2.0])) == (2.5, 2.0)
    assert percentiles(np.array([0.0, 10.0]), (25, 100)) == (2.5, 10.0)
