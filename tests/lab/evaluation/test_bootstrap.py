"""The paired bootstrap over scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.evaluation import evaluate_boxes
from foreglow.lab.evaluation.bootstrap import (
    f1,
    paired_bootstrap,
    percentile_interval,
    ratio,
    scene_counts,
)
from foreglow.lab.evaluation.boxes.matching import match_boxes
from foreglow.lab.evaluation.ratios import ratios
from tests.lab.evaluation.scored_boxes import random_case


@pytest.mark.parametrize("threshold", [0.0, 0.45, 0.9])
def test_counts_of_scenes_add_up_to_the_metrics(threshold: float) -> None:
    points, predictions = random_case(2)
    counts = scene_counts(match_boxes(points, predictions), {image_id: image_id % 5 for image_id in points}, threshold)
    quality = evaluate_boxes(points, predictions, threshold)
    assert counts.shape == (5, 3)
    assert counts.sum(axis=0).tolist() == [quality.tp, quality.fp, quality.fn]
    assert math.isclose(float(f1(counts.sum(axis=0))), quality.f1)
    own = {image_id: points[image_id] for image_id in points if image_id % 5 == 3}
    alone = evaluate_boxes(own, predictions, threshold)
    assert counts[3].tolist() == [alone.tp, alone.fp, alone.fn]


def test_scenes_without_anything_keep_their_place() -> None:
    points, predictions = random_case(2, num_images=3)
    empty = {**points, 9: np.empty((0, 2))}
    counts = scene_counts(match_boxes(empty, predictions), {0: 4, 1: 4, 2: 6, 9: 5}, 0.5)
    assert counts[1].tolist() == [0, 0, 0]


def test_a_detector_against_itself() -> None:
    counts = np.array([[3.0, 1, 2], [5, 0, 1], [0, 2, 2]])
    found = paired_bootstrap(counts, counts, num_resamples=200)
    assert (found.difference, found.mean, found.low, found.high, found.probability) == (0, 0, 0, 0, 1)


def test_a_better_one_in_every_scene() -> None:
    worse = np.array([[3.0, 4, 2], [5, 3, 3], [2, 2, 2], [4, 1, 4]])
    better = worse + np.array([1.0, -1, -1])
    found = paired_bootstrap(better, worse, num_resamples=500)
    assert found.low > 0
    assert found.probability == 1.0
    assert found.low <= found.mean <= found.high
    assert found.a == float(f1(better.sum(axis=0)))
    back = paired_bootstrap(worse, better, num_resamples=500)
    assert math.isclose(back.mean, -found.mean)
    assert back.probability == 0.0


def recall(counts: Floats) -> Floats:
    return ratios(counts[..., 0], counts[..., 0] + counts[..., 2])


def precision(counts: Floats) -> Floats:
    return ratios(counts[..., 0], counts[..., 0] + counts[..., 1])


def test_the_seed_decides() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 9, (20, 3)).astype(float), rng.integers(0, 9, (20, 3)).astype(float)
    assert paired_bootstrap(a, b, seed=4, num_resamples=600) == paired_bootstrap(a, b, seed=4, num_resamples=600)
    assert paired_bootstrap(a, b, seed=4).mean != paired_bootstrap(a, b, seed=5).mean


def test_the_interval_is_that_of_a_mean() -> None:
    # Recall of scenes with ten lights each is a mean of scenes; its interval is 1.96 standard errors.
    found_lights = np.random.default_rng(1).integers(0, 11, 60).astype(float)
    counts = np.stack([found_lights, np.zeros(60), 10 - found_lights], axis=1)
    nothing = np.tile([0.0, 0.0, 10.0], (60, 1))
    found = paired_bootstrap(counts, nothing, recall, num_resamples=4000)
    error = found_lights.std() / 10 / math.sqrt(60)
    assert found.high - found.low == pytest.approx(2 * 1.96 * error, rel=0.06)


def test_undefined_resamples_are_left_out() -> None:
    counts = np.array([[1.0, 1, 0], [0, 0, 1]])  # no box at all in the second scene
    found = paired_bootstrap(counts, counts, precision, num_resamples=400)
    assert found.num_resamples == pytest.approx(300, abs=40)
    with pytest.raises(ValueError, match="defined"):
        paired_bootstrap(counts[1:], counts[1:], precision, num_resamples=10)


def test_of_a_single_scene_there_is_no_interval() -> None:
    """One of no width looked like certainty."""
    found = paired_bootstrap(np.array([[3.0, 1, 2]]), np.array([[2.0, 1, 3]]))
    assert found.difference > 0
    assert all(map(math.isnan, (found.low, found.high, found.probability)))


def test_the_same_scenes_are_needed() -> None:
    with pytest.raises(ValueError, match="same shape"):
        paired_bootstrap(np.ones((2, 3)), np.ones((3, 3)))
    with pytest.raises(ValueError, match="same shape"):
        paired_bootstrap(np.ones((0, 3)), np.ones((0, 3)))


def test_the_interval_of_one_figure() -> None:
    counts = np.stack([np.random.default_rng(3).uniform(0, 10, 60), np.full(60, 10.0)], axis=1)
    low, high = percentile_interval(counts, ratio, num_resamples=4000)
    error = counts[:, 0].std() / 10 / math.sqrt(60)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.06)
    assert low < float(ratio(counts.sum(axis=0))) < high
    assert np.isnan(percentile_interval(counts[:1], ratio)).all()  # of one scene nothing is known about others


def test_an_interval_of_nothing() -> None:
    for counts in (np.ones((0, 2)), np.full((3, 2), math.nan)):
        assert np.isnan(percentile_interval(counts, ratio)).all()
