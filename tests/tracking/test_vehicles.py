"""Light that moves on to another track stays the same vehicle's, and vehicles are confirmed instead of tracks."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from math import inf, nan

import numpy as np
import pytest

from foreglow.config import OUR_TRACKER, TrackerConfig
from foreglow.tracking.tracker import MAX_TRACKS, AlphaBetaTracker
from foreglow.tracking.vehicles import KEEP_S, MAX_LIGHTS, gaps_between
from foreglow.types import Tracks, TrackState, Vehicles
from tests.tracking.made_up import FRAME_S, detections_of, frame_at, ranges_of

GATE = 1.0
NEUTRAL = OUR_TRACKER.model_copy(update={"neutral_score": 0.38})
"""Scores of .5 are some evidence for light, whatever the preset's network calls neutral."""
OURS = NEUTRAL.model_copy(update={"vehicle_gate": GATE})
ALONE = NEUTRAL.model_copy(update={"vehicle_gate": 0.0})
LAMP = (600, 400, 620, 416, 0.9)
FAR_LAMP = (100, 400, 120, 416, 0.9)

Rows = Sequence[Sequence[float]]


def followed(*frames: Rows, config: TrackerConfig = OURS) -> list[Tracks]:
    tracker = AlphaBetaTracker(config)
    return [tracker.update(frame_at(index * FRAME_S), detections_of(*rows), None) for index, rows in enumerate(frames)]


def vehicles_of(tracks: Tracks) -> Vehicles:
    assert tracks.vehicles is not None
    return tracks.vehicles


def running(score: float, steps: int) -> list[Rows]:
    """Light 40 pixels wide that jumps by 100 pixels in each frame: no two boxes are the same track's."""
    return [[(600 - 100 * step, 500, 640 - 100 * step, 520, score)] for step in range(steps)]


def test_light_that_jumps_stays_the_same_vehicle_and_adds_up() -> None:
    config = OURS.model_copy(update={"vehicle_gate": 2.0})
    assert all((tracks.states == TrackState.TENTATIVE).all() for tracks in followed(*running(0.55, 4), config=ALONE))
    tracks = followed(*running(0.55, 4), config=config)[-1]
    assert len(tracks) > 1
    assert vehicles_of(tracks).ids.tolist() == [0]
    assert vehicles_of(tracks).states.tolist() == [TrackState.CONFIRMED]
    assert tracks.is_plausible.all()


def test_far_light_is_another_vehicle() -> None:
    tracks = followed([LAMP, FAR_LAMP])[-1]
    assert vehicles_of(tracks).of_tracks.tolist() == [0, 1]
    assert vehicles_of(tracks).states.tolist() == [TrackState.CONFIRMED] * 2


@pytest.mark.parametrize("config", [OURS, ALONE])
def test_what_was_plausible_a_moment_ago_is_no_company_to_itself(config: TrackerConfig) -> None:
    """Company makes a second light wait; the vehicle that was confirmed, and doubted for a moment, is the first one."""
    doubt, new = (*LAMP[:4], 0.11), (*FAR_LAMP[:4], 0.9)
    *_, sure, doubted, again = followed([LAMP], [LAMP], *[[doubt]] * 4, [LAMP, new], config=config)
    assert sure.is_plausible.all()
    assert not doubted.is_plausible.any()
    assert again.is_plausible.tolist() == [True, False]


def test_light_that_begins_together_is_one_vehicle_also_through_others() -> None:
    row = [(100 + 30 * place, 400, 120 + 30 * place, 416, 0.9) for place in range(4)]
    assert vehicles_of(followed(row)[-1]).of_tracks.tolist() == [0] * 4


def test_what_speaks_against_light_is_not_plausible_beside_a_vehicle() -> None:
    beside = (630, 400, 650, 416, 0.15)
    tracks = followed(*[[LAMP, beside]] * 5)[-1]
    assert vehicles_of(tracks).of_tracks.tolist() == [0, 0]
    assert tracks.is_plausible.tolist() == [True, False]


