"""Calibration: hand-worked cases, and scores of a known law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import expit

from foreglow.lab.evaluation.boxes.score_calibration import (
    calibration,
    expected_calibration_error,
    fit_temperature,
    logits_of,
    reliability,
)


def test_figures_worked_by_hand() -> None:
    found = calibration([0.25, 0.25, 0.75, 0.75], [0, 0, 1, 0], num_bins=2)
    assert [(part.num, part.mean_score, part.share) for part in found.bins] == [(2, 0.25, 0.0), (2, 0.75, 0.5)]
    assert [(tenth.num, tenth.mean_score, tenth.share) for tenth in found.tenths] == [(2, 0.25, 0.0), (2, 0.75, 0.5)]
    assert found.ece == 0.25
    assert found.brier == (3 * 0.0625 + 0.5625) / 4
    assert math.isclose(found.nll, -(3 * math.log(0.75) + math.log(0.25)) / 4)
    assert (found.num, found.share) == (4, 0.25)
    assert found.temperature == pytest.approx(1.0, abs=1e-5)  # three of four are right where the score says so


def test_equal_scores_share_a_bin() -> None:
    scores, labels = [0.0] * 8 + [0.9, 1.0], [0, 1] * 4 + [1, 1]
    assert [each.num for each in reliability(scores, labels, 5)] == [8, 2]
    assert [each.num for each in reliability([0.5] * 3, [1, 0, 0], 10)] == [3]
    assert reliability([], [], 4) == ()
    assert math.isnan(expected_calibration_error([], []))


def test_bins_hold_all_boxes_in_order() -> None:
    rng = np.random.default_rng(3)
    scores = rng.random(1003)
    bins = reliability(scores, scores > 0.5, 15)
    assert len(bins) == 15
    assert sum(part.num for part in bins) == 1003
    assert max(part.num for part in bins) - min(part.num for part in bins) <= 1
    means = [part.mean_score for part in bins]
    assert means == sorted(means)


def test_temperature_is_found_again() -> None:
    rng = np.random.default_rng(5)
    logits = rng.normal(0.0, 2.0, 40_000)
    labels = rng.random(len(logits)) < expit(logits)  # calibrated as they are
    assert fit_temperature(logits, labels) == pytest.approx(1.0, abs=0.05)
    assert fit_temperature(3.0 * logits, labels) == pytest.approx(3.0, abs=0.15)
    before, after = expit(3.0 * logits), expit(logits)
    assert expected_calibration_error(before, labels) > 5 * expected_calibration_error(after, labels)


def test_scores_that_say_nothing_have_no_temperature_to_be_corrected_by() -> None:
    assert fit_temperature([0.0] * 6, [1, 1, 0, 0, 0, 0]) == 1.0
    assert calibration([0.5] * 6, [1, 1, 0, 0, 0, 0]).temperature == 1.0


def test_the_temperature_is_a_minimum() -> None:
    rng = np.random.default_rng(6)
    logits, labels = rng.normal(size=200), rng.random(200) < 0.4
    best = fit_temperature(logits, labels)

    def nll(temperature: float) -> float:
        return float(np.mean(np.logaddexp(0, np.where(labels, -1, 1) * logits / temperature)))

    assert all(nll(best) <= nll(best * factor) + 1e-9 for factor in (0.5, 0.9, 1.1, 2.0))


def test_faultless_scores_end_at_the_limit() -> None:
    assert fit_temperature([-3.0, 3.0], [0, 1]) == pytest.approx(0.02, rel=0.2)


def test_certainty_stays_finite() -> None:
    found = calibration([0.0, 1.0, 1.0], [0, 1, 0])
    assert math.isfinite(found.nll)
    assert [(tenth.num, tenth.share) for tenth in found.tenths] == [(1, 0.0), (2, 0.5)]
    assert np.isfinite(logits_of([0.0, 1.0])).all()


@pytest.mark.parametrize("labels", [[0, 0], [1, 1]])
def test_one_class_alone_is_an_error(labels: list[int]) -> None:
    with pytest.raises(ValueError, match="with and without"):
        calibration([0.1, 0.2], labels)


def test_shapes_have_to_fit() -> None:
    with pytest.raises(ValueError, match="one a score"):
        fit_temperature([0.1, 0.2], [1])
