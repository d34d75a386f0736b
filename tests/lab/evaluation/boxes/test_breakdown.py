"""Recall by groups of lights, false boxes, hidden vehicles, and first times: cases worked by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.lab.evaluation import Predictions, break_down, evaluate_boxes, match_lights, read_split_labels
from foreglow.lab.evaluation.boxes.breakdown import LightMatches, hidden_curve, threshold_for_empty_images
from foreglow.lab.evaluation.boxes.lights import empty_images, read_lights
from foreglow.lab.evaluation.vehicles import first_found, share_found_ahead
from tests.datasets.tiny_pvdn import make_pvdn
from tests.lab.evaluation.scored_boxes import light, predictions_of, split_labels
from tests.lab.studies import ranged_drives

# Sequence 0: nothing, then a hidden vehicle's rail and haze, then its lamp and a reflection. Sequence 1: a lamp.
LABELS = split_labels(
    {
        0: [],
        1: [
            light(1, 10, 10, kind="rail", is_hidden=True, rank=0, range_m=150.0),
            light(1, 40, 10, kind="haze", is_hidden=True, rank=1, range_m=150.0),
        ],
        2: [light(2, 50, 50, range_m=60.0), light(2, 50, 80, kind="road", rank=0, range_m=60.0)],
        100: [light(100, 5, 5, range_m=math.nan, vehicle_id=4)],
    },
    doubtful_px={2: [(90, 90)]},
    empty=[0],
)
BOXES = predictions_of(
    {
        0: [(0, 0, 9, 9, 0.7), (0, 0, 9, 9, 0.2)],  # false, in an image without vehicles
        1: [(5, 5, 10, 10, 0.6), (30, 5, 45, 15, 0.4)],  # the rail on a box's corner; the haze below the threshold
        2: [(40, 40, 60, 60, 0.9), (85, 85, 95, 95, 0.8), (70, 0, 80, 9, 0.8)],  # lamp, doubtful light, false
    }
)


@pytest.fixture(name="matched")
def fixture_matched() -> LightMatches:
    return match_lights(LABELS, BOXES)


def test_groups_worked_by_hand(matched: LightMatches) -> None:
    found = break_down(matched, 0.5, LABELS)
    figures = {
        (aspect, group.name): (group.num, group.recall, group.ceiling)
        for aspect, groups in found.groups.items()
        for group in groups
    }
    assert figures == {
        ("kind", "lamp"): (2, 0.5, 0.5),
        ("kind", "rail"): (1, 1.0, 1.0),
        ("kind", "road"): (1, 0.0, 0.0),
        ("kind", "haze"): (1, 0.0, 1.0),
        ("source", "direct"): (2, 0.5, 0.5),
        ("source", "indirect"): (3, 1 / 3, 2 / 3),
        ("sight", "hidden"): (2, 0.5, 1.0),
        ("sight", "in sight"): (3, 1 / 3, 1 / 3),
        ("strength", "strongest three reflections"): (3, 1 / 3, 2 / 3),
        ("hidden kind", "rail"): (1, 1.0, 1.0),
        ("hidden kind", "haze"): (1, 0.0, 1.0),
        ("distance", "60-90 m"): (2, 0.5, 0.5),
        ("distance", "130-200 m"): (2, 0.5, 1.0),
    }


def test_false_boxes_worked_by_hand(matched: LightMatches) -> None:
    found = break_down(matched, 0.5)
    assert (found.false_boxes.num, found.false_boxes.num_doubtful, found.false_boxes.num_images) == (3, 1, 4)
    assert (found.false_boxes.per_frame, found.false_boxes.per_frame_without_doubtful) == (0.75, 0.5)
    assert found.false_boxes.per_minute == 0.75 * 18 * 60
    assert (found.false_boxes_empty.num, found.false_boxes_empty.num_images) == (1, 1)
    assert found.precision == 2 / (2 + 3)
    rail = found.group("kind", "rail")
    assert rail is not None
    assert rail.f1 == 2 * 0.4 * 1.0 / 1.4
    assert found.group("kind", "sign") is None


@pytest.mark.parametrize("threshold", [0.0, 0.3, 0.5, 0.85, 1.0])
def test_the_whole_agrees_with_the_metrics(matched: LightMatches, threshold: float) -> None:
    found, quality = break_down(matched, threshold), evaluate_boxes(LABELS.keypoints_px, BOXES, threshold)
    assert (found.whole.num, found.false_boxes.num) == (quality.tp + quality.fn, quality.fp)
    assert found.whole.recall == quality.recall
    assert math.isclose(found.whole.f1, quality.f1)


def test_weathers_worked_by_hand(matched: LightMatches) -> None:
    dry, rain = break_down(matched, 0.5, LABELS).weathers
    assert (dry.name, dry.lights.num, dry.lights.recall, dry.precision) == ("dry", 4, 0.5, 0.4)
    assert math.isclose(dry.lights.f1, 2 / (2 + (3 + 2) / 2))
    assert (dry.false_boxes.num, dry.false_boxes.num_images) == (3, 3)
    assert (rain.name, rain.lights.recall, rain.lights.f1, rain.false_boxes.num) == ("rain", 0.0, 0.0, 0)
    assert math.isnan(rain.precision)
    assert break_down(matched, 0.5).weathers == ()


def test_scenarios_are_groups_of_images_as_weathers_are(matched: LightMatches) -> None:
    found = break_down(matched, 0.5, LABELS)
    assert [group.name for group in found.scenarios] == ["motorway", "village"]
    for scenario, weather in zip(found.scenarios, found.weathers, strict=True):
        assert scenario.lights.num == weather.lights.num
        assert scenario.false_boxes == weather.false_boxes


def test_scenarios_of_a_simulated_split(tmp_path: Path) -> None:
    labels = read_split_labels(PVDN(ranged_drives.make_split(tmp_path)))
    assert set(labels.scenario_of.values()) == {"straight", "sag"}
    assert labels.scenario_of.keys() == labels.sequence_of.keys()


def test_groups_divide_the_lights(matched: LightMatches) -> None:
    groups = break_down(matched, 0.5).groups
    for aspect in ("kind", "source", "sight"):
        assert sum(group.num for group in groups[aspect]) == 5
        assert math.isclose(sum(group.num * group.recall for group in groups[aspect]), 2)


def test_boxes_without_scores_are_all_accepted() -> None:
    plain = Predictions(BOXES.boxes_xyxy_px, BOXES.scores, is_scored=False)
    matched = match_lights(LABELS, plain)
    found = break_down(matched, 0.99)
    assert found.whole.recall == found.whole.ceiling == 0.6
    with pytest.raises(ValueError, match="with scores"):
        threshold_for_empty_images(matched, 0.1)


def test_hidden_vehicles_against_false_boxes(matched: LightMatches) -> None:
    curve = hidden_curve(matched)
    assert curve.thresholds.tolist() == [0.0, 0.2, 0.4, 0.6, 0.7]
    assert curve.recall.tolist() == [1.0, 1.0, 0.5, 0.0, 0.0]
    assert curve.false_boxes_per_frame.tolist() == [2.0, 1.0, 1.0, 1.0, 0.0]
    assert threshold_for_empty_images(matched, 1.0) == 0.2
    assert threshold_for_empty_images(matched, 0.5) == 0.7


def test_first_times(matched: LightMatches) -> None:
    first, second = first_found(LABELS, matched, 0.5)
    assert (first.light_s, first.found_s, first.lamp_s, first.num_frames) == (0.5, 0.5, 1.0, 0.0)
    assert (first.delay_s, first.lead_s) == (0.0, 0.5)
    assert (second.sequence_id, second.vehicle_id, second.light_s) == (1, 4, 0.0)
    assert math.isnan(second.found_s)
    assert math.isnan(second.num_frames)
    later = first_found(LABELS, matched, 0.65)
    assert (later[0].found_s, later[0].num_frames, later[0].lead_s) == (1.0, 1.0, 0.0)
    assert (share_found_ahead([first, second]), share_found_ahead(later)) == (1.0, 0.0)
    assert math.isnan(share_found_ahead([second]))


def test_rear_lamps_are_no_oncoming_vehicle() -> None:
    labels = split_labels({1: [light(1, 5, 5, is_rear=True)]})
    assert first_found(labels, match_lights(labels, Predictions({}, {})), 0.5) == ()


def test_labels_of_a_split(tmp_path: Path) -> None:
    dataset = PVDN(make_pvdn(tmp_path))
    labels = read_split_labels(dataset)
    assert labels.lights == read_lights(dataset)
    assert labels.empty_images == set(empty_images(dataset))
    assert labels.time_s == {5: 0.0, 7: 1 / 18, 11: 0.0, 12: 1 / 18, 13: 2 / 18}
    assert labels.sequence_of == {5: 1, 7: 1, 11: 3, 12: 3, 13: 3}
    assert labels.scenario_of == {}
    assert labels.weather_of == {5: "dry", 7: "dry", 11: "rain", 12: "rain", 13: "rain"}
    for image_id, points in labels.keypoints_px.items():
        assert np.array_equal(points, dataset.keypoints_px(image_id))
