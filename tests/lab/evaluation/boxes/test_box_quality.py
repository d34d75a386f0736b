from __future__ import annotations

import dataclasses
import json
import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from foreglow.files import to_json
from foreglow.lab.evaluation import (
    BoxQuality,
    Predictions,
    annotation_quality,
    evaluate_boxes,
    evaluate_split,
    read_predictions,
)
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn
from tests.shared_data import shared_file

pytestmark = pytest.mark.slow

Keypoints = dict[int, NDArray[Any]]


def _points(*points: tuple[float, float]) -> NDArray[np.float64]:
    return np.array(points, np.float64).reshape(-1, 2)


def _predictions(**images: list[tuple[float, float, float, float, float]]) -> Predictions:
    """Boxes with scores by image, named i7 for 7."""
    rows = {int(name[1:]): np.array(boxes, np.float64).reshape(-1, 5) for name, boxes in images.items()}
    return Predictions({key: row[:, :4] for key, row in rows.items()}, {key: row[:, 4] for key, row in rows.items()})


def _same(left: BoxQuality, right: BoxQuality) -> bool:
    return bool(to_json(left) == to_json(right))


def test_a_case_worked_by_hand() -> None:
    # Image 1: a box around both keypoints and a second one around the first of them, a third around none.
    # Image 2: one keypoint, missed. Image 3: nothing, and no boxes.
    keypoints = {1: _points((10, 10), (20, 10)), 2: _points((50, 50)), 3: _points()}
    quality = evaluate_boxes(
        keypoints, _predictions(i1=[(0, 0, 30, 30, 0.9), (5, 5, 15, 15, 0.8), (80, 80, 90, 90, 0.7)], i2=[])
    )
    assert (quality.tp, quality.fp, quality.fn) == (2, 1, 1)
    assert quality.precision == quality.recall == quality.f1 == 2 / 3
    # n_K = 2 and 1; n_B = 2 and 1.
    assert quality.q_k == quality.q_b == 0.75
    assert quality.q_k_std == quality.q_b_std == 0.25
    assert quality.q == 0.5625
    assert (quality.num_images, quality.num_missing, quality.num_unknown) == (3, 1, 0)


@pytest.mark.parametrize(
    ("x", "y", "is_inside"),
    [(10, 20, 1), (30, 20, 1), (30, 40, 1), (10, 40, 1), (9, 20, 0), (31, 20, 0), (10, 19, 0), (10, 41, 0)],
)
def test_all_four_edges_belong_to_the_box(x: float, y: float, is_inside: int) -> None:
    assert evaluate_boxes({1: _points((x, y))}, _predictions(i1=[(10, 20, 30, 40, 1.0)])).tp == is_inside


@pytest.mark.parametrize(("score", "counts"), [(0.5, 0), (np.nextafter(0.5, 1), 1), (0.49, 0)])
def test_a_score_must_be_above_the_threshold(score: float, counts: int) -> None:
    assert evaluate_boxes({1: _points((1, 1))}, _predictions(i1=[(0, 0, 2, 2, score)]), 0.5).tp == counts


def test_empty_sets_are_nan_and_null() -> None:
    nothing = evaluate_boxes({1: _points()}, _predictions())
    rates = ("precision", "recall", "f1", "q", "q_k", "q_k_std", "q_b", "q_b_std")
    assert all(math.isnan(getattr(nothing, name)) for name in rates)
    assert all(to_json(nothing)[name] is None for name in rates)
    assert json.loads(json.dumps(to_json(nothing), allow_nan=False))["tp"] == 0
    missed = evaluate_boxes({1: _points((1, 1))}, _predictions())
    assert (missed.recall, missed.f1) == (0.0, 0.0)
    assert math.isnan(missed.precision)
    assert math.isnan(missed.rounded_as_published().q)


def test_no_images_at_all() -> None:
    assert evaluate_boxes({}, _predictions(i1=[(0, 0, 1, 1, 1)])).num_unknown == 1


def test_unknown_images_are_ignored_but_counted() -> None:
    keypoints = {1: _points((1, 1))}
    quality = evaluate_boxes(keypoints, _predictions(i1=[(0, 0, 2, 2, 1)], i9=[(0, 0, 2, 2, 1)], i8=[]))
    assert (quality.tp, quality.fp, quality.num_unknown) == (1, 0, 2)


def test_boxes_without_scores_all_count_and_the_result_says_so() -> None:
    boxes = Predictions({1: np.array([[0.0, 0, 2, 2]])}, {1: np.ones(1)}, is_scored=False)
    quality = evaluate_boxes({1: _points((1, 1))}, boxes, threshold=1.0)
    assert quality.tp == 1
    assert not quality.is_scored