def test_a_confirmed_vehicle_is_acted_on_by_its_leading_track_though_no_track_alone_is_sure() -> None:
    """Two lights beside each other, of which one at a time is seen well: each scores .3 on average."""
    frames = [
        [(600, 400, 620, 416, left), (630, 400, 650, 416, right)]
        for left, right in ((0.15, 0.15), (0.5, 0.15), (0.15, 0.5), (0.5, 0.15), (0.15, 0.5))
    ]
    tracks = followed(*frames)[-1]
    assert (tracks.confidences < NEUTRAL.neutral_score).all()
    assert vehicles_of(tracks).states.tolist() == [TrackState.CONFIRMED]
    assert np.flatnonzero(tracks.is_plausible).tolist() == vehicles_of(tracks).leading.tolist()


def test_the_best_score_counts_once_for_a_vehicle() -> None:
    """Ten boxes side by side are no more evidence than one."""
    row = [(100 + 30 * place, 400, 120 + 30 * place, 416, 0.5) for place in range(10)]
    for frames in ([row], [row[:1]]):
        states = [vehicles_of(tracks).states.tolist() for tracks in followed(*frames * 4)]
        assert states == [
            [TrackState.TENTATIVE],
            [TrackState.TENTATIVE],
            [TrackState.CONFIRMED],
            [TrackState.CONFIRMED],
        ]


@pytest.mark.parametrize(("num_missing", "expected"), [(int(KEEP_S / FRAME_S) - 1, 0), (int(KEEP_S / FRAME_S) + 1, 1)])
def test_a_vehicle_is_remembered_for_a_while(num_missing: int, expected: int) -> None:
    config = OURS.model_copy(update={"max_misses": 0})
    tracks = followed([LAMP], *[[]] * num_missing, [LAMP], config=config)[-1]
    assert vehicles_of(tracks).ids.tolist() == [expected]
    assert tracks.ids.tolist() == [1]


def test_a_vehicle_without_a_detection_coasts() -> None:
    tracks = followed([LAMP], [LAMP], [])[-1]
    assert vehicles_of(tracks).states.tolist() == [TrackState.COASTING]
    assert tracks.states.tolist() == [TrackState.COASTING]


LIGHT, LAMP_ITSELF = (0.1, 0.1, 0.6, 0.2), (0.6, 0.2, 0.1, 0.1)


@pytest.mark.parametrize(
    ("ranges_m", "kinds", "leading"),
    [
        ((40.0, 90.0, 60.0), (LIGHT, LIGHT, LIGHT), 1),
        ((40.0, 90.0, 60.0), (LIGHT, LAMP_ITSELF, LAMP_ITSELF), 2),
        ((np.nan, 40.0, np.nan), (LIGHT, LIGHT, LIGHT), 1),
        ((np.nan, 40.0, np.nan), (LIGHT, LIGHT, LAMP_ITSELF), 2),
    ],
)
def test_the_nearest_lamp_or_the_farthest_light_says_where_it_is(
    ranges_m: tuple[float, ...], kinds: tuple[tuple[float, ...], ...], leading: int
) -> None:
    rows = [(100 + 30 * place, 400, 120 + 30 * place, 416, 0.9) for place in range(3)]
    found = detections_of(*rows)
    found = dataclasses.replace(found, light_kinds=np.array(kinds, np.float32))
    sigmas_m = np.where(np.isnan(ranges_m), np.inf, 5.0)
    tracks = AlphaBetaTracker(OURS).update(frame_at(0.0), found, ranges_of(found, ranges_m, sigmas_m.tolist()))
    assert vehicles_of(tracks).leading.tolist() == [leading]
    assert vehicles_of(tracks).is_in_sight.tolist() == [LAMP_ITSELF in kinds]


@pytest.mark.parametrize("config", [TrackerConfig(), ALONE])
def test_without_a_gate_there_are_no_vehicles(config: TrackerConfig) -> None:
    assert followed([LAMP], config=config)[-1].vehicles is None


