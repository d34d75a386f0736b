"""What a search minimises, worked by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.lab.evaluation import Predictions, evaluate_boxes
from foreglow.lab.learning.tuning import TuningSettings
from foreglow.lab.learning.tuning.measurement import Measurement
from foreglow.lab.learning.tuning.objectives import (
    OBJECTIVES,
    PAPER,
    SPACES,
    light_loss,
    q_loss,
    q_only_loss,
    shortfalls,
)

EMPTY = evaluate_boxes({1: np.empty((0, 2))}, Predictions({}, {}))


def measured(
    q: float = 0.8, lamps: float = 0.99, strongest: float = 0.75, hidden: float = 0.9, boxes: int = 90
) -> Measurement:
    quality = dataclasses.replace(EMPTY, q=q, recall=0.5, fp=boxes)
    return Measurement(10, boxes, quality, lamps, strongest, hidden)


REFERENCE = measured(q=0.7, boxes=100)


def test_q_only() -> None:
    assert q_only_loss(measured(q=0.8), REFERENCE) == pytest.approx(0.2)
    assert q_only_loss(measured(q=math.nan), REFERENCE) == 1.0


def test_q_without_losing_recall_or_adding_false_boxes() -> None:
    assert q_loss(REFERENCE, REFERENCE) == pytest.approx(0.3)
    assert q_loss(measured(q=0.8), REFERENCE) == pytest.approx(0.2)
    assert q_loss(measured(q=0.8, boxes=125), REFERENCE) == pytest.approx(0.2 + 0.25)
    assert q_loss(measured(q=0.8, boxes=80), REFERENCE) == pytest.approx(0.2)
    misses = measured(q=0.8)
    misses = dataclasses.replace(misses, quality=dataclasses.replace(misses.quality, recall=0.1))
    assert q_loss(misses, REFERENCE) == pytest.approx(0.2 + 0.4)
    nothing = dataclasses.replace(measured(q=math.nan, boxes=0), quality=dataclasses.replace(EMPTY, recall=0.0))
    assert q_loss(nothing, REFERENCE) == pytest.approx(1.0 + 0.5)
    assert q_loss(dataclasses.replace(nothing, quality=EMPTY), REFERENCE) == 1.0  # no key point, so none missed


def test_nothing_is_missed() -> None:
    assert set(shortfalls(measured(), REFERENCE).values()) == {0.0}
    assert light_loss(measured(), REFERENCE) == pytest.approx(1 - (0.99 + 0.75 + 0.9 + 0.8) / 4)


@pytest.mark.parametrize(
    ("found", "name", "missed"),
    [
        (measured(lamps=0.93), "recall_lamps", 0.05),
        (measured(strongest=0.5), "recall_strongest", 0.23),
        (measured(hidden=0.85), "recall_hidden", 0.05),
        (measured(q=0.7), "q", 0.01),
        (measured(boxes=120), "boxes_per_image", 0.21),
    ],
)
def test_each_requirement(found: Measurement, name: str, missed: float) -> None:
    others = {key: value for key, value in shortfalls(found, REFERENCE).items() if key != name}
    assert shortfalls(found, REFERENCE)[name] == pytest.approx(missed)
    assert set(others.values()) == {0.0}
    assert light_loss(found, REFERENCE) > light_loss(measured(), REFERENCE)


def test_met_requirements_come_before_a_better_mean() -> None:
    perfect_but_many = measured(1.0, 1.0, 1.0, 1.0, boxes=115)
    assert light_loss(measured(), REFERENCE) < light_loss(perfect_but_many, REFERENCE)


def test_undefined_figures_count_as_met() -> None:
    assert light_loss(measured(hidden=math.nan), REFERENCE) == pytest.approx(1 - (0.99 + 0.75 + 0.8) / 3)
    nothing = measured(math.nan, 0.0, 0.0, 0.0, boxes=0)
    assert light_loss(nothing, REFERENCE) == pytest.approx(10 * (0.98 + 0.73 + 0.90 + 0.71) + 1)


def test_tables_list_what_they_know() -> None:
    with pytest.raises(ValueError, match="objective: expected one of q, q-only, light, got 'f'"):
        TuningSettings(objective="f")
    with pytest.raises(ValueError, match="space: expected one of paper, wide, got 'small'"):
        TuningSettings(space="small")
    assert {space for _, space in OBJECTIVES.values()} <= set(SPACES)


@pytest.mark.parametrize("name", SPACES)
def test_a_space_begins_with_the_papers_parameters(name: str) -> None:
    searched = SPACES[name]
    assert searched.first.keys() == searched.ranges.keys()
    assert searched.config(searched.first) == PAPER


def test_switches_of_the_wide_space() -> None:
    wide = SPACES["wide"]
    config = wide.config({**wide.first, "is_capped": False, "is_blurred": False})
    assert config == PAPER.model_copy(update={"max_area_px": math.inf, "blur_width_px": 1, "blur_height_px": 1})
