"""Curves over thresholds: parity with the metrics at each threshold, and laws."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.files import to_json
from foreglow.lab.evaluation import Predictions, evaluate_boxes
from foreglow.lab.evaluation.boxes.curves import (
    distinct_thresholds,
    quality_curve,
    recall_curve,
    threshold_at_false_boxes,
)
from foreglow.lab.evaluation.boxes.matching import match_boxes
from tests.lab.evaluation.scored_boxes import is_same, predictions_of, random_case

TWO_IMAGES = {1: np.array([[10.0, 10], [20, 10]]), 2: np.array([[50.0, 50]])}


@pytest.mark.parametrize("seed", range(8))
def test_parity_with_the_metrics_at_every_threshold(seed: int) -> None:
    points, predictions = random_case(seed)
    matches = match_boxes(points, predictions)
    for thresholds in (distinct_thresholds(matches.scores), np.array([0.0, 0.05, 0.5, 0.95, 1.0])):
        curve = quality_curve(matches, thresholds)
        for index, threshold in enumerate(thresholds.tolist()):
            everything = dataclasses.replace(predictions, is_scored=threshold >= 0)  # below all scores, all boxes count
            quality = evaluate_boxes(points, everything, max(0.0, threshold))
            for name in ("precision", "recall", "f1", "q", "q_k", "q_b"):
                assert is_same(getattr(curve, name)[index], getattr(quality, name)), (name, threshold)
            assert curve.false_boxes_per_frame[index] == quality.fp / len(points)


@pytest.mark.parametrize("seed", range(4))
def test_recall_and_false_boxes_fall_with_the_threshold(seed: int) -> None:
    curve = quality_curve(match_boxes(*random_case(seed)))
    assert (np.diff(curve.thresholds) > 0).all()
    assert (np.diff(curve.recall) <= 0).all()
    assert (np.diff(curve.false_boxes_per_frame) <= 0).all()
    assert curve.recall[-1] == curve.false_boxes_per_frame[-1] == 0


def test_average_precision_worked_by_hand() -> None:
    # By falling score: a hit (P 1, R 1/3), a false box (P 1/2), a hit (P 2/3, R 2/3), a false box; one never found.
    boxes = {1: [(0, 0, 12, 12, 0.9), (70, 70, 80, 80, 0.8), (18, 8, 22, 12, 0.7)], 2: [(0, 0, 5, 5, 0.6)]}
    curve = quality_curve(match_boxes(TWO_IMAGES, predictions_of(boxes)))
    assert math.isclose(curve.average_precision, 1 / 3 * 1 + 1 / 3 * 2 / 3)
    threshold, f1 = curve.best
    assert (threshold, f1) == (0.6, 2 / (2 + (1 + 1) / 2))


def test_perfect_scores() -> None:
    boxes = {1: [(9, 9, 11, 11, 0.9), (19, 9, 21, 11, 0.8), (0, 0, 1, 1, 0.1)], 2: [(49, 49, 51, 51, 0.9)]}
    curve = quality_curve(match_boxes(TWO_IMAGES, predictions_of(boxes)))
    assert curve.average_precision == 1.0
    assert curve.best == (0.1, 1.0)


def test_no_best_threshold_lies_below_0() -> None:
    """Every box counts below 0, also one of score 0, and F was higher there; a threshold of 0 was printed as -0.000."""
    boxes = {1: [(9, 9, 11, 11, 0.9), (19, 9, 21, 11, 0.0)], 2: [(49, 49, 51, 51, 0.0)]}
    curve = quality_curve(match_boxes(TWO_IMAGES, predictions_of(boxes)))
    assert curve.thresholds[0] < 0
    assert curve.best == (0.0, 1 / (1 + 2 / 2))


def test_nothing_to_rate() -> None:
    empty = Predictions({}, {})
    curve = quality_curve(match_boxes({1: np.empty((0, 2))}, empty))
    assert curve.thresholds.tolist() == [0.0]
    assert math.isnan(curve.average_precision)
    assert all(math.isnan(value) for value in curve.best)
    missed = quality_curve(match_boxes(TWO_IMAGES, empty))
    assert missed.average_precision == 0.0
    assert to_json(missed)["precision"] == [None]


def test_boxes_without_scores_have_no_curve() -> None:
    plain = Predictions({1: np.array([[0.0, 0, 9, 9]])}, {1: np.ones(1)}, is_scored=False)
    with pytest.raises(ValueError, match="with scores"):
        quality_curve(match_boxes({1: np.empty((0, 2))}, plain))


def test_thresholds_at_a_limit_of_false_boxes() -> None:
    scores = np.array([0.9, 0.8, 0.8, 0.3])
    assert threshold_at_false_boxes(scores, 4, 0.25) == 0.8  # both of 0.8 would come at once
    assert threshold_at_false_boxes(scores, 4, 0.75) == 0.3
    assert threshold_at_false_boxes(scores, 4, 1.0) == 0.0
    assert threshold_at_false_boxes(scores, 4, 0.0) == 0.9
    assert threshold_at_false_boxes(np.zeros(15), 15, 0.2) == 0.0
    assert threshold_at_false_boxes(np.empty(0), 1, 0.0) == 0.0
    with pytest.raises(ValueError, match="at least one image"):
        threshold_at_false_boxes(scores, 0, 0.1)
    with pytest.raises(ValueError, match="false boxes a frame"):
        threshold_at_false_boxes(scores, 4, -0.1)


@pytest.mark.parametrize("seed", range(6))
def test_the_threshold_is_the_lowest_that_keeps_the_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores, limit = rng.integers(1, 30, 40) / 30.0, float(rng.uniform(0, 1.2))
    threshold = threshold_at_false_boxes(scores, 30, limit)
    assert (scores > threshold).sum() <= limit * 30
    lower = max((score for score in [0.0, *scores] if score < threshold), default=None)
    assert lower is None or (scores > lower).sum() > limit * 30


def test_recall_over_false_boxes_worked_by_hand() -> None:
    curve = recall_curve(np.array([0.9, 0.4, -np.inf]), np.array([0.6, 0.2]), 10)
    assert curve.thresholds.tolist() == [0.0, 0.2, 0.4, 0.6, 0.9]
    assert curve.false_boxes_per_frame.tolist() == [0.2, 0.1, 0.1, 0.0, 0.0]
    assert [round(3 * value) for value in curve.recall.tolist()] == [2, 2, 1, 1, 0]
    assert curve.corners().thresholds.tolist() == [0.2, 0.6, 0.9]
    assert curve.corners(2).thresholds.tolist() == [0.2, 0.9]
    nothing = recall_curve(np.empty(0), np.array([0.5]), 0)
    assert np.isnan(nothing.recall).all()
    assert np.isnan(nothing.false_boxes_per_frame).all()
