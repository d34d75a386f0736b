"""The report on a detector."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from foreglow.lab.evaluation import Predictions, examine
from foreglow.lab.reports.evaluation_page import examination_lines, write_report
from tests.lab.evaluation.scored_boxes import light, predictions_of, split_labels

pytestmark = pytest.mark.usefixtures("undrawn")


def test_what_is_not_defined_is_a_dash(tmp_path: Path) -> None:
    """Every image has a vehicle, so that there is none to count false boxes a minute in without any."""
    labels = split_labels({1: [light(1, 10, 10)]}, empty=[])
    boxes = predictions_of({1: [(5, 5, 15, 15, 0.9), (30, 5, 45, 15, 0.8)]})
    text = write_report(examine(labels, boxes, 0.5, "x"), tmp_path / "report", {}).read_text()
    assert re.search(r"^\| without vehicles \| 0 \| 0 \| 0 \| – \| – \| – \|$", text, re.MULTILINE)
    assert re.search(r"^\| all \| 1 \| 1 \| 0 \| 1.000 \| 1.000 \| 1080 \|$", text, re.MULTILINE)
    assert not re.search(r"\bnan\b", text)
    assert "The light of 0 is there in the first image of their sequence" in text  # but in one 0.5 s later
    begun = examine(split_labels({0: [light(0, 10, 10)]}, empty=[]), boxes, 0.5, "x")
    text = write_report(begun, tmp_path / "begun", {}).read_text()
    assert "The light of 1 is there in the first image of their sequence: since when, nobody knows." in text


def test_thresholds_near_one_can_be_set_as_they_are_told(tmp_path: Path) -> None:
    """Those of a classifier that is too sure were told as 1.000, above which no box counts."""
    labels = split_labels({1: [light(1, 10, 10)], 2: []}, empty=[2])
    boxes = predictions_of({1: [(5, 5, 15, 15, 0.9999993)], 2: [(30, 5, 45, 15, 0.9999812)]})
    examination = examine(labels, boxes, 0.5, "x")
    lines = examination_lines(examination)
    assert "best F 1.000 at threshold 0.999982; average precision 1.000" in lines
    assert any("(threshold 0.999982)" in line for line in lines)
    text = write_report(examination, tmp_path / "report", {}).read_text()
    assert "| 0.2 | 0.999982 | – | 1.000 | 1.000 | 1.000 |" in text
    assert examine(labels, boxes, 0.999982, "x").quality.f1 == 1.0


def test_what_the_figures_are_of_is_said(tmp_path: Path) -> None:
    labels = split_labels({1: [light(1, 10, 10)], 2: []}, empty=[2])
    scored = predictions_of({1: [(5, 5, 15, 15, 0.9)], 7: [(5, 5, 15, 15, 0.9)]})
    examination = dataclasses.replace(examine(labels, scored, 0.5, "x"), notes=("taken for the labels of x",))
    text = write_report(examination, tmp_path / "scored", {}).read_text()
    assert "\n- taken for the labels of x\n" in text
    assert (
        "2 images, score > 0.5; 1 image without predictions, counted as without boxes; predictions for 1 unknown image "
        "ignored."
    ) in text
    assert "At threshold 0.5; the ceiling" in text
    boxes = {1: np.array([[5.0, 5, 15, 15]]), 2: np.zeros((0, 4))}
    plain = Predictions(boxes, {image: np.ones(len(its)) for image, its in boxes.items()}, is_scored=False)
    text = write_report(examine(labels, plain, 0.5, "x"), tmp_path / "plain", {}).read_text()
    assert "2 images, boxes without scores, all count." in text
    assert "All boxes count, since none has a score; the ceiling" in text
