"""The paper's rules, scenario by scenario, and what goes beyond them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from math import inf, isnan, nan
from typing import Any, TypeAlias

import numpy as np
import pytest

from foreglow.config import OUR_TRACKER, TrackerConfig
from foreglow.tracking.tracker import AlphaBetaTracker
from foreglow.types import Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.tracking.made_up import FRAME_S, detections_of, frame_at, ranges_of

CONFIRMED, COASTING, TENTATIVE = TrackState.CONFIRMED, TrackState.COASTING, TrackState.TENTATIVE
Rows: TypeAlias = Sequence[Sequence[float]]
LAMP = (600, 480, 620, 496, 0.9)


def paper(**fields: Any) -> AlphaBetaTracker:
    return AlphaBetaTracker(TrackerConfig.model_validate(fields))


def ours(**fields: Any) -> AlphaBetaTracker:
    return AlphaBetaTracker(TrackerConfig.model_validate(OUR_TRACKER.model_dump() | fields))


def moved(box: Sequence[float], dx: float = 0, dy: float = 0, score: float | None = None) -> tuple[float, ...]:
    x1, y1, x2, y2, old = box
    return x1 + dx, y1 + dy, x2 + dx, y2 + dy, old if score is None else score


def run(
    tracker: AlphaBetaTracker,
    frames: Iterable[Rows],
    start_s: float = 0.0,
    step_s: float = FRAME_S,
) -> list[Tracks]:
    """The tracks after each frame, of which each is its boxes with scores."""
    return [
        tracker.update(frame_at(start_s + index * step_s), detections_of(*rows), None)
        for index, rows in enumerate(frames)
    ]


def states(history: Iterable[Tracks]) -> list[list[int]]:
    return [tracks.states.tolist() for tracks in history]


def test_lamps_are_told_from_their_light_by_a_moving_mean() -> None:
    """A miss leaves it, what the model does not say leaves it, and the first that is known begins it."""
    tracker = paper(alpha_confidence=0.25)
    found = []
    for index, direct in enumerate([nan, 0.5, 1.0, None, nan, 0.0]):
        detections = detections_of(*([] if direct is None else [LAMP]))
        if direct is not None:
            detections = dataclasses.replace(detections, light_kinds=kinds_of_direct(np.array([direct], np.float32)))
        found += tracker.update(frame_at(index * FRAME_S), detections, None).direct_probabilities.tolist()
    np.testing.assert_allclose(found, [nan, 0.5, 0.625, 0.625, 0.625, 0.46875])


def test_kinds_are_a_moving_mean_and_the_most_probable_gives_the_name() -> None:
    tracker = paper(alpha_confidence=0.25)
    rear, front = [0.0, 0.75, 0.125, 0.125], [1.0, 0.0, 0.0, 0.0]
    for index, kinds in enumerate([rear, rear, front]):
        detections = dataclasses.replace(detections_of(LAMP), light_kinds=np.array([kinds], np.float32))
        tracks = tracker.update(frame_at(index * FRAME_S), detections, None)
    np.testing.assert_allclose(tracks.light_kinds, [[0.25, 0.5625, 0.09375, 0.09375]])
    np.testing.assert_allclose(tracks.direct_probabilities, [0.8125])
    assert tracks.kind_names == ("rear_lamp",)
    assert tracker.update(frame_at(3 * FRAME_S), detections_of(), None).kind_names == ("rear_lamp",)


def test_a_rate_of_turn_that_no_car_has_moves_no_track() -> None:
    tracks = []
    for rate_radps in (0.0, 50.0, 1e300):
        tracker = ours()
        for index in range(3):
            seen = tracker.update(frame_at(index * FRAME_S, yaw_rate_radps=rate_radps), detections_of(LAMP), None)
        tracks.append(seen.boxes_xyxy_px)
    np.testing.assert_array_equal(tracks[0], tracks[1])
    np.testing.assert_array_equal(tracks[0], tracks[2])


class TestPaper:
    def test_fifth_detection_confirms(self) -> None:
        history = run(paper(), [[LAMP]] * 6)
        assert states(history) == [[TENTATIVE]] * 4 + [[CONFIRMED]] * 2
        assert [tracks.num_hits.tolist() for tracks in history] == [[1], [2], [3], [4], [5], [6]]

    def test_confidence_must_exceed_a_half(self) -> None:
        assert states(run(paper(), [[moved(LAMP, score=0.5)]] * 9)) == [[TENTATIVE]] * 9

    def test_detections_must_exceed_a_tenth(self) -> None:
        assert len(run(paper(min_score=0.125), [[moved(LAMP, score=0.125)]])[0]) == 0
        assert len(run(paper(min_score=0.125), [[moved(LAMP, score=0.126)]])[0]) == 1

    def test_confidence_is_a_moving_mean(self) -> None:
        history = run(paper(), [[moved(LAMP, score=score)] for score in (0.9, 0.4, 0.7)])
        expected = (0.9 * 0.67 + 0.4 * 0.33) * 0.67 + 0.7 * 0.33
        assert history[-1].confidences[0] == pytest.approx(expected, abs=1e-6)

    def test_three_frames_of_occlusion(self) -> None:
        history = run(paper(), [[LAMP]] * 5 + [[]] * 4)
        assert states(history)[4:] == [[CONFIRMED], [COASTING], [COASTING], [COASTING], []]
        assert [tracks.num_misses.tolist() for tracks in history[5:]] == [[1], [2], [3], []]
        assert history[5].detections.tolist() == [-1]

    def test_after_three_frames_it_is_the_same_track(self) -> None:
        history = run(paper(), [[LAMP]] * 5 + [[]] * 3 + [[LAMP]])
        assert history[-1].ids.tolist() == [0]
        assert history[-1].num_misses.tolist() == [0]
        assert history[-1].ages_s[0] == pytest.approx(8 * FRAME_S)

    def test_enlarged_boxes_meet_where_plain_ones_do_not(self) -> None:
        """A box of 20 px that jumps by 18 px: enlarged to 30 px it overlaps the track by 7, an IoU of 0.12."""
        frames: list[Rows] = [[LAMP], [moved(LAMP, dx=18)]]
        assert run(paper(), frames)[-1].ids.tolist() == [0]
        assert run(paper(enlargement=1.0), frames)[-1].ids.tolist() == [0, 1]
        assert run(paper(min_iou=0.13), frames)[-1].ids.tolist() == [0, 1]

    def test_only_detections_are_enlarged(self) -> None:
        """A box of 20 px that jumps by 21 px: 0.07 if it alone is enlarged, 0.18 if the track is as well."""
        frames: list[Rows] = [[LAMP], [moved(LAMP, dx=21)]]
        assert run(paper(), frames)[-1].ids.tolist() == [0, 1]
        assert run(paper(enlarge_tracks=True), frames)[-1].ids.tolist() == [0]

    def test_first_correction_by_hand(self) -> None:
        """Centre by half of the innovation, size by 0.3; the rate's share shows in the next prediction."""
        history = run(paper(), [[(600, 480, 620, 496, 0.9)], [(606, 480, 636, 500, 0.9)], []])
        x1, y1, x2, y2 = history[1].boxes_xyxy_px[0]
        assert ((x1 + x2) / 2, (y1 + y2) / 2) == pytest.approx((610 + 0.5 * 11, 488 + 0.5 * 2))
        assert (x2 - x1, y2 - y1) == pytest.approx((20 + 0.3 * 10, 16 + 0.3 * 4))
        x1, _, x2, _ = history[2].boxes_xyxy_px[0]
        assert (x1 + x2) / 2 == pytest.approx(615.5 + 0.25 / 1.5 * 11)

    def test_range_is_filtered(self) -> None:
        tracker = paper()
        for index, range_m in enumerate((90.0, 80.0)):
            found = detections_of(LAMP)
            tracks = tracker.update(frame_at(index * FRAME_S), found, ranges_of(found, [range_m], [9.0]))
        assert tracks.ranges_m[0] == pytest.approx(90 - 0.8 * 10)
        assert tracks.sigmas_m[0] >= 9.0

    @pytest.mark.parametrize("association", ["greatest_iou", "optimal"])
    def test_crossing_lights_keep_their_ids(self, association: str) -> None:
        frames = [
            [(300 + 6 * k, 400, 320 + 6 * k, 420, 0.9), (600 - 6 * k, 404, 620 - 6 * k, 424, 0.9)] for k in range(50)
        ]
        last = run(paper(association=association), frames)[-1]
        assert last.ids.tolist() == [0, 1]
        assert last.detections.tolist() == [0, 1]

    @pytest.mark.parametrize("association", ["greatest_iou", "optimal"])
    def test_two_close_boxes_are_two_tracks(self, association: str) -> None:
        frames = [[moved(LAMP, dx=2 * k), moved(LAMP, dx=22 + 2 * k)] for k in range(8)]
        history = run(paper(association=association), frames)
        assert [tracks.ids.tolist() for tracks in history] == [[0, 1]] * 8
        assert [tracks.detections.tolist() for tracks in history] == [[0, 1]] * 8


