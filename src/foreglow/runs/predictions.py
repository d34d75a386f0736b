"""Predicted boxes from a file: a `frames.jsonl`, COCO's results, or the JSON of the published code, which is also
written here.
"""

from __future__ import annotations

import codecs
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, RootModel
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from foreglow.datasets.json_files import read_json
from foreglow.files import checked_path
from foreglow.geometry import Floats
from foreglow.runs.frame_line import Box, FrameLine, check_per_box
from foreglow.runs.frames_file import own_threshold, read_frame_lines
from foreglow.runs.json_lines import Whole, checked, no_run_file
from foreglow.types import LIGHT_KINDS
from foreglow.types.arrays import check_kind, check_numbers, checked_time_ns
from foreglow.types.kinds import checked_kinds
from foreglow.whole_files import write_atomic
from foreglow.wording import shortened


@dataclass(frozen=True, slots=True, eq=False)
class Predictions:
    """Predicted boxes by image.

    Attributes:
        boxes_xyxy_px: By image id, shape (N, 4), float64, columns x1, y1, x2, y2, full-frame pixels.
        scores: By image id, shape (N,), float64; 1 where nothing was scored.
        is_scored: False if the boxes came without scores: then all of them count, whatever the threshold.
        direct_probabilities: By image id, shape (N,), float64: that a box holds a lamp itself, NaN where unknown;
            images for which nothing is known are left out.
        light_kinds: By image id, shape (N, 4), float64, as in `Detections`, of images for which they are known.
        times_ns: By image id, the times of a run's frames; empty for what is of no run.

    Raises:
        ValueError: If a field is of another type or shape, an image id is no number, a box is not finite or ends before
            it begins, or a score or another probability is no number from 0 to 1, or kinds do not sum to 1.
    """

    boxes_xyxy_px: Mapping[int, NDArray[np.float64]]
    scores: Mapping[int, NDArray[np.float64]]
    is_scored: bool = True
    direct_probabilities: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    light_kinds: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)
    times_ns: Mapping[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("boxes_xyxy_px", "scores", "direct_probabilities", "light_kinds", "times_ns"):
            check_kind(f"Predictions.{name}", getattr(self, name), Mapping)
        if self.boxes_xyxy_px.keys() != self.scores.keys():
            raise ValueError("Predictions.scores: expected the same images as boxes_xyxy_px")
        check_image_ids("Predictions.boxes_xyxy_px", self.boxes_xyxy_px)
        for image_id, boxes in self.boxes_xyxy_px.items():
            name, scores = f"Predictions.boxes_xyxy_px: image {image_id}", self.scores[image_id]
            check_numbers(name, boxes, (None, 4))
            _check_order(boxes, f"{name}: ")
            name = f"Predictions.scores: image {image_id}"
            check_numbers(name, scores, (len(boxes),))
            _check_scores(scores, f"{name}: ")
        if not isinstance(self.is_scored, bool | np.bool_):
            raise ValueError(f"Predictions.is_scored: expected True or False, got {shortened(self.is_scored)}")
        check_image_ids("Predictions.times_ns", self.times_ns)
        for image_id, time_ns in self.times_ns.items():
            checked_time_ns(f"Predictions.times_ns: image {image_id}", time_ns)
        for image_id in self.direct_probabilities:
            self._check_beside("direct_probabilities", image_id, ())
        for image_id in self.light_kinds:
            self._check_beside("light_kinds", image_id, (len(LIGHT_KINDS),))

    def _check_beside(self, field: str, image_id: int, shape: tuple[int, ...]) -> None:
        """ValueError if what is known of the boxes of an image is not from 0 to 1, or NaN where unknown."""
        values, boxes = getattr(self, field)[image_id], self.boxes_xyxy_px.get(image_id)
        if boxes is None:
            raise ValueError(f"Predictions.{field}: expected images of boxes_xyxy_px, got {shortened(image_id)}")
        name = f"Predictions.{field}: image {image_id}"
        known = (
            np.where(np.isnan(values), 0.0, values)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f"
            else values
        )
        check_numbers(name, known, (len(boxes), *shape))
        if ((known < 0) | (known > 1)).any():
            raise ValueError(f"{name}: expected numbers from 0 to 1, got {known[(known < 0) | (known > 1)][0]}")
        if shape:
            checked_kinds(name, values.astype(np.float64), len(boxes), np.float64)


def check_image_ids(field: str, images: Mapping[int, object]) -> None:
    """Checks that the keys are numbers, as those of images are.

    Raises:
        ValueError: If one is not; the message begins with `field`.
    """
    for image_id in images:
        if not isinstance(image_id, int | np.integer) or isinstance(image_id, bool):
            raise ValueError(f"{field}: expected numbers of images, got {shortened(image_id)}")


def _check_order(boxes_xyxy_px: NDArray[Any], place: str) -> None:
    """ValueError for a box that ends before it begins."""
    is_inverted = (boxes_xyxy_px[:, :2] > boxes_xyxy_px[:, 2:]).any(axis=1)
    if is_inverted.any():
        bad = int(is_inverted.argmax())
        got = boxes_xyxy_px[bad].tolist()
        raise ValueError(f"{place}{bad}: expected x1, y1, x2, y2 with x1 <= x2 and y1 <= y2, got {got}")


def _check_scores(scores: NDArray[Any], place: str) -> None:
    """ValueError for one outside 0 to 1."""
    is_wrong = (scores < 0) | (scores > 1)
    if is_wrong.any():
        bad = int(is_wrong.argmax())
        raise ValueError(f"{place}{bad}: expected a number from 0 to 1, got {scores[bad]}")


@checked
class ScoredBoxes(TypedDict):
    """The boxes of one image in the published form."""

    boxes: list[Box]
    scores: list[float]


class _ScoredFile(RootModel[dict[str, ScoredBoxes]]):
    """The published form: boxes with scores, by image id."""


class _PlainFile(RootModel[dict[str, list[Box]]]):
    """The published form of boxes without scores, by image id."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _CocoBox(BaseModel):
    """An entry of COCO's results: x, y, width and height of a box."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    image_id: Annotated[Whole, Field(ge=0)]
    category_id: int | None = None
    bbox: Annotated[
        tuple[float, float, Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]], Field(strict=False)
    ]
    score: Annotated[float, Field(ge=0, le=1)]


