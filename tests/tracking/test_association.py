"""Overlaps, gates and the two rules of assignment, against brute force and by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.tracking.association import (
    ASSOCIATIONS,
    UNASSIGNED,
    assign_greatest,
    assign_optimal,
    centres_and_sizes,
    corners,
    is_duplicate,
    is_range_apart,
    overlaps,
)


def random_boxes(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low = rng.integers(0, 30, (count, 2))
    return np.concatenate([low, low + rng.integers(1, 20, (count, 2))], axis=1).astype(np.float64)


def random_overlap(seed: int, shape: tuple[int, int]) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.random(shape) * (rng.random(shape) < 0.6)


@given(st.integers(0, 2**32 - 1))
def test_overlap_counts_pixels(seed: int) -> None:
    """On whole pixels, IoU is a count of pixels."""
    boxes_a, boxes_b = random_boxes(seed, 3), random_boxes(seed + 1, 4)
    filled = []
    for boxes in (boxes_a, boxes_b):
        images = np.zeros((len(boxes), 50, 50), np.bool_)
        for image, (x1, y1, x2, y2) in zip(images, boxes.astype(int), strict=True):
            image[y1:y2, x1:x2] = True
        filled.append(images)
    both = (filled[0][:, None] & filled[1]).sum(axis=(2, 3))
    either = (filled[0][:, None] | filled[1]).sum(axis=(2, 3))
    np.testing.assert_allclose(overlaps(boxes_a, boxes_b), both / either)


def test_growing_keeps_the_centre() -> None:
    boxes = np.array([[10.0, 20.0, 4.0, 8.0]])
    np.testing.assert_allclose(corners(boxes), [[8.0, 16.0, 12.0, 24.0]])
    np.testing.assert_allclose(corners(boxes, 1.5), [[7.0, 14.0, 13.0, 26.0]])
    np.testing.assert_allclose(centres_and_sizes(corners(boxes, 1.0)), boxes)


@pytest.mark.parametrize("rule", ASSOCIATIONS)
@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(st.integers(1, 6), st.integers(1, 6)))
def test_no_detection_twice_and_none_below_the_threshold(rule: str, seed: int, shape: tuple[int, int]) -> None:
    overlap = random_overlap(seed, shape)
    assigned = ASSOCIATIONS[rule](overlap, 0.3)
    assert assigned.shape == (shape[0],)
    taken = assigned[assigned != UNASSIGNED]
    assert len(set(taken.tolist())) == len(taken)
    assert (overlap[assigned != UNASSIGNED, taken] > 0.3).all()


@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(st.integers(1, 4), st.integers(1, 4)))
def test_optimal_is_the_best_of_all(seed: int, shape: tuple[int, int]) -> None:
    overlap = random_overlap(seed, shape)
    allowed = np.where(overlap > 0.2, overlap, 0.0)
    padded = np.concatenate([allowed, np.zeros((shape[0], shape[0]))], axis=1)
    best = max(
        padded[np.arange(shape[0]), list(columns)].sum()
        for columns in itertools.permutations(range(padded.shape[1]), shape[0])
    )
    assigned = assign_optimal(overlap, 0.2)
    rows = np.flatnonzero(assigned != UNASSIGNED)
    assert overlap[rows, assigned[rows]].sum() == pytest.approx(best)


@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(st.integers(1, 6), st.integers(1, 6)))
def test_greatest_gives_each_detection_its_best_track_or_none(seed: int, shape: tuple[int, int]) -> None:
    overlap = random_overlap(seed, shape)
    expected = np.full(shape[0], UNASSIGNED)
    for track in range(shape[0]):
        suitors = [
            (overlap[track, detection], -detection)
            for detection in range(shape[1])
            if overlap[:, detection].argmax() == track and overlap[track, detection] > 0.1
        ]
        if suitors:
            expected[track] = -max(suitors)[1]
    np.testing.assert_array_equal(assign_greatest(overlap, 0.1), expected)


@pytest.mark.parametrize("rule", ASSOCIATIONS)
def test_the_threshold_itself_is_not_enough(rule: str) -> None:
    assert ASSOCIATIONS[rule](np.array([[0.25]]), 0.25).tolist() == [UNASSIGNED]
    assert ASSOCIATIONS[rule](np.array([[0.25]]), 0.24).tolist() == [0]


def test_two_detections_on_one_track() -> None:
    overlap = np.array([[0.6, 0.5], [0.0, 0.4]])
    assert assign_greatest(overlap, 0.1).tolist() == [0, UNASSIGNED]
    assert assign_optimal(overlap, 0.1).tolist() == [0, 1]


def test_gate_of_ranges() -> None:
    """30 m apart with sigmas of 6 and 8 m is 3 sigmas; unknown ranges are never apart."""
    tracks, detections = np.array([100.0, np.nan]), np.array([130.0, 131.0, np.nan, 500.0])
    sigmas = (np.array([6.0, np.inf]), np.array([8.0, 8.0, np.nan, np.inf]))
    expected = [[False, True, False, False], [False] * 4]
    assert is_range_apart((tracks, detections), sigmas, 3.0).tolist() == expected
    assert is_range_apart((tracks, detections), sigmas, 2.9)[0].tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("is_detected", "num_hits", "expected"),
    [
        ([True, True], [9, 2], [False, False]),  # the detector sees two
        ([True, False], [9, 2], [False, True]),
        ([True, False], [2, 9], [True, False]),
        ([False, False], [4, 4], [False, True]),  # of equals the later one
    ],
)
def test_duplicates(is_detected: list[bool], num_hits: list[int], expected: list[bool]) -> None:
    overlap = np.array([[1.0, 0.6], [0.6, 1.0]])
    assert is_duplicate(overlap, np.array(is_detected), np.array(num_hits), 0.5).tolist() == expected
    assert not is_duplicate(overlap, np.array(is_detected), np.array(num_hits), 0.6).any()