class TestTime:
    def test_half_the_frames_halve_the_misses(self) -> None:
        """At 9 frames a second, three frames of 18 are over with the second miss."""
        frames: list[Rows] = [*[[LAMP]] * 5, *[[]] * 4]
        alive = [len(tracks) for tracks in run(ours(max_misses=3), frames, step_s=2 * FRAME_S)[5:]]
        assert alive == [1, 0, 0, 0]
        counted = [len(tracks) for tracks in run(ours(max_misses=3, clock="frames"), frames, step_s=2 * FRAME_S)[5:]]
        assert counted == [1, 1, 1, 0]

    def test_frames_that_come_late_do_not_end_a_track_early(self) -> None:
        frames: list[Rows] = [*[[LAMP]] * 5, *[[]] * 3]
        assert len(run(ours(max_misses=3), frames, step_s=1.1 * FRAME_S)[-1]) == 1

    def test_a_gap_ends_no_track_and_confirms_none(self) -> None:
        tracker = ours()
        run(tracker, [[moved(LAMP, score=0.4)]] * 2)
        for detections in (detections_of(), detections_of(moved(LAMP, score=0.4))):
            tracks = tracker.update(frame_at(0.9 if len(detections) == 0 else 0.95), detections, None)
            assert tracks.ids.tolist() == [0]
            assert tracks.states.tolist() == [TENTATIVE]

    def test_a_long_gap_ends_all(self) -> None:
        tracker = ours()
        run(tracker, [[LAMP]] * 5)
        tracks = tracker.update(frame_at(4 * FRAME_S + 1.01), detections_of(LAMP), None)
        assert tracks.ids.tolist() == [1]
        assert tracks.states.tolist() == [TENTATIVE]

    def test_speed_is_per_second(self) -> None:
        """A light of 180 px/s is predicted through a dropped frame; counted in frames, the box is left behind."""
        times = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 12]
        for tracker, expected in ((ours(enlargement=1.0), [0]), (ours(enlargement=1.0, clock="frames"), [0, 1])):
            for time in times:
                tracks = tracker.update(frame_at(time * FRAME_S), detections_of(moved(LAMP, dx=10 * time)), None)
            assert tracks.ids.tolist() == expected

    def test_time_that_goes_back_begins_anew(self) -> None:
        tracker = ours()
        run(tracker, [[LAMP]] * 5, start_s=10.0)
        assert tracker.update(frame_at(9.0), detections_of(LAMP), None).ids.tolist() == [1]
        assert tracker.update(frame_at(9.0 + FRAME_S), detections_of(LAMP), None).num_hits.tolist() == [2]

    def test_the_same_frame_again_teaches_nothing(self) -> None:
        tracker = ours()
        (*_, last) = run(tracker, [[LAMP]] * 3)
        again = tracker.update(frame_at(2 * FRAME_S), detections_of(LAMP), None)
        assert again is last
        changed = tracker.update(frame_at(2 * FRAME_S), detections_of(moved(LAMP, dx=1)), None)
        assert changed.ids.tolist() == [1]

    def test_the_clock_of_frames_reads_no_time(self) -> None:
        tracker = paper()
        for _ in range(5):
            tracks = tracker.update(frame_at(0.0), detections_of(LAMP), None)
        assert tracks.states.tolist() == [CONFIRMED]
        assert tracks.ages_s[0] == pytest.approx(4 * FRAME_S)


