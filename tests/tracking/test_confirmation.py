"""When tracks become plausible, rule by rule."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.config import TrackerConfig
from foreglow.tracking.alpha_beta import moving_mean
from foreglow.tracking.confirmation import (
    CONFIRMATIONS,
    MAX_EVIDENCE,
    MAX_SCORE_EVIDENCE,
    NEUTRAL_RANGE_M,
    RANGES_M,
    Company,
    Observations,
    scores_with_ranges,
)


def history(config: TrackerConfig, scores: Sequence[float]) -> list[bool]:
    """Whether a track is plausible after each of its `scores`, NaN for a miss."""
    return [bool(plausible) for plausible, _ in outcomes(config, scores)]


def outcomes(
    config: TrackerConfig, scores: Sequence[float], since_others_s: float = inf
) -> list[tuple[bool, np.ndarray]]:
    rule = CONFIRMATIONS[config.confirmation](config)
    memory, plausible = np.zeros((1, rule.memory_size)), np.zeros(1, np.bool_)
    confidences, num_hits = np.array([nan]), np.zeros(1, np.int64)
    outcome = []
    for score in scores:
        newest = np.array([score])
        num_hits = num_hits + ~np.isnan(newest)
        confidences = moving_mean(confidences, newest, config.alpha_confidence)
        memory, plausible = rule.update(
            memory, Observations(newest, num_hits, confidences, plausible, np.array([since_others_s]))
        )
        assert memory.shape == (1, rule.memory_size)
        assert plausible.dtype == np.bool_
        outcome.append((bool(plausible[0]), memory))
    return outcome


class TestFrames:
    config = TrackerConfig()

    def test_fifth_detection(self) -> None:
        assert history(self.config, [0.9] * 6) == [False] * 4 + [True] * 2

    def test_a_miss_does_not_undo_detections(self) -> None:
        assert history(self.config, [0.9, 0.9, nan, 0.9, nan, 0.9, 0.9]) == [False] * 6 + [True]

    def test_confidence_must_be_above(self) -> None:
        assert history(self.config, [0.5] * 9) == [False] * 9
        assert history(self.config, [0.51] * 5)[-1]

    def test_is_undone_by_low_scores(self) -> None:
        assert history(self.config, [0.9] * 5 + [0.1] * 2) == [False] * 4 + [True] * 2 + [False]


class TestMOfN:
    config = TrackerConfig(confirmation="m_of_n", min_hits=3, num_looks=4, min_confidence=0.5)

    @pytest.mark.parametrize(
        ("scores", "first"),
        [
            ([0.9, 0.9, 0.9], 2),
            ([0.9, nan, 0.9, 0.9], 3),
            ([0.9, nan, nan, 0.9, 0.9], None),
            ([0.9, nan, nan, 0.9, 0.9, 0.9], 5),
            ([0.4, 0.4, 0.4, 0.4], None),
        ],
    )
    def test_detections_among_the_last_looks(self, scores: list[float], first: int | None) -> None:
        outcome = history(self.config, scores)
        assert (outcome.index(True) if any(outcome) else None) == first

    def test_stays(self) -> None:
        assert history(self.config, [0.9] * 3 + [0.1] * 4 + [nan] * 3)[-1]


class TestEvidence:
    @staticmethod
    def config(**fields: float) -> TrackerConfig:
        """Round numbers, but for `fields`."""
        rounded = {"neutral_score": 0.5, "detection_probability": 0.5, "confirm_evidence": 3.0, "company_evidence": 2.0}
        return TrackerConfig.model_validate({"confirmation": "evidence"} | rounded | fields)

    def test_sum_of_log_odds_by_hand(self) -> None:
        outcome = outcomes(self.config(neutral_score=0.2, detection_probability=0.75), [0.8, nan, 0.5])
        expected = [2 * log(4), log(4), 2 * log(4)]
        assert [memory[0, 0] for _, memory in outcome] == pytest.approx(expected)

    def test_sure_scores_confirm_sooner(self) -> None:
        assert history(self.config(), [0.9] * 3) == [False, True, True]
        assert history(self.config(), [0.7] * 5) == [False] * 3 + [True] * 2
        assert not any(history(self.config(), [0.5] * 40))

    def test_the_threshold_itself_is_not_enough(self) -> None:
        assert not history(self.config(confirm_evidence=log(4) + 1e-9), [0.8])[0]
        assert history(self.config(confirm_evidence=log(4) - 1e-9), [0.8])[0]

    def test_evidence_against_does_not_pile_up(self) -> None:
        assert outcomes(self.config(), [0.1, nan, 0.1])[-1][1][0, 0] == 0.0
        assert history(self.config(), [0.1, 0.1, 0.1, 0.9, 0.9])[-1]

    def test_plausible_until_nothing_is_left(self) -> None:
        assert history(self.config(), [0.9, 0.9, 0.1, 0.15, 0.3, 0.9]) == [False] + [True] * 3 + [False] * 2

    def test_plausible_down_to_the_lower_level(self) -> None:
        config = self.config(reject_evidence=2.0)
        assert history(config, [0.9, 0.9, 0.2, 0.5, 0.2, 0.9]) == [False, True, True, True, False, True]

    def test_a_second_track_needs_more(self) -> None:
        config = self.config(company_s=2.0)
        first, second = (
            [is_plausible for is_plausible, _ in outcomes(config, [0.9] * 4, since_s)] for since_s in (2.01, 2.0)
        )
        assert first == [False, True, True, True]  # 4.4 of 3
        assert second == [False, False, True, True]  # 6.6 of 5

    def test_a_second_track_takes_nothing_back(self) -> None:
        rule = CONFIRMATIONS["evidence"](self.config())
        observed = Observations(np.array([0.5]), np.array([9]), np.array([0.5]), np.array([True]), np.array([0.05]))
        assert rule.update(np.array([[3.5]]), observed)[1].tolist() == [True]

    def test_no_score_is_certain(self) -> None:
        assert outcomes(self.config(), [1.0])[0][1][0, 0] == MAX_SCORE_EVIDENCE
        assert outcomes(self.config(), [1.0] * 9)[-1][1][0, 0] == MAX_EVIDENCE
        assert outcomes(self.config(), [1.0, 0.0, 0.0, 1.0])[-1][1][0, 0] == MAX_SCORE_EVIDENCE

    @given(st.lists(st.floats(0, 1) | st.just(nan), min_size=1, max_size=12), st.floats(0, 1))
    def test_a_higher_score_never_confirms_later(self, scores: list[float], raised: float) -> None:
        config = self.config()
        better = [max(score, raised) if score == score else score for score in scores]
        for plain, more in zip(history(config, [0.5, *scores]), history(config, [0.5, *better]), strict=True):
            assert more >= plain


@pytest.mark.parametrize("rule", CONFIRMATIONS)
def test_tracks_do_not_know_of_each_other(rule: str) -> None:
    config = TrackerConfig.model_validate({"confirmation": rule})
    made = CONFIRMATIONS[rule](config)
    rng = np.random.default_rng(3)
    memory = rng.integers(0, 2, (6, made.memory_size)).astype(np.float64)
    observed = Observations(
        np.where(rng.random(6) < 0.3, nan, rng.random(6)),
        rng.integers(1, 9, 6),
        rng.random(6),
        rng.random(6) < 0.5,
        4 * rng.random(6),
    )
    together = made.update(memory, observed)
    for track in range(6):
        row = slice(track, track + 1)
        names = ("scores", "num_hits", "confidences", "was_plausible", "since_others_s")
        alone = Observations(**{name: getattr(observed, name)[row] for name in names})
        own_memory, own_plausible = made.update(memory[row], alone)
        np.testing.assert_array_equal(own_memory[0], together[0][track])
        assert own_plausible[0] == together[1][track]


@pytest.mark.parametrize("rule", CONFIRMATIONS)
def test_no_tracks(rule: str) -> None:
    made = CONFIRMATIONS[rule](TrackerConfig.model_validate({"confirmation": rule}))
    none = np.zeros(0)
    observed = Observations(none, none.astype(np.int64), none, none.astype(np.bool_), none)
    memory, plausible = made.update(np.zeros((0, made.memory_size)), observed)
    assert memory.shape == (0, made.memory_size)
    assert plausible.shape == (0,)


class TestRanges:
    @given(st.floats(0, 1), st.floats(0.1, 1000), st.floats(0, 10))
    def test_a_score_stays_one_and_far_light_has_the_greater(self, score: float, range_m: float, weight: float) -> None:
        near, far = scores_with_ranges(np.full(2, score), np.array([range_m, 1.5 * range_m]), weight)
        assert 0.0 <= near <= far + 1e-12
        assert far <= 1.0

    @given(st.floats(0, 1), st.floats(0, 10))
    def test_without_a_range_or_at_the_neutral_one_nothing_changes(self, score: float, weight: float) -> None:
        changed = scores_with_ranges(np.full(2, score), np.array([nan, NEUTRAL_RANGE_M]), weight)
        np.testing.assert_allclose(changed, score, atol=1e-12)

    def test_what_is_certain_stays_so(self) -> None:
        ranges_m = np.linspace(5.0, 200.0, 1000)
        np.testing.assert_array_equal(scores_with_ranges(np.ones(1000), ranges_m, 2.0), 1.0)
        np.testing.assert_array_equal(scores_with_ranges(np.zeros(1000), ranges_m, 2.0), 0.0)

    def test_ranges_beyond_the_limits_count_as_these(self) -> None:
        at_limits = scores_with_ranges(np.full(2, 0.4), np.array(RANGES_M), 2.0)
        np.testing.assert_array_equal(scores_with_ranges(np.full(2, 0.4), np.array([1.0, 1e6]), 2.0), at_limits)
        assert at_limits[0] < 0.4 < at_limits[1]


def test_company_is_any_other_that_was_plausible() -> None:
    company, ids = Company(), np.array([3, 5, 7])
    assert company.since_others_s(ids, 1.0).tolist() == [inf] * 3
    company.note(np.array([5]), 1.0)
    assert company.since_others_s(ids, 2.0).tolist() == [1.0, inf, 1.0]
    company.note(np.array([5]), 2.0)
    assert company.since_others_s(ids, 4.0).tolist() == [2.0, inf, 2.0]
    company.note(np.array([7]), 4.0)
    assert company.since_others_s(ids, 5.0).tolist() == [1.0, 1.0, 3.0]
    company.note(np.array([3, 5, 7]), 6.0)
    company.note(np.array([], np.int64), 7.0)
    assert company.since_others_s(ids, 8.0).tolist() == [2.0] * 3
