"""Since when the beam was dark where a vehicle came into sight: cases worked by hand on the drive that ships."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.datasets import PVDN, shipped_drive
from foreglow.lab.evaluation import Predictions
from foreglow.lab.studies.demo.metrics import Story, gap_opened_s, tell_stories

RIGHT, LEFT = np.radians([14.5, 16.5])
"""Around the lamp in image 10054, 3.00 s, which comes into sight at 15.3 degrees."""

SIGHT_ID = 10054


@pytest.fixture(scope="module")
def dataset() -> PVDN:
    return PVDN(shipped_drive())


@pytest.fixture(scope="module")
def story(dataset: PVDN) -> Story:
    (one,) = tell_stories(dataset, Predictions({}, {}), 0.5)
    assert one.sight is not None
    assert one.sight.light.image_id == SIGHT_ID
    return one


def opened_s(dataset: PVDN, story: Story, gaps: dict[int, list[tuple[float, float]]]) -> float:
    return gap_opened_s(dataset, story, {one: np.array(its).reshape(-1, 2) for one, its in gaps.items()})


def test_an_unbroken_gap_counts_from_its_beginning(dataset: PVDN, story: Story) -> None:
    gaps = {one: [(-0.2, -0.1), (RIGHT, LEFT)] for one in range(SIGHT_ID - 6, SIGHT_ID + 1)}
    assert opened_s(dataset, story, gaps) == pytest.approx(3.0 - 6 / 18)
    del gaps[SIGHT_ID - 2]
    assert opened_s(dataset, story, gaps) == pytest.approx(3.0 - 1 / 18)


def test_a_gap_may_move_there(dataset: PVDN, story: Story) -> None:
    gaps = {SIGHT_ID - k: [(RIGHT - 0.02 * k, LEFT - 0.02 * k)] for k in range(4)}
    assert opened_s(dataset, story, gaps) == pytest.approx(3.0 - 3 / 18)


def test_no_gap_or_one_elsewhere(dataset: PVDN, story: Story) -> None:
    assert math.isnan(opened_s(dataset, story, {}))
    assert math.isnan(opened_s(dataset, story, {SIGHT_ID: [(LEFT, LEFT + 0.1)]}))
    assert math.isnan(opened_s(dataset, story, {SIGHT_ID - 1: [(RIGHT, LEFT)]}))
    never = dataclasses.replace(story, sight=None)
    assert math.isnan(opened_s(dataset, never, {SIGHT_ID: [(RIGHT, LEFT)]}))