class TestRanges:
    @staticmethod
    def run(tracker: AlphaBetaTracker, ranges_m: Sequence[float], sigma_m: float = 9.0) -> Tracks:
        for index, range_m in enumerate(ranges_m):
            found = detections_of(LAMP)
            sigmas_m = [inf if isnan(range_m) else sigma_m]
            tracks = tracker.update(frame_at(index * FRAME_S), found, ranges_of(found, [range_m], sigmas_m))
        return tracks

    def test_unknown_ranges(self) -> None:
        for kind in ("alpha_beta", "mean", "median"):
            tracks = self.run(paper(range_filter=kind), [nan, nan])
            assert np.isnan(tracks.ranges_m[0])
            assert tracks.sigmas_m[0] == inf
            assert self.run(paper(range_filter=kind), [nan, 70.0, nan]).ranges_m[0] == pytest.approx(70.0)

    def test_average_of_the_last_five(self) -> None:
        ranges_m = [500.0, 90.0, 10.0, nan, 80.0, 60.0, 50.0]
        assert self.run(paper(range_filter="mean"), ranges_m).ranges_m[0] == pytest.approx(58.0)
        assert self.run(paper(range_filter="median"), ranges_m).ranges_m[0] == pytest.approx(60.0)

    def test_sigma_grows_while_nothing_is_measured(self) -> None:
        for kind in ("alpha_beta", "mean", "median"):
            sigmas = [self.run(paper(range_filter=kind), [70.0, *[nan] * count]).sigmas_m[0] for count in range(4)]
            np.testing.assert_allclose(np.diff(sigmas), 10.0 * FRAME_S)

    def test_a_range_that_runs_below_zero_is_unknown(self) -> None:
        tracks = self.run(paper(), [30.0, 20.0, 10.0, 2.0, *[nan] * 3])
        assert np.isnan(tracks.ranges_m[0])
        assert tracks.sigmas_m[0] == inf

    def test_gate_keeps_near_and_far_apart(self) -> None:
        """The light at 40 m goes out, and another at 200 m shows at the same place."""
        for gate, expected in ((3.0, [0, 1]), (inf, [0])):
            tracker = ours(range_gate=gate)
            for index, range_m in enumerate((40.0, 40.0, 200.0)):
                found = detections_of(LAMP)
                tracks = tracker.update(frame_at(index * FRAME_S), found, ranges_of(found, [range_m], [8.0]))
            assert tracks.ids.tolist() == expected