def test_with_a_tiny_gate_lights_apart_are_confirmed_as_before() -> None:
    frames = [[LAMP, (100, 300, 120, 316, 0.4)], [LAMP], [], [LAMP, FAR_LAMP]]
    for tracks, before in zip(
        followed(*frames, config=OURS.model_copy(update={"vehicle_gate": 1e-6})),
        followed(*frames, config=ALONE),
        strict=True,
    ):
        assert tracks.ids.tolist() == before.ids.tolist()
        assert tracks.states.tolist() == before.states.tolist()


def test_ids_begin_again_after_a_reset_alone() -> None:
    tracker = AlphaBetaTracker(OURS)
    for time_s, expected in ((0.0, 0), (5.0, 1), (1.0, 2)):
        tracks = tracker.update(frame_at(time_s), detections_of(LAMP), None)
        assert vehicles_of(tracks).ids.tolist() == [expected]
    tracker.reset()
    assert vehicles_of(tracker.update(frame_at(9.0), detections_of(LAMP), None)).ids.tolist() == [0]


def test_hundreds_of_boxes_in_each_frame_keep_within_their_memory() -> None:
    tracker, rng = AlphaBetaTracker(OURS), np.random.default_rng(5)
    for index in range(20):
        low = rng.integers(0, (1200, 900), (300, 2))
        rows = np.concatenate([low, low + rng.integers(5, 60, (300, 2)), rng.random((300, 1))], axis=1)
        tracks = tracker.update(frame_at(index * FRAME_S), detections_of(*rows), None)
        assert len(vehicles_of(tracks)) <= len(tracks) <= MAX_TRACKS
        assert tracker._vehicles is not None
        assert len(tracker._vehicles._lights.track_ids) <= MAX_LIGHTS
    for index in range(20, 40):
        tracks = tracker.update(frame_at(index * FRAME_S), detections_of(LAMP), None)
    assert tracks.states[tracks.detections == 0].tolist() == [TrackState.CONFIRMED]


def test_gaps_are_symmetric_and_do_not_depend_on_the_scale() -> None:
    rng = np.random.default_rng(1)
    low = rng.uniform(0, 100, (8, 2))
    boxes = np.concatenate([low, low + rng.uniform(1, 30, (8, 2))], axis=1)
    gaps = gaps_between(boxes, boxes)
    np.testing.assert_allclose(gaps, gaps.T)
    np.testing.assert_allclose(gaps_between(3 * boxes, 3 * boxes), gaps)
    assert (np.diag(gaps) == 0).all()
    assert gaps.max() > 0


@pytest.mark.parametrize("gate", [0.0, GATE])
@pytest.mark.parametrize(("range_m", "num_frames"), [(100.0, 1), (nan, 3), (25.0, inf)])
def test_near_light_needs_more_evidence(gate: float, range_m: float, num_frames: float) -> None:
    config = NEUTRAL.model_copy(update={"vehicle_gate": gate})
    tracker, found = AlphaBetaTracker(config), detections_of((600, 400, 620, 416, 0.5))
    sigma_m = inf if np.isnan(range_m) else 5.0
    needed = next(
        (
            index
            for index in range(1, 20)
            if tracker.update(frame_at(index * FRAME_S), found, ranges_of(found, [range_m], [sigma_m])).is_plausible[0]
        ),
        inf,
    )
    assert needed == num_frames


@pytest.mark.parametrize("config", [OURS, ALONE])
def test_after_a_long_gap_nobody_is_in_company(config: TrackerConfig) -> None:
    """The first vehicle of another scene is confirmed as soon as that of the first one."""
    tracker = AlphaBetaTracker(config)
    found = [
        [
            bool(
                tracker.update(
                    frame_at(begin_s + number * FRAME_S), detections_of((*LAMP[:4], 0.6)), None
                ).is_plausible.any()
            )
            for number in range(20)
        ]
        for begin_s in (0.0, 60.0)
    ]
    assert found[0] == found[1]
    assert found[0][-1]
    assert not found[0][0]