def test_the_published_rounding_rounds_before_it_multiplies() -> None:
    keypoints = {1: _points((1, 1), (2, 1), (3, 1))}  # n_K = 3, 1: q_K = 2/3; n_B = 2, 1, 1: q_B = 5/6
    quality = evaluate_boxes(keypoints, _predictions(i1=[(0, 0, 9, 9, 1), (0, 0, 1, 1, 1)]))
    rounded = quality.rounded_as_published()
    assert quality.q == pytest.approx(5 / 9)
    assert (rounded.q_k, rounded.q_b, rounded.q) == (0.6667, 0.8333, round(0.6667 * 0.8333, 4))
    assert (rounded.tp, rounded.num_images) == (quality.tp, quality.num_images)


@pytest.mark.parametrize("threshold", [math.nan, math.inf, -math.inf, -1, 2, True, "x", [0.5]])
def test_a_threshold_is_a_share(tmp_path: Path, threshold: Any) -> None:
    with pytest.raises(ValueError, match=r"^threshold: expected a number from 0 to 1, got "):
        evaluate_boxes({}, _predictions(), threshold)
    with pytest.raises(ValueError, match=r"^threshold: expected a number from 0 to 1, got "):
        evaluate_split(tmp_path, tmp_path / "frames.jsonl", threshold)


@pytest.mark.parametrize(
    ("keypoints_px", "predictions", "complaint"),
    [
        (None, _predictions(), "keypoints_px: expected Mapping, got NoneType"),
        ([np.zeros((1, 2))], _predictions(), "keypoints_px: expected Mapping, got list"),
        ({1: [[1, 2]]}, _predictions(), "keypoints_px: image 1: expected numbers of shape (N, 2), got list"),
        ({1: np.zeros((1, 3))}, _predictions(), "keypoints_px: image 1: expected numbers of shape (N, 2), got float64"),
        (
            {1: np.array([["a", "b"]])},
            _predictions(),
            "keypoints_px: image 1: expected numbers of shape (N, 2), got <U1",
        ),
        ({1: np.array([[3, np.nan]])}, _predictions(), "keypoints_px: image 1: expected finite numbers, got nan"),
        ({1: np.array([[-np.inf, 3]])}, _predictions(), "keypoints_px: image 1: expected finite numbers, got -inf"),
        ({"1": np.zeros((1, 2))}, _predictions(), "keypoints_px: expected numbers of images, got '1'"),
        ({}, None, "predictions: expected Predictions, got NoneType"),
        ({}, {1: np.zeros((1, 4))}, "predictions: expected Predictions, got dict"),
        ({}, [[0, 0, 1, 1]], "predictions: expected Predictions, got list"),
    ],
)
def test_arguments_of_another_type(keypoints_px: Any, predictions: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(complaint)}"):
        evaluate_boxes(keypoints_px, predictions)


@pytest.mark.parametrize(
    ("boxes", "scores", "complaint"),
    [
        (None, {}, "boxes_xyxy_px: expected Mapping, got NoneType"),
        ({}, [], "scores: expected Mapping, got list"),
        ({1: [[0, 0, 1, 1]]}, {1: np.ones(1)}, "boxes_xyxy_px: image 1: expected numbers of shape (N, 4), got list"),
        (
            {1: np.zeros((1, 5))},
            {1: np.ones(1)},
            "boxes_xyxy_px: image 1: expected numbers of shape (N, 4), got float64",
        ),
        ({1: np.zeros((1, 4))}, {1: [1.0]}, "scores: image 1: expected numbers of shape (1,), got list"),
        ({1: np.zeros((1, 4))}, {1: np.ones(2)}, "scores: image 1: expected numbers of shape (1,), got float64"),
        ({1: np.full((1, 4), np.nan)}, {1: np.ones(1)}, "boxes_xyxy_px: image 1: expected finite numbers, got nan"),
        ({1: np.full((1, 4), np.inf)}, {1: np.ones(1)}, "boxes_xyxy_px: image 1: expected finite numbers, got inf"),
        ({1: np.array([[5, 0, 1, 9]])}, {1: np.ones(1)}, "boxes_xyxy_px: image 1: 0: expected x1, y1, x2, y2 with x1"),
        ({1: np.zeros((1, 4))}, {1: np.array([math.nan])}, "scores: image 1: expected finite numbers, got nan"),
        ({1: np.zeros((1, 4))}, {1: np.array([2.0])}, "scores: image 1: 0: expected a number from 0 to 1, got 2.0"),
        ({1: np.zeros((1, 4))}, {1: np.array([-1])}, "scores: image 1: 0: expected a number from 0 to 1, got -1"),
        ({"1": np.zeros((1, 4))}, {"1": np.ones(1)}, "boxes_xyxy_px: expected numbers of images, got '1'"),
    ],
)
def test_predictions_of_another_type(boxes: Any, scores: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=rf"^Predictions\.{re.escape(complaint)}"):
        Predictions(boxes, scores)


