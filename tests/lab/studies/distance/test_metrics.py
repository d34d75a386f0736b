from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.files import to_json
from foreglow.lab.evaluation.boxes.breakdown import range_bins
from foreglow.lab.studies.distance.metrics import median_interval, relative_errors, summarise


def test_by_hand() -> None:
    truth = np.array([10.0, 20.0, 40.0, 50.0, 100.0])
    ranges = np.array([12.0, 10.0, 40.0, np.nan, 130.0])  # +0.2, -0.5, 0, none, +0.3
    sigmas = np.array([2.0, 4.0, 1.0, np.inf, np.inf])
    errors = summarise(truth, ranges, sigmas)
    assert (errors.num, errors.missing) == (5, 0.2)
    assert errors.median == pytest.approx(0.1)
    assert errors.median_absolute == pytest.approx(0.25)
    assert (errors.lower_quartile, errors.upper_quartile) == pytest.approx((-0.125, 0.225))
    # Of the three with a finite sigma, two are within one, and 10 m is 2.5 sigmas off.
    assert (errors.within_one_sigma, errors.within_two_sigma) == pytest.approx((2 / 3, 2 / 3))


def test_nothing_to_summarise() -> None:
    errors = summarise(np.zeros(0), np.zeros(0), np.zeros(0))
    assert errors.num == 0
    assert all(value is None for name, value in to_json(errors).items() if name != "num")
    unknown = summarise(np.ones(3), np.full(3, np.nan))
    assert (unknown.missing, math.isnan(unknown.median), math.isnan(unknown.within_one_sigma)) == (1.0, True, True)
    json.dumps(to_json(unknown), allow_nan=False)


@settings(derandomize=True, max_examples=100)
@given(st.lists(st.floats(1.0, 400.0), min_size=1, max_size=30), st.floats(0.1, 10.0))
def test_a_wrong_scale_is_the_error(truths: list[float], scale: float) -> None:
    truth = np.array(truths)
    errors = summarise(truth, scale * truth, np.abs(scale - 1) * truth * 1.001 + 1e-9)
    assert errors.median == pytest.approx(scale - 1, abs=1e-9)
    assert errors.median_absolute == pytest.approx(abs(scale - 1), abs=1e-9)
    assert errors.within_one_sigma == 1.0


def test_too_far_is_positive() -> None:
    assert relative_errors(np.array([100.0]), np.array([150.0])).tolist() == [0.5]


def test_bins_have_their_lower_edge() -> None:
    bins = range_bins(np.array([0.0, 29.9, 30.0, 199.0, 400.0]))
    assert list(bins) == ["0-30 m", "30-60 m", "60-90 m", "90-130 m", "130-200 m", "200-400 m"]
    assert [np.flatnonzero(is_in).tolist() for is_in in bins.values()] == [[0, 1], [2], [], [], [3], []]


def test_an_interval_holds_the_median_and_narrows() -> None:
    generator = np.random.default_rng(5)
    few, many = generator.normal(2.0, 1.0, 20), generator.normal(2.0, 1.0, 2000)
    wide, narrow = (median_interval(each, np.arange(len(each)), seed=3) for each in (few, many))
    assert wide[0] <= np.median(few) <= wide[1]
    assert narrow[0] <= np.median(many) <= narrow[1]
    assert narrow[1] - narrow[0] < (wide[1] - wide[0]) / 4
    # Standard error of a median: 1.2533 sigma / sqrt(n).
    assert narrow[1] - narrow[0] == pytest.approx(2 * 1.96 * 1.2533 / math.sqrt(2000), rel=0.2)


def test_drives_are_drawn_whole() -> None:
    """A thousand lights of two drives are no more than two lights."""
    values, drives = np.repeat([1.0, 3.0], 500), np.repeat([7, 9], 500)
    assert median_interval(values, drives) == (1.0, 3.0)
    assert median_interval(values, np.arange(1000))[0] == 1.0


def test_unknown_values_count_for_nothing() -> None:
    values, drives = np.array([np.nan, 2.0, np.nan, 2.0]), np.array([1, 2, 3, 4])
    assert median_interval(values, drives) == (2.0, 2.0)


@pytest.mark.parametrize("num", [1, 3])
def test_fewer_than_two_drives_have_no_interval(num: int) -> None:
    values, drives = np.array([np.nan, 2.0, 3.0]), np.array([1, 2, 2])
    assert all(math.isnan(end) for end in median_interval(values[:num], drives[:num]))
