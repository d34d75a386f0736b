"""Encounters and the time benefit: cases worked by hand."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest

from foreglow.datasets import PVDN, CategoryConfig, ImageCategory, shipped_drive
from foreglow.datasets.simulated import read_truth
from foreglow.datasets.simulated.production import first_reports
from foreglow.files import to_json
from foreglow.lab.evaluation.boxes.breakdown import match_lights, read_split_labels
from foreglow.lab.evaluation.vehicles import Encounter, first_found, read_encounters
from foreglow.lab.studies.time_benefit.metrics import detection_times_s, mean_timeline, time_benefit
from tests.datasets.tiny_pvdn import labelled_vehicle, make_pvdn, write
from tests.lab.evaluation.scored_boxes import predictions_of

NAN = math.nan


@pytest.fixture(name="dataset")
def fixture_dataset(tmp_path: Path) -> PVDN:
    """Sequence 3, images 11 to 13: rear lamps, then light of hidden vehicle 7, then its lamp and that of vehicle 2."""
    root = make_pvdn(tmp_path)
    annotations = {
        11: [labelled_vehicle(1, (5, 5, True), is_rear=True)],
        12: [labelled_vehicle(7, (22, 30, False))],
        13: [labelled_vehicle(2, (80, 20, True)), labelled_vehicle(7, (24, 30, False), (30, 28, True))],
    }
    for image_id, its in annotations.items():
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": its})
    return PVDN(root)


def test_the_first_vehicle_is_the_one_whose_light_comes_first(dataset: PVDN) -> None:
    labels = read_split_labels(dataset)
    (only,) = [each for each in read_encounters(dataset, labels) if each.sequence == "S00003"]
    assert (only.sequence_id, only.vehicle_id, only.vehicle, only.scenario) == (3, 7, "vehicle", "")
    assert (only.light_s, only.sight_s, only.duration_s) == (1 / 18, 2 / 18, 2 / 18)
    assert only.production_s == 2 / 18  # image 13 is of the category for low beam
    assert only.is_occluded
    boxes = predictions_of({11: [(0, 0, 10, 10, 0.9)], 13: [(20, 25, 28, 35, 0.9), (75, 15, 85, 25, 0.9)]})
    found = first_found(labels, match_lights(labels, boxes), 0.5)
    assert detection_times_s([only], found) == (2 / 18,)
    assert math.isnan(detection_times_s([only], [])[0])


def test_the_category_of_the_production_system_can_be_chosen(dataset: PVDN) -> None:
    labels = read_split_labels(dataset)
    categories = CategoryConfig(low_beam_trigger=ImageCategory.LOW_BEAM)
    (only,) = [each for each in read_encounters(dataset, labels, categories) if each.sequence == "S00003"]
    assert math.isnan(only.production_s)


def test_a_simulated_encounter_knows_scenario_and_vehicle() -> None:
    dataset = PVDN(shipped_drive())
    (only,) = read_encounters(dataset, read_split_labels(dataset))
    assert (only.scenario, only.vehicle) == ("curve", "car")
    assert only.light_s < only.sight_s < only.production_s < only.duration_s


def test_the_report_of_another_vehicle_is_none_of_the_first(tmp_path: Path) -> None:
    """A second vehicle is where the first one will be a second later, so that the system reports it before."""
    root = tmp_path / "drive"
    shutil.copytree(shipped_drive(), root)
    file = root / "simulation/S00001/frames.jsonl"
    frames = [json.loads(line) for line in file.read_text().splitlines()]
    for frame, later in zip(frames, [*frames[18:], *frames[-1:] * 18], strict=True):
        frame["vehicles"] = [*frame["vehicles"][:1], {**later["vehicles"][0], "vehicle_id": 1}]
    file.write_text("\n".join(json.dumps(frame) for frame in frames) + "\n")
    reports = first_reports(read_truth(root).sequence(1).frames)
    assert reports[1] == reports[0] - 18
    ((only,), (before,)) = (
        read_encounters(dataset, read_split_labels(dataset)) for dataset in (PVDN(root), PVDN(shipped_drive()))
    )
    assert (only.vehicle_id, only.production_s) == (0, before.production_s)


def encounter(light_s: float, sight_s: float, production_s: float) -> Encounter:
    return Encounter(1, "S00001", "crest", 0, "car", light_s, sight_s, production_s, 9.0)


def test_the_benefit_worked_by_hand() -> None:
    encounters = [
        encounter(1.0, 2.0, 4.0),
        encounter(3.0, 3.0, 4.0),
        encounter(2.0, 4.0, NAN),
        encounter(1.0, NAN, 5.0),
    ]
    result = time_benefit("tracker", encounters, [1.5, 3.5, NAN, 3.0])
    assert (result.delays_s.num, result.delays_s.mean, result.delays_s.median) == (3, 1.0, 0.5)
    assert (result.before_production_s.num, result.before_production_s.mean) == (3, (2.5 + 0.5 + 2.0) / 3)
    assert (result.occluded_before_production_s.num, result.occluded_before_production_s.mean) == (2, 2.25)
    assert result.before_human_s.mean == pytest.approx((0.3 + 0.3 - 1.2) / 3)
    assert (result.before_sight_s.num, result.before_sight_s.mean) == (1, 0.5)  # of the first alone
    assert result.provident_share == 0.5  # of the first and the third: the last never comes into sight
    assert result.num_missed == 1
    assert to_json(result)["detected_s"] == [1.5, 3.5, None, 3.0]


def test_no_encounter() -> None:
    result = time_benefit("tracker", [], [])
    assert (result.delays_s.num, result.num_missed) == (0, 0)
    assert math.isnan(result.provident_share)


def test_the_timeline_is_of_the_vehicles_that_all_detect() -> None:
    encounters = [encounter(1.0, 2.0, 4.0), encounter(3.0, 3.0, 4.0), encounter(2.0, 4.0, NAN)]
    rows = {"tracker": [1.5, 4.0, 9.0], "production system": [4.0, 4.0, NAN]}
    methods = [time_benefit(name, encounters, detected_s) for name, detected_s in rows.items()]
    assert mean_timeline(encounters, methods) == (2, {"tracker": 0.75, "production system": 2.0})
    num, times_s = mean_timeline(encounters[2:], [time_benefit("tracker", encounters[2:], [NAN])])
    assert num == 0
    assert math.isnan(times_s["tracker"])
