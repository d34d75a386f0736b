"""The report on the table of detectors: rows that are missing, numbers in place, one file with everything in it."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.lab.reports.page import DASH
from foreglow.lab.studies.detector.page import (
    FOUND_BGR,
    MISSED_BGR,
    Choice,
    Shown,
    draw,
    hidden_table,
    kind_table,
    main_table,
    pictures,
    whose_light_table,
    write_report,
)
from foreglow.lab.studies.detector.rows import DetectorPlan
from foreglow.lab.studies.detector.run import RowResult, run_experiment
from foreglow.types import Frame
from tests.lab.studies.detector_data import make_data, make_model
from tests.stand_ins import result_of

pytest.importorskip("onnx")

MISSING = RowResult(name="yolo-large", title="YOLO, large", reason="needs a GPU | a large one")


class Checked(HTMLParser):
    """Counts elements, and complains about one that is closed in the wrong place."""

    VOID = ("meta", "img")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        self.counts[tag] = self.counts.get(tag, 0) + 1
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_a_whole_report(tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    given = {name: make_model(tmp_path / f"{name}.onnx") for name in ("paper", "compact")}
    plan = DetectorPlan(rows=("paper", "compact", "yolo-large"), given=given, may_train=False)
    results = run_experiment(data, tmp_path / "out", plan)
    shown = list(pictures(results, PVDN(data / "test")))
    assert shown
    report = write_report(results, shown, tmp_path / "out")
    page = Checked()
    text = report.read_text()
    page.feed(text)
    assert page.open == []
    assert page.counts["img"] == len(shown)
    assert page.counts["table"] == 3
    assert "http" not in text
    assert "Paper&#x27;s preset, compact network" in text
    document = json.loads((tmp_path / "out/results.json").read_text())
    assert [row["name"] for row in document["rows"]] == ["paper", "compact", "yolo-large"]
    assert document["num_images"] == 6
    table = (tmp_path / "out/table.md").read_text()
    assert "| YOLO, large | *not given (--yolo-large), and nothing is trained (--no-training)* |" in table
    assert "less Paper's preset and network: +0.000" in table
    write_report(results, shown, tmp_path / "out")
    assert report.read_text() == text


def test_all_rows_missing() -> None:
    for table in (main_table([MISSING]), kind_table([MISSING]), hidden_table([MISSING])):
        head, rule, row = table.markdown().splitlines()
        assert head.count("|") == rule.count("|") == row.count("|") - row.count("\\|")
        assert "*needs a GPU \\| a large one*" in row


def test_numbers_and_their_ceilings() -> None:
    rates = dict.fromkeys(("precision", "recall", "f1", "q", "q_k", "q_b"), 0.5)
    quality = rates | {"q_k_std": 0.25, "q_b_std": 0.0}
    row = RowResult(
        name="paper",
        title="Paper",
        image_size_px=(640, 480),
        num_parameters=941761,
        num_multiply_adds=195_421_568,
        num_multiply_adds_frame=1.4e9,
        run_time_ms={"mean": 1.234, "std": 0.5, "median": 1.0, "p99": 250.4},
        num_boxes=2.5,
        ceiling=rates | {"precision": 1.0, "q": None},
        examination={"quality": quality | {"recall": None}},
    )
    (cells,) = main_table([row]).rows
    assert cells == [
        *("Paper", "640x480", "942 k", "195 M", "1.4 G", "1.23 ± 0.50", "1.00", "250"),
        *(".500 (1.00)", "– (.500)", ".500 (.500)", ".500 (–)", ".500 ± .250 (.500)", ".500 ± .000 (.500)", "2.50"),
    ]


def test_figures_by_whose_light() -> None:
    points = [{"limit": 0.05, "recall_hidden": 0.25}]
    known = {
        "precision": 0.75, "average_precision": 0.5, "false_boxes": {"per_frame": 0.125},
        "false_boxes_empty": {"per_frame": None}, "operating_points": points,
    }  # fmt: skip
    unmatched: dict[str, Any] = {
        "precision": None,
        "average_precision": None,
        "false_boxes": None,
        "operating_points": [],
    }
    made = [
        RowResult(name=name, title=name, examination={"whose_light": found})
        for name, found in (("a", known), ("b", unmatched))
    ]
    kept = RowResult(name="c", title="c")  # measured before there were such figures
    table = whose_light_table([*made, kept, RowResult(name="d", title="d", reason="none given")])
    assert table.head[-1] == "hidden at most 0.05"
    assert [[str(cell) for cell in row] for row in table.rows[:3]] == [
        ["a", ".750", ".500", ".125", DASH, ".250"],
        ["b", *[DASH] * 5],
        ["c", *[DASH] * 5],
    ]
    assert len(table.rows[3]) == 2


def test_marks_of_lights() -> None:
    frame = Frame(np.full((960, 1280), 20, np.uint8), 0, frame=7, sequence="S00001")
    result = result_of(frame, [[90, 90, 110, 110]], [0.9])
    lights = np.array([[100.0, 100.0], [600.0, 500.0]])
    choice = Choice(7, True, 0)
    picture = draw(Shown("paper", choice, frame, result, lights, np.array([True, False])))
    assert picture.shape == (960, 1280, 3)
    assert picture[500, 600].tolist() == list(MISSED_BGR)
    ring = picture[100 - 8 : 100 + 9, 100 - 8 : 100 + 9].reshape(-1, 3)
    assert (np.abs(ring.astype(int) - FOUND_BGR).sum(axis=1) < 30).any()


def test_a_picture_in_the_page_is_the_one_drawn(tmp_path: Path) -> None:
    import base64

    data = make_data(tmp_path / "data")
    plan = DetectorPlan(rows=("paper",), given={"paper": make_model(tmp_path / "m.onnx")}, may_train=False)
    results = run_experiment(data, tmp_path / "out", plan)
    shown = list(pictures(results, PVDN(data / "test")))[:1]
    text = write_report(results, shown, tmp_path / "out").read_text()
    encoded = text.split("base64,")[1].split('"')[0]
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape[1] == 900
