"""Predictions of all forms are read; damaged ones are refused with a message that says where."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.runs.predictions import Predictions, read_predictions, write_predictions

_LINE: dict[str, Any] = {
    "frame": 7,
    "timestamp_ns": 5,
    "proposals_xyxy_px": [[1, 2, 3, 4], [5, 6, 7, 8]],
    "scores": [0.25, 1],
    "detections_xyxy_px": [[5, 6, 7, 8]],
}


def _write(path: Path, *lines: object) -> Path:
    path.write_text("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines))
    return path


def test_lines_of_the_program(tmp_path: Path) -> None:
    empty = {"frame": 8, "proposals_xyxy_px": [], "scores": [], "detections_xyxy_px": []}
    found = read_predictions(_write(tmp_path / "frames.jsonl", _LINE, "", empty))
    assert found.boxes_xyxy_px[7].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]
    assert found.scores[7].tolist() == [0.25, 1.0]
    assert found.boxes_xyxy_px[8].shape == (0, 4)
    assert found.is_scored


@pytest.mark.parametrize("line", [_LINE | {"scores": None}, {k: v for k, v in _LINE.items() if k != "scores"}])
def test_lines_without_a_classifier(tmp_path: Path, line: dict[str, Any]) -> None:
    found = read_predictions(_write(tmp_path / "frames.jsonl", line))
    assert found.scores[7].tolist() == [1.0, 1.0]
    assert not found.is_scored


def test_a_score_of_the_published_form_is_a_probability(tmp_path: Path) -> None:
    path = _write(tmp_path / "predictions.json", {"7": {"boxes": [[1, 2, 3.5, 4]], "scores": [3.5]}})
    with pytest.raises(ValueError, match=r"7: scores\.0: expected a number from 0 to 1, got 3\.5"):
        read_predictions(path)


def test_the_published_form(tmp_path: Path) -> None:
    path = _write(tmp_path / "predictions.json", {"7": {"boxes": [[1, 2, 3.5, 4]], "scores": [0.5]}})
    found = read_predictions(path)
    assert found.boxes_xyxy_px[7].tolist() == [[1, 2, 3.5, 4]]
    assert found.is_scored
    plain = read_predictions(_write(tmp_path / "plain.json", {"7": [[1, 2, 3, 4]], "8": []}))
    assert plain.boxes_xyxy_px[8].shape == (0, 4)
    assert not plain.is_scored
    assert read_predictions(_write(tmp_path / "none.json", {})).is_scored


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([_LINE, "{"], "line 2: expected JSON"),
        ([_LINE, _LINE], "line 2: frame: expected each frame once, 7 is there twice"),
        ([_LINE | {"frame": "7"}], "line 1: frame: expected a valid integer, got '7'"),
        ([_LINE | {"scores": [1]}], "line 1: scores: expected 2, one a box, got 1"),
        ([_LINE, _LINE | {"frame": 8, "scores": None}], "line 2: scores: expected in every line or in none"),
        (
            [_LINE | {"proposals_xyxy_px": [[1, 2, 3]]}],
            "line 1: proposals_xyxy_px.0: expected at least 4 entries, got 3",
        ),
        (
            [_LINE | {"proposals_xyxy_px": [[1, 2, 3, 4], [9, 9, 1, 1]]}],
            r"line 1: proposals_xyxy_px.1: expected x1, y1, x2, y2 with x1 <= x2 and y1 <= y2, got \[9.*, 1",
        ),
        ([_LINE | {"scores": [1, float("nan")]}], "line 1: scores.1: expected a finite number"),
        ([_LINE | {"scores": [1, 1.5]}], "line 1: scores.1: expected a number from 0 to 1, got 1.5"),
        ([_LINE | {"scores": [-0.1, 1]}], "line 1: scores.0: expected a number from 0 to 1, got -0.1"),
        ([{"frame": 7}], "line 1: proposals_xyxy_px: field is missing"),
        (["[]"], "line 1: document: expected an object"),
    ],
)
def test_bad_lines(tmp_path: Path, lines: list[object], message: str) -> None:
    path = _write(tmp_path / "frames.jsonl", *lines)
    with pytest.raises(ValueError, match=message) as caught:
        read_predictions(path)
    assert str(caught.value).startswith(f"{path}: line ")


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("", "expected JSON"),
        ([1], "0: expected an object"),
        ({"7": {"boxes": [[1, 2, 3, 4]]}}, "7.scores: field is missing"),
        ({"7": {"boxes": [[1, 2, 3, 4]], "scores": []}}, "7: scores: expected 1, one a box, got 0"),
        ({"7": {"boxes": [[1, 2, 3, 4]], "scores": [1]}, "8": [[1, 2, 3, 4]]}, "8: expected an object, got"),
        ({"7": [[1, 2, 3, "4"]]}, "7.0.3: expected a valid number, got '4'"),
        ({"7": {"boxes": [[1, 4, 3, 2]], "scores": [1]}}, "7: boxes.0: expected x1, y1, x2, y2 with x1 <= x2"),
        ({"7": [[3, 2, 1, 4]]}, "7: boxes.0: expected x1, y1, x2, y2 with x1 <= x2"),
        ({"7": 3}, "7: expected a valid array, got 3"),
        ({"": []}, "'': expected an image id"),
        ({"-1": []}, "'-1': expected an image id"),
        ({"7": [], "07": []}, "07: expected each image id once, 7 is there twice"),
    ],
)
def test_bad_documents(tmp_path: Path, document: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_predictions(_write(tmp_path / "predictions.json", document))


@pytest.mark.parametrize("is_scored", [True, False])
def test_what_is_written_comes_back(tmp_path: Path, is_scored: bool) -> None:
    boxes = {7: np.array([[1.0, 2.0, 3.5, 4.0]]), 8: np.zeros((0, 4))}
    scores = {7: np.array([1.0 if not is_scored else 0.1]), 8: np.zeros(0)}
    write_predictions(tmp_path / "predictions.json", Predictions(boxes, scores, is_scored))
    found = read_predictions(tmp_path / "predictions.json")
    assert found.is_scored == is_scored
    for image_id in (7, 8):
        np.testing.assert_array_equal(found.boxes_xyxy_px[image_id], boxes[image_id])
        np.testing.assert_array_equal(found.scores[image_id], scores[image_id])


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected predictions"):
        read_predictions(tmp_path / "absent.json")
    with pytest.raises(ValueError, match="expected a file, is a folder"):
        read_predictions(tmp_path)


@pytest.mark.slow
@settings(derandomize=True, max_examples=150)
@given(st.sampled_from([".json", ".jsonl"]), st.data())
def test_damaged_files_are_read_or_refused(suffix: str, data: st.DataObject) -> None:
    document = _LINE if suffix == ".jsonl" else {"7": {"boxes": [[1, 2, 3, 4]], "scores": [0.5]}, "8": []}
    text = bytearray(json.dumps(document).encode())
    for index in data.draw(st.lists(st.integers(0, len(text) - 1), max_size=4)):
        text[index] = data.draw(st.integers(0, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"predictions{suffix}"
        path.write_bytes(bytes(text))
        message = str(path)
        try:
            read_predictions(path)
        except ValueError as error:
            message = str(error)
        assert message.startswith(str(path))
        assert message.isprintable()