_COORDINATES = st.integers(0, 12).map(float)
_SIDES = st.tuples(_COORDINATES, _COORDINATES).map(sorted)
_BOXES = st.lists(
    st.tuples(_SIDES, _SIDES, st.floats(0, 1)).map(lambda box: (box[0][0], box[1][0], box[0][1], box[1][1], box[2])),
    max_size=5,
)
_IMAGES = st.dictionaries(
    st.integers(0, 9), st.tuples(st.lists(st.tuples(_COORDINATES, _COORDINATES), max_size=5), _BOXES), max_size=4
)
_CASES = _IMAGES.map(
    lambda images: (
        {key: _points(*points) for key, (points, _) in images.items()},
        _predictions(**{f"i{key}": boxes for key, (_, boxes) in images.items()}),
    )
)
_quick = settings(derandomize=True, max_examples=100)


@_quick
@given(_CASES)
def test_counts_agree_with_plain_loops(case: tuple[Keypoints, Predictions]) -> None:
    keypoints, predictions = case
    tp = fp = fn = 0
    for image_id, points in keypoints.items():
        scored = zip(predictions.boxes_xyxy_px[image_id], predictions.scores[image_id], strict=True)
        boxes = [box for box, score in scored if score > 0.5]
        inside = [[b[0] <= p[0] <= b[2] and b[1] <= p[1] <= b[3] for b in boxes] for p in points]
        tp += sum(any(row) for row in inside)
        fn += sum(not any(row) for row in inside)
        fp += sum(not any(row[index] for row in inside) for index in range(len(boxes)))
    quality = evaluate_boxes(keypoints, predictions)
    assert (quality.tp, quality.fp, quality.fn) == (tp, fp, fn)


def _backwards(images: Mapping[int, NDArray[Any]]) -> Keypoints:
    return dict(reversed(list(images.items())))


@_quick
@given(_CASES)
def test_the_order_of_images_does_not_matter(case: tuple[Keypoints, Predictions]) -> None:
    keypoints, predictions = case
    backwards = Predictions(_backwards(predictions.boxes_xyxy_px), _backwards(predictions.scores))
    turned = evaluate_boxes(_backwards(keypoints), backwards)
    quality = evaluate_boxes(keypoints, predictions)
    for name, value in to_json(quality).items():
        assert to_json(turned)[name] == (pytest.approx(value) if isinstance(value, float) else value)


@_quick
@given(_CASES, st.integers(-1000, 1000), st.integers(-1000, 1000))
def test_moving_everything_changes_nothing(case: tuple[Keypoints, Predictions], dx: int, dy: int) -> None:
    keypoints, predictions = case
    moved = Predictions(
        {key: boxes + np.array([dx, dy, dx, dy]) for key, boxes in predictions.boxes_xyxy_px.items()},
        predictions.scores,
    )
    moved_keypoints = {key: points + np.array([dx, dy]) for key, points in keypoints.items()}
    assert _same(evaluate_boxes(moved_keypoints, moved), evaluate_boxes(keypoints, predictions))


@_quick
@given(_CASES)
def test_a_higher_threshold_never_finds_more(case: tuple[Keypoints, Predictions]) -> None:
    found = [evaluate_boxes(*case, threshold) for threshold in (0.0, 0.3, 0.6, 1.0)]
    assert [each.tp for each in found] == sorted((each.tp for each in found), reverse=True)
    assert [each.fp for each in found] == sorted((each.fp for each in found), reverse=True)
    assert [each.fn for each in found] == sorted(each.fn for each in found)


@_quick
@given(_CASES)
def test_truth_against_itself_is_perfect(case: tuple[Keypoints, Predictions]) -> None:
    keypoints = {key: np.unique(points, axis=0) for key, points in case[0].items()}
    exact = Predictions(
        {key: np.hstack([points, points]) for key, points in keypoints.items()},
        {key: np.ones(len(points)) for key, points in keypoints.items()},
    )
    quality = evaluate_boxes(keypoints, exact)
    assert (quality.fp, quality.fn) == (0, 0)
    if quality.tp:
        perfect = dataclasses.replace(quality, precision=1, recall=1, f1=1, q=1, q_k=1, q_k_std=0, q_b=1, q_b_std=0)
        assert quality == perfect