class _CocoFile(RootModel[list[_CocoBox]]):
    """COCO's results: a box an entry, in any order."""


def _object_or_list(value: Any) -> Any:
    if not isinstance(value, dict | list):
        raise ValueError(f"expected an object by image id, or a list, got {shortened(value)}")
    return value


class _JsonFile(RootModel[Annotated[Any, AfterValidator(_object_or_list)]]):
    """Any of the three."""


def run_threshold(path: Path | str) -> float:
    """The threshold that the run accepted its boxes with; 0.5, as the paper's, for predictions that no run wrote.

    Raises:
        ValueError: If the run's configuration is broken.
    """
    threshold = own_threshold(checked_path(path, "predictions"))
    return 0.5 if threshold is None else threshold


def is_coco_results(path: Path) -> bool:
    """Whether the predictions in the file at `path` are COCO's results, whose ids of images are those of COCO's labels.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(1 << 10).removeprefix(codecs.BOM_UTF8)
    return path.suffix.lower() != ".jsonl" and head.lstrip().startswith(b"[")


def read_predictions(path: Path | str) -> Predictions:
    """The predictions in the file at `path`.

    A name ending in `.jsonl` holds one JSON object a line with `frame` (the image id), `proposals_xyxy_px` and
    `scores`, as `foreglow run` writes; `scores` may be null or absent in all lines, `direct` and `light_kinds` in any.
    Any other name holds one JSON object by image id, of `{"boxes": ..., "scores": ...}` or of plain lists of boxes, as
    the published code writes; or COCO's results, all of one category, a JSON list of
    `{"image_id": ..., "bbox": [x, y, width, height], "score": ...}`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form; the message names the line or the key, and the field.
    """
    path = checked_path(path, "predictions")
    if not path.exists():
        raise no_run_file(path, "predictions")
    return _from_lines(path) if path.suffix.lower() == ".jsonl" else _from_published(path)


def _from_lines(path: Path) -> Predictions:
    is_scored: bool | None = None

    def convert(line: FrameLine) -> tuple[Floats, Floats, Floats | None, Floats | None, int | None]:
        nonlocal is_scored
        scores, direct, kinds = line.get("scores"), line.get("direct"), line.get("light_kinds")
        if is_scored is None:
            is_scored = scores is not None
        elif is_scored != (scores is not None):
            raise ValueError("scores: expected in every line or in none, differs from the lines before")
        return (
            _as_boxes(line["proposals_xyxy_px"], "proposals_xyxy_px"),
            _as_scores(scores, len(line["proposals_xyxy_px"])),
            None if direct is None else np.array(direct, np.float64),
            None if kinds is None else _as_kinds(kinds),
            line.get("timestamp_ns"),
        )

    lines = read_frame_lines(path, convert)
    return Predictions(
        {image_id: boxes for image_id, (boxes, *_) in lines.items()},
        {image_id: scores for image_id, (_, scores, *_) in lines.items()},
        is_scored is not False,
        {image_id: direct for image_id, (_, _, direct, _, _) in lines.items() if direct is not None},
        {image_id: kinds for image_id, (*_, kinds, _) in lines.items() if kinds is not None},
        {image_id: time_ns for image_id, (*_, time_ns) in lines.items() if time_ns is not None},
    )


def _from_published(path: Path) -> Predictions:
    entries = read_json(path, _JsonFile).root
    if isinstance(entries, list):
        return _from_coco(path)
    is_scored = not entries or any(isinstance(entry, dict) for entry in entries.values())
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    pairs: dict[str, tuple[list[Box], list[float] | None]]
    if is_scored:
        scored = read_json(path, _ScoredFile).root
        pairs = {key: (entry["boxes"], entry["scores"]) for key, entry in scored.items()}
    else:
        pairs = {key: (entry, None) for key, entry in read_json(path, _PlainFile).root.items()}
    for key, (its_boxes, its_scores) in pairs.items():
        if not (key.isascii() and key.isdigit() and len(key) < 20):
            raise ValueError(f"{path}: {key!r}: expected an image id")
        if int(key) in boxes:
            raise ValueError(f"{path}: {key}: expected each image id once, {int(key)} is there twice")
        try:
            boxes[int(key)], scores[int(key)] = _as_boxes(its_boxes, "boxes"), _as_scores(its_scores, len(its_boxes))
        except ValueError as error:
            raise ValueError(f"{path}: {key}: {error}") from error
    return Predictions(boxes, scores, is_scored)


def _from_coco(path: Path) -> Predictions:
    found: dict[int, list[_CocoBox]] = {}
    first: int | None = None
    for index, entry in enumerate(read_json(path, _CocoFile).root):
        first = entry.category_id if index == 0 else first
        if entry.category_id != first:
            raise ValueError(
                f"{path}: {index}.category_id: expected boxes of one category, that of light, got "
                f"{shortened(entry.category_id)} after {shortened(first)}"
            )
        found.setdefault(entry.image_id, []).append(entry)
    corners = {
        image_id: [[x, y, x + width, y + height] for x, y, width, height in (entry.bbox for entry in entries)]
        for image_id, entries in found.items()
    }
    return Predictions(
        {image_id: np.array(boxes, np.float64) for image_id, boxes in corners.items()},
        {image_id: np.array([entry.score for entry in entries]) for image_id, entries in found.items()},
    )


def _as_boxes(boxes: list[Box], name: str) -> NDArray[np.float64]:
    """Shape (N, 4); ValueError for a box that ends before it begins."""
    corners = np.array(boxes, np.float64).reshape(-1, 4)
    _check_order(corners, f"{name}.")
    return corners


def _as_scores(values: Sequence[float] | None, num_boxes: int) -> NDArray[np.float64]:
    """Shape (N,); all 1 if there are no values at all; ValueError for one outside 0 to 1."""
    check_per_box(values, num_boxes, "scores")
    scores = np.ones(num_boxes) if values is None else np.array(values, np.float64)
    _check_scores(scores, "scores.")
    return scores


def _as_kinds(rows: Sequence[Sequence[float] | None]) -> NDArray[np.float64]:
    """Shape (N, 4), with NaN instead of None."""
    unknown = [math.nan] * len(LIGHT_KINDS)
    return np.array([unknown if row is None else row for row in rows]).reshape(-1, len(LIGHT_KINDS))


def write_predictions(path: Path | str, predictions: Predictions) -> None:
    """Writes `predictions` in the published form, whole or not at all; `read_predictions` reads them back equal.

    Raises:
        ValueError: If a number is not finite, or an argument is of another kind.
        OSError: If the file cannot be written.
    """
    path = checked_path(path)
    check_kind("predictions", predictions, Predictions)
    entries: dict[str, ScoredBoxes | list[Box]] = {}
    for image_id, boxes in predictions.boxes_xyxy_px.items():
        its_boxes, its_scores = boxes.tolist(), predictions.scores[image_id].tolist()
        entries[str(image_id)] = {"boxes": its_boxes, "scores": its_scores} if predictions.is_scored else its_boxes
    write_atomic(path, (json.dumps(entries, allow_nan=False) + "\n").encode())
