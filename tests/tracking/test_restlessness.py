"""Light that runs along what it lights is a vehicle's sooner than light that keeps its place."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.config import OUR_TRACKER, TrackerConfig
from foreglow.tracking.restlessness import MAX_DIRECT, RESTLESS_RAD, STEADY_RAD, restlessness, scores_of_restless
from foreglow.tracking.tracker import AlphaBetaTracker
from foreglow.types import Detections
from foreglow.types.kinds import kinds_of_direct
from tests.tracking.made_up import FRAME_S, detections_of, frame_at

OURS = OUR_TRACKER.model_copy(update={"neutral_score": 0.7, "restless_evidence": 1.5, "vehicle_gate": 0.0})
SCORE = 0.7
"""No evidence by itself."""

STEADY, RESTLESS = (600, 600, 600, 600, 600, 600), (600, 606, 598, 604, 596, 606)
"""Left edges of a box, in pixels, frame by frame."""


def light_at(left_px: float, direct: float) -> Detections:
    """A light that is a lamp in sight with the probability `direct`."""
    kinds = kinds_of_direct(np.array([direct], np.float32))
    return dataclasses.replace(detections_of((left_px, 400, left_px + 40, 420, SCORE)), light_kinds=kinds)


def is_confirmed(lefts: Sequence[float], direct: float = 0.1, config: TrackerConfig = OURS) -> bool:
    tracker = AlphaBetaTracker(config)
    for index, left in enumerate(lefts):
        detections = light_at(left, direct)
        tracks = tracker.update(frame_at(index * FRAME_S), detections, None)
    assert len(tracks) == 1
    return bool(tracks.is_plausible[0])


def test_restless_light_is_confirmed_with_scores_with_which_steady_light_is_not() -> None:
    assert is_confirmed(RESTLESS)
    assert not is_confirmed(STEADY)


def test_steady_motion_is_no_restlessness() -> None:
    """As of a post that we pass."""
    assert not any(is_confirmed([600 + 9 * step for step in range(count)]) for count in range(1, 20))


def test_a_missed_frame_is_no_restlessness() -> None:
    tracker = AlphaBetaTracker(OURS)
    for index in (0, 1, 3, 4, 7, 8):
        tracks = tracker.update(frame_at(index * FRAME_S), light_at(600 + 9 * index, 0.1), None)
        assert len(tracks) == 1
        assert not tracks.is_plausible.any()


def test_a_lamp_in_sight_is_not_judged_by_it() -> None:
    assert is_confirmed(RESTLESS, direct=MAX_DIRECT - 0.01)
    assert not is_confirmed(RESTLESS, direct=MAX_DIRECT + 0.01)


def test_without_a_weight_only_scores_count() -> None:
    assert not is_confirmed(RESTLESS, config=OURS.model_copy(update={"restless_evidence": 0.0}))
    assert TrackerConfig().restless_evidence == 0.0


def test_an_outlier_counts_no_more_the_further_away_it_is() -> None:
    """As of two boxes that are one for a frame."""
    config = OURS.model_copy(update={"neutral_score": 0.75})
    near, far = ([600, 600, 600, 600 + jump, *[600] * 26] for jump in (15, 30))
    histories = [[is_confirmed(lefts[:count], config=config) for count in range(1, 31)] for lefts in (near, far)]
    assert histories[0] == histories[1]
    assert any(histories[0])
    assert not histories[0][-1]


def test_an_angle_in_each_frame() -> None:
    angle_rad = math.sqrt(STEADY_RAD * RESTLESS_RAD)
    found = restlessness(np.array([-1.0, 2.0, 1.0, np.nan]) * 1e3 * angle_rad, 1e3, np.array([1.0, 2.0, 0.5, 1.0]))
    assert found.tolist() == pytest.approx([0.5, 0.5, 0.5, np.nan], nan_ok=True)


@given(st.lists(st.floats(0, 1e4), min_size=2, max_size=9), st.floats(1, 1e4), st.floats(0, 20))
def test_further_away_is_never_less_restless(residuals: list[float], focal_px: float, num_frames: float) -> None:
    found = restlessness(np.sort(residuals), focal_px, np.full(len(residuals), num_frames))
    assert (np.diff(found) >= 0).all()
    assert found.min() >= 0
    assert found.max() <= 1


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.floats(0, 10))
def test_more_restless_is_never_less_of_a_vehicle(score: float, first: float, second: float, weight: float) -> None:
    below, above = scores_of_restless(np.full(2, score), np.sort([first, second]), np.full(2, np.nan), weight)
    assert score - 1e-12 <= below <= above + 1e-12 <= 1.0 + 1e-12