class TestBoxes:
    def test_a_track_that_leaves_the_image_ends(self) -> None:
        frames: list[Rows] = [[moved((1200, 400, 1220, 420, 0.9), dx=9 * k)] for k in range(7)]
        last = run(ours(), [*frames, []])[-1]
        assert len(last) == 1
        assert len(run(ours(), [*frames, [], [], []])[-1]) == 0

    def test_a_box_that_shrinks_stays_a_box(self) -> None:
        frames: list[Rows] = [[(600 + k, 400 + k, 640 - k, 440 - k, 0.9)] for k in (0, 5, 10, 15, 19)]
        for tracks in run(ours(), frames + [[]] * 6):
            assert (tracks.boxes_xyxy_px[:, 2:] - tracks.boxes_xyxy_px[:, :2] >= 1.0 - 1e-9).all()

    def test_one_track_an_object(self) -> None:
        """A light is lost by a jump and found again beside its old track, which coasts into the new one."""
        frames: list[Rows] = [[LAMP]] * 5 + [[moved(LAMP, dx=14)]]
        assert run(paper(min_iou=0.5, enlargement=1.0), frames)[-1].ids.tolist() == [0, 1]
        assert run(paper(min_iou=0.5, enlargement=1.0, merge_iou=0.1), frames)[-1].ids.tolist() == [0]

    def test_a_turn_is_compensated(self) -> None:
        """We begin to turn at 0.3 rad/s: the image jumps by 23 px a frame."""
        for compensate, expected in ((True, [0]), (False, [0, 1])):
            tracker = ours(compensate_yaw=compensate, enlargement=1.0)
            run(tracker, [[LAMP]] * 5)
            turned = detections_of(moved(LAMP, dx=23))
            tracks = tracker.update(frame_at(5 * FRAME_S, yaw_rate_radps=0.3), turned, None)
            assert tracks.ids.tolist() == expected
