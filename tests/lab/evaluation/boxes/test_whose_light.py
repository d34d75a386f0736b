"""Figures by whose light is in the boxes: worked by hand, and against those by key points."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.datasets.simulated import BoxShares, shares_path
from foreglow.datasets.simulated.shares import write_shares
from foreglow.lab.evaluation import Predictions, SplitLabels, WhoseLight, examine, read_split_labels
from tests.datasets.tiny_pvdn import make_pvdn
from tests.lab.evaluation.scored_boxes import light, predictions_of, split_labels


def stored(images: Mapping[int, Sequence[tuple[int, int, int, int, float]]], preset: str) -> dict[int, BoxShares]:
    """Rows of x1, y1, x2, y2 and the share of vehicles' light by image id."""
    found = {}
    for image_id, rows in images.items():
        boxes = np.array([row[:4] for row in rows], np.int32)
        shares = np.zeros((len(rows), 6), np.float32)
        shares[:, 2] = [row[4] for row in rows]
        shares[:, 5] = 1.0 - shares[:, 2]
        found[image_id] = BoxShares(preset, boxes, shares)
    return found


# Image 0 has no labelled light, image 1 a hidden vehicle's rail, image 2 a lamp.
LABELS = split_labels(
    {0: [], 1: [light(1, 10, 10, kind="rail", is_hidden=True)], 2: [light(2, 50, 50)]},
    empty=[0],
)
SHARES = stored(
    {
        0: [(0, 0, 9, 9, 0.0), (20, 0, 29, 9, 0.3)],  # the second is light of a vehicle too weak for a label
        1: [(5, 5, 15, 15, 0.1), (30, 5, 45, 15, 0.5)],  # the first is just enough; the second has no key point
        2: [(40, 40, 60, 60, 0.9), (70, 0, 80, 9, 0.09), (70, 70, 80, 80, 0.7)],
    },
    "foreglow",
)
BOXES = predictions_of(
    {
        0: [(0, 0, 9, 9, 0.6), (20, 0, 29, 9, 0.7)],
        1: [(5, 5, 15, 15, 0.65), (30, 5, 45, 15, 0.4)],
        2: [(40, 40, 60, 60, 0.9), (70, 0, 80, 9, 0.8)],
    }
)


def figures(labels: SplitLabels, predictions: Predictions = BOXES) -> WhoseLight:
    found = examine(labels, predictions, 0.5, "").whose_light
    assert found is not None
    return found


def test_figures_worked_by_hand() -> None:
    labels = dataclasses.replace(LABELS, shares={"foreglow": SHARES})
    found = figures(labels)
    assert (found.preset, found.num_boxes, found.num_unmatched) == ("foreglow", 6, 0)
    assert found.precision == 3 / 5
    assert found.false_boxes is not None
    assert found.false_boxes_empty is not None
    assert (found.false_boxes.num, found.false_boxes.num_images) == (2, 3)
    assert (found.false_boxes_empty.num, found.false_boxes_empty.num_images) == (1, 1)
    # By descending score: true, false, true, true, false, true; the fifth box to find is not among the predictions.
    assert found.average_precision == pytest.approx((1 + 3 / 4 + 3 / 4 + 4 / 6 + 0) / 5)
    # Six boxes, each a bin of its own.
    assert found.calibration_error == pytest.approx((0.6 + 0.3 + 0.35 + 0.6 + 0.1 + 0.8) / 6)
    points = {point.limit: (point.threshold, point.recall_hidden) for point in found.operating_points}
    assert points[0.05] == (0.6, 1.0)
    # By key points the box with weak light of a vehicle in image 0 is false, and costs the rail.
    ranking = examine(labels, BOXES, 0.5, "").ranking
    assert ranking is not None
    assert (ranking.operating_points[0].threshold, ranking.operating_points[0].recall_hidden) == (0.7, 0.0)


def test_the_figures_by_key_points_stay_as_they_are() -> None:
    without, found = (
        examine(labels, BOXES, 0.5, "") for labels in (LABELS, dataclasses.replace(LABELS, shares={"foreglow": SHARES}))
    )
    assert without.whose_light is None
    assert dataclasses.replace(found, whose_light=None).to_json() == without.to_json()


def test_the_preset_is_the_one_whose_proposals_these_are() -> None:
    others = stored({1: [(5, 5, 15, 15, 0.0)]}, "paper")
    found = figures(dataclasses.replace(LABELS, shares={"paper": others, "foreglow": SHARES}))
    assert (found.preset, found.num_unmatched) == ("foreglow", 0)


def test_other_boxes_have_no_figures() -> None:
    moved = {**BOXES.boxes_xyxy_px, 2: BOXES.boxes_xyxy_px[2] + 1.0}
    predictions = dataclasses.replace(BOXES, boxes_xyxy_px=moved)
    found = figures(dataclasses.replace(LABELS, shares={"foreglow": SHARES}), predictions)
    assert (found.num_unmatched, found.num_boxes) == (2, 6)
    assert found.false_boxes is None
    assert np.isnan([found.precision, found.average_precision]).all()
    assert found.operating_points == ()


def test_boxes_without_scores_are_all_accepted() -> None:
    labels = dataclasses.replace(LABELS, shares={"foreglow": SHARES})
    found = figures(labels, dataclasses.replace(BOXES, is_scored=False))
    assert found.precision == 4 / 6
    assert np.isnan([found.average_precision, found.calibration_error]).all()
    assert found.operating_points == ()


def test_shares_of_the_selected_images_are_read(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    dataset = PVDN(make_pvdn(tmp_path))
    assert read_split_labels(dataset, with_shares=True).shares == {}
    sequence = dataset.sequences[0]
    path = shares_path(dataset.root, sequence.id)
    path.parent.mkdir(parents=True)
    first = sequence.image_ids[0]
    rows = stored({first: [(0, 0, 9, 9, 0.5)], 999_999: [(0, 0, 9, 9, 0.5)]}, "foreglow")
    write_shares(path, rows.items())
    assert read_split_labels(dataset).shares == {}
    shares = read_split_labels(dataset, with_shares=True).shares
    assert {preset: set(by_image) for preset, by_image in shares.items()} == {"foreglow": {first}}
