"""The published code's tracker: its trace, and each of its quirks."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from foreglow.config import TrackerConfig
from foreglow.tracking.published import PublishedObject, PublishedTracker, Sighting
from foreglow.types import TrackState
from tests.shared_data import shared_file
from tests.tracking.made_up import detections_of, frame_at, ranges_of

LIMITS_PX = (1279.0, 959.0)


@pytest.fixture(scope="module")
def trace() -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = json.loads(shared_file("reference/golden/tracker_trace.json").read_text())
    return frames


def as_in_trace(obj: PublishedObject | None) -> dict[str, Any] | None:
    if obj is None:
        return None
    return {
        "bbox": pytest.approx(obj.box, abs=1e-9),
        "future": pytest.approx(obj.future_box, abs=1e-9),
        "p": pytest.approx(obj.score, abs=1e-12),
        "vis": obj.num_hits,
        "lost": obj.num_lost,
        "dist": pytest.approx(obj.distance_m, abs=1e-9),
    }


def follow(tracker: PublishedTracker, frame: dict[str, Any]) -> None:
    sightings = [
        Sighting((box[0], box[1], box[2], box[3]), score, distance_m)
        for box, score, distance_m in zip(frame["boxes"], frame["scores"], frame["distances"], strict=True)
    ]
    tracker.follow(sightings, LIMITS_PX, frame["frame"] / 18)


def test_trace_field_by_field(trace: list[dict[str, Any]]) -> None:
    assert len(trace) == 26
    tracker = PublishedTracker(TrackerConfig())
    for frame in trace:
        follow(tracker, frame)
        assert frame["tracks"] == [as_in_trace(obj) for obj in tracker.objects], frame["frame"]
        assert frame["focus"] == as_in_trace(tracker.focus), frame["frame"]


def lights(*rows: tuple[float, float, float, float, float]) -> list[Sighting]:
    return [Sighting((x1, y1, x2, y2), score, None) for x1, y1, x2, y2, score in rows]


def test_a_score_of_a_tenth_is_used() -> None:
    tracker = PublishedTracker(TrackerConfig())
    tracker.follow(lights((10, 10, 30, 30, 0.1), (100, 10, 130, 30, 0.0999)), LIMITS_PX, 0.0)
    assert [obj.box for obj in tracker.objects] == [(10, 10, 30, 30)]


def test_copies_have_ids_of_their_own() -> None:
    """Two detections take the same object: the first keeps its id, and both have its past."""
    tracker = PublishedTracker(TrackerConfig())
    box = (100, 100, 120, 120, 0.9)
    tracker.update(frame_at(0.0), detections_of(box), None)
    tracks = tracker.update(frame_at(1.0), detections_of(box, (102, 101, 122, 121, 0.9)), None)
    assert tracks.ids.tolist() == [0, 1]
    assert tracks.num_hits.tolist() == [2, 2]
    assert tracks.ages_s.tolist() == [1.0, 1.0]
    assert tracks.detections.tolist() == [0, 1]


def test_focus_is_last_of_equals_and_none_while_the_oldest_is_young() -> None:
    tracker = PublishedTracker(TrackerConfig(min_hits=2))
    pair = lights((100, 100, 120, 120, 0.9), (300, 100, 320, 120, 0.9))
    tracker.follow(pair, LIMITS_PX, 0.0)
    assert tracker.focus is None
    tracker.follow(pair, LIMITS_PX, 0.0)
    assert tracker.focus is tracker.objects[1]


def test_an_object_whose_box_collapses_is_gone() -> None:
    """With a gain of 1 the size moves by twice the innovation: from 100 to below 0 px."""
    tracker = PublishedTracker(TrackerConfig(alpha_size=1.0))
    tracker.follow(lights((100, 100, 200, 200, 0.9)), LIMITS_PX, 0.0)
    tracker.follow(lights((135, 135, 165, 165, 0.9)), LIMITS_PX, 0.0)
    assert tracker.objects == ()


def test_a_lost_object_outlives_three_frames() -> None:
    tracker = PublishedTracker(TrackerConfig())
    tracker.follow(lights((100, 100, 120, 120, 0.9)), LIMITS_PX, 0.0)
    alive = []
    for _ in range(4):
        tracker.follow([], LIMITS_PX, 0.0)
        alive.append(len(tracker.objects))
    assert alive == [1, 1, 1, 0]


def test_ranges_without_sigma_and_none_at_zero() -> None:
    tracker = PublishedTracker(TrackerConfig())
    box = (100, 100, 120, 120, 0.9)
    for index, range_m in enumerate((50.0, 10.0)):
        found = detections_of(box)
        tracks = tracker.update(frame_at(index / 18), found, ranges_of(found, [range_m], [5.0]))
    assert tracks.ranges_m[0] == pytest.approx(18.0)
    assert np.isinf(tracks.sigmas_m).all()
    for index in (2, 3):
        tracks = tracker.update(frame_at(index / 18), detections_of(), None)
    assert np.isnan(tracks.ranges_m[0])
    assert tracks.states.tolist() == [TrackState.TENTATIVE]
