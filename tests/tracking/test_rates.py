"""A camera of another rate sees the same drive: what the tracker makes of it is the same, at the same time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.config import OUR_TRACKER
from foreglow.tracking.tracker import AlphaBetaTracker
from foreglow.types import Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.tracking.made_up import FRAME_S, detections_of, frame_at

FASTER_HZ = [30.0, 36.0, 60.0]


def run(rate_hz: float, *, score: float = 0.86, seconds: float = 2.0) -> list[Tracks]:
    """One light in each frame; from half of the time on it is called a lamp."""
    tracker, found = AlphaBetaTracker(OUR_TRACKER), []
    for number in range(round(seconds * rate_hz)):
        time_s = number / rate_hz
        detections = detections_of((600, 480, 640, 512, score))
        is_lamp = np.array([float(time_s > 0.5 * seconds)], np.float32)
        detections = dataclasses.replace(detections, light_kinds=kinds_of_direct(is_lamp))
        found.append(tracker.update(frame_at(time_s), detections, None))
    return found


def first_s(tracks: list[Tracks], rate_hz: float, minimum: float | None = None) -> float:
    """When the first track is confirmed, or its probability of being a lamp is above `minimum`."""
    for number, each in enumerate(tracks):
        is_confirmed = each.states[0] == TrackState.CONFIRMED
        if is_confirmed if minimum is None else each.direct_probabilities[0] > minimum:
            return number / rate_hz
    raise AssertionError("never")


@pytest.mark.parametrize("score", [0.83, 0.86])
@pytest.mark.parametrize("rate_hz", FASTER_HZ)
def test_faster_cameras_confirm_no_sooner(rate_hz: float, score: float) -> None:
    """Frames that follow each other so soon are hardly independent evidence."""
    expected_s = first_s(run(18.0, score=score), 18.0)
    assert abs(first_s(run(rate_hz, score=score), rate_hz) - expected_s) <= FRAME_S


def test_slower_cameras_need_no_more_frames() -> None:
    expected = first_s(run(18.0), 18.0) * 18.0
    assert first_s(run(4.0), 4.0) * 4.0 == pytest.approx(expected)


@pytest.mark.parametrize("rate_hz", FASTER_HZ)
def test_means_follow_as_fast_by_time(rate_hz: float) -> None:
    expected_s = first_s(run(18.0), 18.0, 0.8)
    assert abs(first_s(run(rate_hz), rate_hz, 0.8) - expected_s) <= FRAME_S


@pytest.mark.parametrize("rate_hz", FASTER_HZ)
def test_where_a_light_will_be_is_known_no_worse(rate_hz: float) -> None:
    """The noise of boxes is that of frames: at higher rates, differences from frame to frame say less of the speed."""

    def spread_px(hz: float) -> float:
        """Of the place after 0.2 s without a detection."""
        rng, places_px = np.random.default_rng(3), []
        for _ in range(40):
            tracker = AlphaBetaTracker(OUR_TRACKER)
            for number in range(round(hz)):
                x1 = 600.0 + 20.0 * rng.standard_normal()
                tracks = tracker.update(frame_at(number / hz), detections_of((x1, 480, x1 + 80, 560, 0.9)), None)
            for number in range(round(hz), round(1.2 * hz)):
                tracks = tracker.update(frame_at(number / hz), detections_of(), None)
            places_px.append(tracks.boxes_xyxy_px[0, 0])
        return float(np.std(places_px))

    assert spread_px(rate_hz) < 1.3 * spread_px(18.0)
