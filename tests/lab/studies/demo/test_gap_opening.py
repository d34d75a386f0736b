"""Since when the beam was dark where a vehicle came into sight: cases worked by hand on the drive that ships."""

from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.datasets import PVDN, shipped_drive
from foreglow.lab.evaluation import Predictions
from foreglow.lab.studies.demo.metrics import Moment, gap_at_sight, tell_stories

RIGHT, LEFT = np.radians([14.5, 16.5])
"""Around the lamp in image 10054, 3.00 s, which comes into sight at 15.3 degrees, 124 m from the camera: seen from the
rear axle, 2.1 m behind it, at 15.1 degrees."""

SIGHT_ID = 10054


@pytest.fixture(scope="module")
def dataset() -> PVDN:
    return PVDN(shipped_drive())


@pytest.fixture(scope="module")
def sight(dataset: PVDN) -> Moment:
    (story,) = tell_stories(dataset, Predictions({}, {}), 0.5)
    assert story.sight is not None
    assert story.sight.light.image_id == SIGHT_ID
    return story.sight


def opened_s(dataset: PVDN, sight: Moment, gaps: dict[int, list[tuple[float, float]]]) -> float:
    found = gap_at_sight(dataset, sight, {each: np.array(its).reshape(-1, 2) for each, its in gaps.items()})
    assert found is not None
    return min(found, default=math.nan)


def test_an_unbroken_gap_counts_from_its_beginning(dataset: PVDN, sight: Moment) -> None:
    gaps = {each: [(-0.2, -0.1), (RIGHT, LEFT)] for each in range(SIGHT_ID - 6, SIGHT_ID + 1)}
    assert opened_s(dataset, sight, gaps) == pytest.approx(3.0 - 6 / 18)
    del gaps[SIGHT_ID - 2]
    assert opened_s(dataset, sight, gaps) == pytest.approx(3.0 - 1 / 18)


def test_a_gap_may_move_there(dataset: PVDN, sight: Moment) -> None:
    gaps = {SIGHT_ID - k: [(RIGHT - 0.02 * k, LEFT - 0.02 * k)] for k in range(4)}
    assert opened_s(dataset, sight, gaps) == pytest.approx(3.0 - 3 / 18)


def test_no_gap_or_one_elsewhere(dataset: PVDN, sight: Moment) -> None:
    assert math.isnan(opened_s(dataset, sight, {}))
    assert math.isnan(opened_s(dataset, sight, {SIGHT_ID: [(LEFT, LEFT + 0.1)]}))
    assert math.isnan(opened_s(dataset, sight, {SIGHT_ID - 1: [(RIGHT, LEFT)]}))


def test_the_lamp_is_where_it_is_from_the_rear_axle(dataset: PVDN, sight: Moment) -> None:
    """Gaps are azimuths there; from the camera, a vehicle aside looks further aside."""
    for right_deg, left_deg, is_there in ((15.0, 15.2, True), (15.2, 15.5, False)):
        found_s = opened_s(dataset, sight, {SIGHT_ID: [(math.radians(right_deg), math.radians(left_deg))]})
        assert math.isnan(found_s) != is_there


def test_a_story_with_a_beam_knows_its_gap(dataset: PVDN) -> None:
    gaps_rad = {SIGHT_ID - k: np.array([[RIGHT, LEFT]]) for k in range(3)}
    (story,) = tell_stories(dataset, Predictions({}, {}), 0.5, gaps_rad=gaps_rad)
    assert story.gap_s == pytest.approx(3.0 - 2 / 18)
    assert story.moments["dimmed"].light.image_id == SIGHT_ID - 2
    (without,) = tell_stories(dataset, Predictions({}, {}), 0.5, gaps_rad={})
    assert without.gaps_rad == {}
    assert "dimmed" not in without.moments
