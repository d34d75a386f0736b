"""The story of a drive: cases worked by hand."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from foreglow.datasets import PVDN, shipped_drive
from foreglow.lab.evaluation import Predictions
from foreglow.lab.evaluation.boxes.lights import read_lights
from foreglow.lab.studies.demo.metrics import best_story, has_labels, tell_stories
from foreglow.types import TrackState
from tests.datasets.tiny_pvdn import labelled_vehicle, make_pvdn, write
from tests.lab.evaluation.scored_boxes import predictions_of
from tests.stand_ins import tracks_of


@pytest.fixture(name="dataset")
def fixture_dataset(tmp_path: Path) -> PVDN:
    """Sequence 3, images 11 to 13: rear lamps and the light of hidden vehicle 7, then more of it, then its lamp."""
    root = make_pvdn(tmp_path)
    annotations = {
        11: [labelled_vehicle(1, (5, 5, True), is_rear=True), labelled_vehicle(7, (20, 30, False))],
        12: [labelled_vehicle(7, (22, 30, False), (60, 30, False)), labelled_vehicle(2, (80, 20, True))],
        13: [labelled_vehicle(7, (24, 30, False), (30, 28, True))],
    }
    for image_id, its in annotations.items():
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": its})
    return PVDN(root)


def test_a_story_worked_by_hand(dataset: PVDN) -> None:
    boxes = predictions_of(
        {
            11: [(0, 0, 10, 10, 0.9), (15, 25, 25, 35, 0.4)],  # the rear lamp; the light below the threshold
            12: [(15, 25, 25, 35, 0.6), (55, 25, 65, 35, 0.8), (75, 15, 85, 25, 0.9)],  # the last one: vehicle 2
            13: [(15, 20, 40, 40, 0.9)],
        }
    )
    (story,) = tell_stories(dataset, boxes, 0.5)
    assert (story.sequence, story.vehicle, story.times.vehicle_id) == ("S00003", "vehicle", 7)
    assert (story.light.time_s, story.light.light.position_px, story.light.score) == (0.0, (20.0, 30.0), 0.4)
    assert story.found is not None
    assert (story.found.time_s, story.found.light.position_px, story.found.score) == (1 / 18, (60.0, 30.0), 0.8)
    assert story.sight is not None
    assert (story.sight.time_s, story.sight.light.position_px) == (2 / 18, (30.0, 28.0))
    assert story.is_hidden_first
    assert math.isnan(story.confirmed_s)
    images = {name: moment.light.image_id for name, moment in story.moments.items()}
    assert images == {"light": 11, "found": 12, "sight": 13, "reported": 13}
    assert (story.production_s, story.duration_s) == (2 / 18, 2 / 18)  # image 13 is of the category for low beam
    assert math.isclose(story.times.lead_s, 1 / 18)
    assert (story.num_images_before, story.num_boxes_before) == (0, 0)


def test_what_never_happens_is_none(dataset: PVDN) -> None:
    (missed,) = tell_stories(dataset, Predictions({}, {}), 0.5)
    assert missed.found is None
    assert math.isnan(missed.light.score)
    assert list(missed.moments) == ["light", "sight", "reported"]
    write(dataset.root / "labels/keypoints/000013.json", {"image_id": 13, "annotations": []})
    (unseen,) = tell_stories(PVDN(dataset.root), predictions_of({11: [(15, 25, 25, 35, 0.7)]}), 0.5)
    assert unseen.sight is None
    assert unseen.is_hidden_first
    assert unseen.found is not None
    assert unseen.found.time_s == 0.0


def test_false_boxes_before_the_first_light(dataset: PVDN) -> None:
    folder = dataset.root / "labels/keypoints"
    write(folder / "000011.json", {"image_id": 11, "annotations": [], "doubtful": [{"pos": [70, 60], "iid": 0}]})
    boxes = [(0, 0, 9, 9, 0.9), (10, 0, 19, 9, 0.2), (65, 55, 75, 65, 0.9)]  # false, rejected, doubtful light
    found = predictions_of({5: boxes, 11: boxes, 12: boxes})  # another sequence, before, from then on
    (story,) = tell_stories(PVDN(dataset.root), found, 0.5)
    assert (story.light.light.image_id, story.num_images_before, story.num_boxes_before) == (12, 1, 1)


def test_boxes_without_scores_are_all_found(dataset: PVDN) -> None:
    plain = predictions_of({11: [(15, 25, 25, 35, 1.0)]})
    (story,) = tell_stories(dataset, Predictions(plain.boxes_xyxy_px, plain.scores, is_scored=False), 0.99)
    assert story.found is not None
    assert math.isnan(story.found.score)


def test_a_sequence_without_light_has_no_story(dataset: PVDN) -> None:
    for image_id in (11, 12, 13):
        write(dataset.root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": []})
    assert tell_stories(PVDN(dataset.root), Predictions({}, {}), 0.5) == ()


def test_the_best_story_leads_longest(dataset: PVDN) -> None:
    (missed,) = tell_stories(dataset, Predictions({}, {}), 0.5)
    (late,) = tell_stories(dataset, predictions_of({13: [(25, 20, 35, 35, 0.9)]}), 0.5)
    (early,) = tell_stories(dataset, predictions_of({12: [(55, 25, 65, 35, 0.8)]}), 0.5)
    assert best_story([missed, late, early]) is early
    assert best_story([missed, late]) is missed  # neither is ahead: the first
    assert best_story([]) is None


def test_labels_may_be_absent(dataset: PVDN) -> None:
    assert has_labels(dataset)
    for path in (dataset.root / "labels/keypoints").iterdir():
        path.unlink()
    (dataset.root / "labels/keypoints").rmdir()
    assert not has_labels(dataset)


def test_the_truth_of_the_shipped_drive_is_told() -> None:
    dataset = PVDN(shipped_drive())
    lights = {image_id: its for image_id, its in read_lights(dataset).items() if its}
    late = list(lights)[4:]
    around = {
        each: [(x - 3, y - 3, x + 3, y + 3, 0.9) for x, y in (it.position_px for it in lights[each])] for each in late
    }
    (story,) = tell_stories(dataset, predictions_of(around), 0.5)
    assert story.vehicle == "car"
    assert story.light.light.kind == "rail"
    assert story.found is not None
    assert story.found.light.image_id == late[0]
    assert story.times.light_s < story.found.time_s < story.times.lamp_s < story.production_s < story.duration_s


def test_a_story_with_tracks(dataset: PVDN) -> None:
    """The track holds the light from the first image on, and is plausible in the second."""
    box = (15, 25, 25, 35, 0.6)
    boxes = predictions_of({5: [], 7: [], 11: [box], 12: [box], 13: [box]})
    tracks = {
        image_id: tracks_of([box[:4]] if image_id > 10 else [], [TrackState(image_id > 11)] * (image_id > 10))
        for image_id in PVDN(dataset.root).frame_ids
    }
    (story,) = tell_stories(PVDN(dataset.root), boxes, 0.5, tracks)
    assert (story.times.found_s, story.confirmed_s) == (0.0, 1 / 18)
    assert story.moments["confirmed"].light.image_id == 12
