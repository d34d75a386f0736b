"""The published code's tracker: its trace, and each of its quirks."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from foreglow.config import TrackerConfig
from foreglow.tracking.published import PublishedObject, PublishedTracker, Sighting
from foreglow.types import Ranges, TrackState
from tests.shared_data import shared_file
from tests.tracking.made_up import detections_of, frame_at

LIMITS_PX = (1279.0, 959.0)


@pytest.fixture(scope="module")
def trace() -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = json.loads(shared_file("reference/golden/tracker_trace.json").read_text())
    return frames


def as_in_trace(one: PublishedObject | None) -> dict[str, Any] | None:
    if one is None:
        return None
    return {
        "bbox": pytest.approx(one.box, abs=1e-9),
        "future": pytest.approx(one.future_box, abs=1e-9),
        "p": pytest.approx(one.score, abs=1e-12),
        "vis": one.num_hits,
        "lost": one.num_lost,
        "dist": pytest.approx(one.distance_m, abs=1e-9),
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
        assert frame["tracks"] == [as_in_trace(one) for one in tracker.objects], frame["frame"]
        assert frame["focus"] == as_in_trace(tracker.focus), frame["frame"]