_PUBLISHED = {
    "precision": "precision",
    "recall": "recall",
    "f1_score": "f1",
    "box_quality": "q",
    "qk": "q_k",
    "qk_std": "q_k_std",
    "qb": "q_b",
    "qb_std": "q_b_std",
}


def test_the_published_code_gives_the_same(tmp_path: Path) -> None:
    golden = json.loads(shared_file("reference/golden/metrics_cases.json").read_text())
    keypoints = {
        int(image_id): _points(*(instance["pos"] for vehicle in vehicles for instance in vehicle["instances"]))
        for image_id, vehicles in golden["gt"].items()
    }
    for name, case in golden["cases"].items():
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(case["preds"]))
        quality = evaluate_boxes(keypoints, read_predictions(path), case["conf"]).rounded_as_published()
        assert [quality.tp, quality.fp, quality.fn] == list(case["totals"].values()), name
        for theirs, ours in _PUBLISHED.items():
            expected = case["result"][theirs]
            assert to_json(quality)[ours] == (None if expected == -1 else expected), (name, ours)


@pytest.mark.filterwarnings("ignore:.* (without predictions|with predictions)")
def test_a_split_and_a_file(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    path = tmp_path / "frames.jsonl"
    lines = [
        {"frame": 11, "proposals_xyxy_px": [[36, 29, 46, 33], [0, 0, 5, 5]], "scores": [0.9, 0.4]},
        {"frame": 99, "proposals_xyxy_px": [], "scores": []},
    ]
    path.write_text("\n".join(map(json.dumps, lines)))
    with pytest.warns(UserWarning, match="images") as told:
        quality = evaluate_split(split, path)
    assert [str(each.message).partition(": ")[2] for each in told] == [
        f"4 images of {split} without predictions, counted as without boxes",
        f"1 images with predictions that {split} does not have, which are ignored",
    ]
    assert {each.filename for each in told} == {__file__}
    assert (quality.tp, quality.fp, quality.fn) == (2, 0, 1)
    assert (quality.num_images, quality.num_missing, quality.num_unknown) == (5, 4, 1)
    assert evaluate_split(split, path, threshold=0.3).fp == 1
    (tmp_path / "config.toml").write_text("[classifier]\nscore_threshold = 0.3\n")
    assert evaluate_split(split, path).fp == 1  # that of the run, as the command has it
    (tmp_path / "config.toml").unlink()
    assert evaluate_split(split / "images" / "S00003", path).num_images == 3
    for image in split.rglob("*.png"):
        image.unlink()
    assert _same(evaluate_split(split, path), quality)
    (split / "labels/keypoints/000005.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"000005\.json: no such file, expected the keypoints of image 5"):
        evaluate_split(split, path)


@pytest.mark.filterwarnings("ignore:.* without predictions")
def test_points_that_no_box_can_find(tmp_path: Path) -> None:
    split, path = make_pvdn(tmp_path), tmp_path / "frames.jsonl"
    path.write_text('{"frame": 11, "proposals_xyxy_px": [[36, 29, 46, 33]], "scores": [0.9]}\n')
    keypoints = split / "labels" / "keypoints" / "000011.json"
    position = next(
        each["pos"] for vehicle in json.loads(keypoints.read_text())["annotations"] for each in vehicle["instances"]
    )
    keypoints.write_text(keypoints.read_text().replace(str(position), "[500, 20]"))
    with pytest.warns(UserWarning, match=r"frames\.jsonl: 1 key points of .* outside of their image"):
        evaluate_split(split, path)


@pytest.mark.filterwarnings("ignore:.* without predictions")
def test_boxes_beyond_the_image(tmp_path: Path) -> None:
    """One that reaches into it is not counted."""
    split, path = make_pvdn(tmp_path), tmp_path / "predictions.json"
    boxes = [[36, 29, 46, 33], [500, 20, 510, 30], [20, -9, 30, -1], [-5, -5, 3, 3]]
    path.write_text(json.dumps({"11": {"boxes": boxes, "scores": [0.9, 0.1, 0.9, 0.9]}}))
    with pytest.warns(UserWarning, match=r"predictions\.json: 2 boxes wholly beyond the image"):
        evaluate_split(split, path)
    done = foreglow_command("evaluate", split, "--predictions", path)
    assert "wholly beyond the image, as predictions for images of another size are: 2 boxes\n" in done.stdout


@pytest.mark.filterwarnings("ignore:.* without predictions")
@pytest.mark.parametrize("field", ["annotations", "instances"])
def test_points_that_are_there_several_times(tmp_path: Path, field: str) -> None:
    """A whole vehicle twice in its image, or one key point; one of the same instance elsewhere is another."""
    split, path = make_pvdn(tmp_path), tmp_path / "frames.jsonl"
    path.write_text('{"frame": 11, "proposals_xyxy_px": [[36, 29, 46, 33]], "scores": [0.9]}\n')
    keypoints = split / "labels" / "keypoints" / "000011.json"
    content = json.loads(keypoints.read_text())
    (vehicle,) = content["annotations"]
    lights = vehicle["instances"]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        before = evaluate_split(split, path)
    assert not any("there again" in str(each.message) for each in told)
    if field == "annotations":
        content["annotations"] = [vehicle, vehicle]
    else:
        vehicle["instances"] = [*lights, *lights, lights[0] | {"pos": [1, 1]}]
    keypoints.write_text(json.dumps(content))
    words = rf"frames\.jsonl: {len(lights)} key points of .* that are there again, same vehicle, instance and place, "
    with pytest.warns(UserWarning, match=words):
        after = evaluate_split(split, path)
    assert after.tp == 2 * before.tp > 0


@pytest.mark.filterwarnings("ignore:.* without predictions")
def test_boxes_that_are_there_several_times(tmp_path: Path) -> None:
    """Results that two tools had written into one file counted twice, without a word."""
    split, path = make_pvdn(tmp_path), tmp_path / "predictions.json"
    boxes = [[36, 29, 46, 33], [1, 1, 9, 9], [36, 29, 46, 33], [36, 29, 46, 33], [1, 1, 9, 8]]
    path.write_text(json.dumps({"11": {"boxes": boxes, "scores": [0.9, 0.8, 0.9, 0.7, 0.8]}}))
    with pytest.warns(
        UserWarning, match=r"predictions\.json: 2 boxes that are in their image again, at the same place"
    ):
        evaluate_split(split, path)
    done = foreglow_command("evaluate", split, "--predictions", path)
    assert "in the predictions again, same image and place, and counted again: 2 boxes\n" in done.stdout


def test_relative_coordinates_are_refused(tmp_path: Path) -> None:
    """They gave an F of 0."""
    split, path = make_pvdn(tmp_path), tmp_path / "predictions.json"
    path.write_text(json.dumps({"11": {"boxes": [[0.1, 0.2, 0.3, 0.4], [0.5, 0.5, 1, 1]], "scores": [0.9, 0.8]}}))
    expected = "predictions.json: expected boxes in pixels, got none beyond 1, as of coordinates relative to the image"
    with pytest.raises(ValueError, match=expected):
        evaluate_split(split, path)
    assert expected in complaint("evaluate", split, "--predictions", path)


def test_predictions_of_another_split_are_refused(tmp_path: Path) -> None:
    """The command refused them, and Python gave figures."""
    split, other = make_pvdn(tmp_path / "this"), make_pvdn(tmp_path / "other")
    path = tmp_path / "frames.jsonl"
    path.write_text('{"frame": 99, "proposals_xyxy_px": [[36, 29, 46, 33]], "scores": [0.9]}\n')
    with pytest.raises(ValueError, match=r"frames\.jsonl: expected boxes in images of .*, such as 99"):
        evaluate_split(split, path)
    image = next(other.rglob("*.png"))
    image.write_bytes(image.read_bytes() + b"longer")
    done = foreglow_command("run", split, "--preset", "paper", "--out", tmp_path / "run")
    assert done.exit_code == 0, done.output
    assert evaluate_split(split, tmp_path / "run" / "frames.jsonl").num_images == 5
    with pytest.raises(ValueError, match=r"expected the labels of what .* was made from, .*, got others"):
        evaluate_split(other, tmp_path / "run" / "frames.jsonl")
    image.unlink()
    with pytest.raises(ValueError, match=rf"got others; 1 of its 5 images is missing: {image}$"):
        evaluate_split(other, tmp_path / "run" / "frames.jsonl")


def test_the_splits_own_boxes(tmp_path: Path) -> None:
    quality = annotation_quality(make_pvdn(tmp_path))
    assert (quality.tp, quality.fp, quality.fn) == (2, 0, 1)
    assert (quality.precision, quality.q_k) == (1.0, 0.5)
