"""Laws that hold for every tracker."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.config import OUR_TRACKER, TrackerConfig
from foreglow.tracking import TRACKERS, Tracker, make_tracker
from foreglow.types import Detections, Ranges, Tracks, TrackState, Vehicles
from tests.tracking.made_up import FRAME_S, detections_of, frame_at

FIELDS = tuple(Tracks.__dataclass_fields__.keys() - {"vehicles"})
VEHICLE_FIELDS = tuple(Vehicles.__dataclass_fields__)
CONFIGS = {
    **{name: TrackerConfig.model_validate({"method": name}) for name in TRACKERS},
    "ours": OUR_TRACKER,
    "tracks alone": OUR_TRACKER.model_copy(update={"vehicle_gate": 0.0}),
    "m_of_n": TrackerConfig(confirmation="m_of_n", range_filter="median", range_gate=3.0, clock="time"),
}
pytestmark = pytest.mark.parametrize("name", CONFIGS)

Scene = list[tuple[Detections, Ranges | None]]


def crowd(seed: int, num_frames: int = 60) -> Scene:
    """Lights that wander, flicker, appear and leave, some beside the image, with ranges now and then."""
    rng = np.random.default_rng(seed)
    positions, speeds = rng.uniform(0, 1, (14, 2)) * (1280, 960), rng.normal(0, 8, (14, 2))
    scene: Scene = []
    for number in range(num_frames):
        positions = positions + speeds
        is_seen = rng.random(14) < (0.0 if number % 20 == 19 else 0.7)
        low = np.rint(positions[is_seen] + rng.normal(0, 1, (is_seen.sum(), 2)))
        rows = np.concatenate([low, low + rng.integers(5, 40, low.shape), rng.random((len(low), 1))], axis=1)
        found = detections_of(*rows.tolist())
        ranges_m = np.where(rng.random(len(low)) < 0.5, rng.uniform(5, 300, len(low)), np.nan)
        sigmas_m = np.where(np.isnan(ranges_m) | (ranges_m < 20), np.inf, 0.1 * ranges_m)
        scene.append((found, Ranges(found, ranges_m, sigmas_m) if number % 3 else None))
    return scene


def followed(tracker: Tracker, scene: Scene) -> list[Tracks]:
    return [
        tracker.update(frame_at(index * FRAME_S, yaw_rate_radps=0.1), found, ranges)
        for index, (found, ranges) in enumerate(scene)
    ]


def arrays_of(tracks: Tracks) -> dict[str, NDArray[Any]]:
    """All arrays by name, those of the vehicles with them."""
    arrays = {name: getattr(tracks, name) for name in FIELDS}
    if tracks.vehicles is not None:
        arrays |= {f"vehicles.{name}": getattr(tracks.vehicles, name) for name in VEHICLE_FIELDS}
    return arrays


def assert_same(arrays: dict[str, NDArray[Any]], others: dict[str, NDArray[Any]]) -> None:
    assert arrays.keys() == others.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, others[name], err_msg=name)


def test_ids_are_never_given_twice(name: str) -> None:
    gone: set[int] = set()
    before: set[int] = set()
    for tracks in followed(make_tracker(CONFIGS[name]), crowd(1)):
        ids = set(tracks.ids.tolist())
        assert not ids & gone
        gone |= before - ids
        before = ids
    assert len(gone) > 20


def test_states_agree_with_counts(name: str) -> None:
    seen = set()
    for (found, _), tracks in zip(crowd(2), followed(make_tracker(CONFIGS[name]), crowd(2)), strict=True):
        is_detected = tracks.detections >= 0
        np.testing.assert_array_equal(is_detected, tracks.num_misses == 0)
        assert (is_detected[tracks.states == TrackState.CONFIRMED]).all()
        assert not (is_detected[tracks.states == TrackState.COASTING]).any()
        assert set(tracks.states.tolist()) <= set(TrackState)
        assert (tracks.detections < len(found)).all()
        assert (tracks.num_hits >= 1).all()
        assert (tracks.ages_s >= 0).all()
        assert ((tracks.confidences >= 0) & (tracks.confidences <= 1)).all()
        assert ((tracks.ranges_m > 0) | np.isnan(tracks.ranges_m)).all()
        assert (tracks.sigmas_m > 0).all()
        assert np.isinf(tracks.sigmas_m[np.isnan(tracks.ranges_m)]).all()
        seen |= set(tracks.states.tolist())
    assert seen == set(TrackState)


def test_every_considered_detection_has_a_track_of_its_own(name: str) -> None:
    for (found, _), tracks in zip(crowd(3), followed(make_tracker(CONFIGS[name]), crowd(3)), strict=True):
        taken = tracks.detections[tracks.detections >= 0].tolist()
        assert len(set(taken)) == len(taken)
        assert (found.scores[taken] > 0.1).all()


@pytest.mark.slow
def test_the_same_frames_give_the_same_tracks_also_after_a_reset(name: str) -> None:
    tracker = make_tracker(CONFIGS[name])
    first = followed(tracker, crowd(4))
    followed(tracker, crowd(5))
    tracker.reset()
    for tracks, other in zip(first, followed(tracker, crowd(4)), strict=True):
        assert_same(arrays_of(tracks), arrays_of(other))


def test_earlier_results_stay_as_they_are(name: str) -> None:
    tracker = make_tracker(CONFIGS[name])
    scene = crowd(6)
    kept = followed(tracker, scene[:20])
    copies = [{name: array.copy() for name, array in arrays_of(tracks).items()} for tracks in kept]
    for index, (found, ranges) in enumerate(scene[20:], start=20):
        tracker.update(frame_at(index * FRAME_S), found, ranges)
    for tracks, copy in zip(kept, copies, strict=True):
        assert_same(arrays_of(tracks), copy)


def test_nothing_gives_nothing(name: str) -> None:
    tracker = make_tracker(CONFIGS[name])
    for index in range(3):
        assert len(tracker.update(frame_at(index * FRAME_S), detections_of(), None)) == 0


def test_a_light_that_stays_is_one_confirmed_track(name: str) -> None:
    tracker = make_tracker(CONFIGS[name])
    for index in range(10):
        tracks = tracker.update(frame_at(index * FRAME_S), detections_of((600, 400, 620, 416, 0.9)), None)
    assert tracks.ids.tolist() == [0]
    assert tracks.states.tolist() == [TrackState.CONFIRMED]
    assert tracks.num_hits.tolist() == [10]
    np.testing.assert_allclose(tracks.boxes_xyxy_px, [[600, 400, 620, 416]], atol=1e-9)
    assert tracks.ages_s[0] == pytest.approx(9 * FRAME_S)


def test_two_hundred_boxes(name: str) -> None:
    x, y = np.meshgrid(np.arange(20) * 60, np.arange(10) * 80)
    rows = np.stack([x, y, x + 20, y + 20, np.full(x.shape, 0.9)], -1).reshape(-1, 5).tolist()
    tracker = make_tracker(CONFIGS[name])
    for index in range(6):
        tracks = tracker.update(frame_at(index * FRAME_S), detections_of(*rows), None)
    assert tracks.ids.tolist() == list(range(200))
    assert tracks.detections.tolist() == list(range(200))
    assert (tracks.states == TrackState.CONFIRMED).all()
