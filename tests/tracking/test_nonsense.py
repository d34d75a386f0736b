"""Trackers that are told nonsense: they keep within their memory, raise nothing, and follow what comes afterwards."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.config import OUR_TRACKER, TrackerConfig
from foreglow.tracking.tracker import MAX_TRACKS, AlphaBetaTracker
from foreglow.types import Detections, EgoMotion, Frame, TrackState
from tests.tracking.made_up import FRAME_S, detections_of, frame_at

LAMP = (600, 400, 620, 416, 0.9)
CONFIGS = {
    "paper": TrackerConfig(),
    "ours": OUR_TRACKER,
    "tracks alone": OUR_TRACKER.model_copy(update={"vehicle_gate": 0.0}),
}
each = pytest.mark.parametrize("name", CONFIGS)


def anywhere(rng: np.random.Generator, count: int) -> Detections:
    """Boxes in the left half of the image, where the lamp is not."""
    low = rng.integers(0, (480, 900), (count, 2))
    return detections_of(*np.concatenate([low, low + rng.integers(5, 60, (count, 2)), rng.random((count, 1))], axis=1))


def assert_follows(tracker: AlphaBetaTracker, start_s: float) -> None:
    """After all that, a lamp is followed and confirmed as ever."""
    for index in range(1, 10):
        tracks = tracker.update(frame_at(start_s + index * FRAME_S), detections_of(LAMP), None)
    followed = tracks.detections == 0
    assert tracks.states[followed].tolist() == [TrackState.CONFIRMED]
    np.testing.assert_allclose(tracks.boxes_xyxy_px[followed], [LAMP[:4]], atol=2)


@pytest.mark.parametrize("step_ns", [1, 1000, 1_000_000])
def test_a_clock_that_hardly_moves(step_ns: int) -> None:
    """A lamp that trembles is still followed when time goes on: its rate is not that of a pixel in a nanosecond."""
    tracker, rng = AlphaBetaTracker(OUR_TRACKER), np.random.default_rng(3)
    for index in range(40):
        box = np.array(LAMP[:4]) + rng.integers(-1, 2)
        tracks = tracker.update(frame_at(index * step_ns * 1e-9), detections_of((*box, 0.9)), None)
    assert tracks.ids.tolist() == [0]
    tracks = tracker.update(frame_at(40 * step_ns * 1e-9 + FRAME_S), detections_of(LAMP), None)
    assert tracks.ids.tolist() == [0]
    assert tracks.states.tolist() == [TrackState.CONFIRMED]


@pytest.mark.parametrize("times_s", [[5.0] * 40, [5.0 - 0.05 * n for n in range(40)], [5.0, 1.0] * 20])
@each
def test_time_that_stands_or_runs_back(name: str, times_s: list[float]) -> None:
    tracker, rng, ids = AlphaBetaTracker(CONFIGS[name]), np.random.default_rng(4), -1
    for time_s in times_s:
        tracks = tracker.update(frame_at(time_s), anywhere(rng, 10), None)
        if CONFIGS[name].clock == "time":
            assert tracks.ids.min() > ids
            assert not (tracks.num_misses > 0).any()
            ids = int(tracks.ids.max())
    assert_follows(tracker, 9.0)


@each
def test_another_camera_begins_anew(name: str) -> None:
    """A box of the large image is another place in the small one, and ids are not reused."""
    tracker = AlphaBetaTracker(CONFIGS[name])
    for index, size_px in enumerate([(1280, 960)] * 6 + [(640, 480)] + [(1280, 960)]):
        tracks = tracker.update(
            frame_at(index * FRAME_S, size_px=size_px), detections_of((300, 200, 320, 216, 0.9)), None
        )
        expected = max(index - 5, 0)
        assert tracks.ids.tolist() == [expected]
    assert_follows(tracker, 8 * FRAME_S)


@each
def test_hundreds_of_boxes_in_each_frame(name: str) -> None:
    """A lamp that was there before is still followed, and no more tracks are kept than the limit."""
    tracker, rng = AlphaBetaTracker(CONFIGS[name]), np.random.default_rng(5)
    for index in range(8):
        tracker.update(frame_at(index * FRAME_S), detections_of(LAMP), None)
    counts = []
    for index in range(8, 20):
        crowd = anywhere(rng, 300)
        boxes = np.concatenate([np.array([LAMP[:4]], np.int32), crowd.boxes_xyxy_px])
        scores = np.concatenate([[LAMP[4]], crowd.scores])
        rows = np.concatenate([boxes, scores[:, None]], axis=1)
        tracks = tracker.update(frame_at(index * FRAME_S), detections_of(*rows), None)
        counts.append(len(tracks))
    assert 0 in tracks.ids
    assert tracks.is_plausible[0]
    assert max(counts) <= MAX_TRACKS
    assert_follows(tracker, 20 * FRAME_S)


def turning(index: int, yaw_rate_radps: float) -> Frame:
    return dataclasses.replace(frame_at(index * FRAME_S, yaw_rate_radps=0.0), motion=EgoMotion(20.0, yaw_rate_radps))


@pytest.mark.parametrize("yaw_rate_radps", [1e3, -1e200, 1e308])
def test_a_turn_that_no_car_makes_is_not_known(yaw_rate_radps: float) -> None:
    tracker = AlphaBetaTracker(OUR_TRACKER)
    for index in range(12):
        tracks = tracker.update(turning(index, yaw_rate_radps if index > 5 else 0.0), detections_of(LAMP), None)
    assert tracks.ids.tolist() == [0]
    assert tracks.states.tolist() == [TrackState.CONFIRMED]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_motion_that_is_no_number_is_never_made(value: float) -> None:
    for fields in ((value, 0.0), (20.0, value)):
        with pytest.raises(ValueError, match="expected a finite number"):
            EgoMotion(*fields)
