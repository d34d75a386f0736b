"""Predicted boxes from a file: the program's own `frames.jsonl`, or the published code's JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, RootModel

from foreglow.datasets.json_files import Record, parse_json
from foreglow.files import write_atomic

Number: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
_Box: TypeAlias = tuple[Number, Number, Number, Number]


@dataclass(frozen=True, slots=True, eq=False)
class Predictions:
    """Predicted boxes by image.

    Attributes:
        boxes_xyxy_px: By image id, shape (N, 4), float64, columns x1, y1, x2, y2, full-frame pixels.
        scores: By image id, shape (N,), float64; 1 where nothing was scored.
        is_scored: False if the boxes came without scores: then every one counts, whatever the threshold.
        direct_probabilities: By image id, shape (N,), float64: that a box holds a lamp itself, NaN where unknown; no
            images where nothing says so.
    """

    boxes_xyxy_px: Mapping[int, NDArray[np.float64]]
    scores: Mapping[int, NDArray[np.float64]]
    is_scored: bool = True
    direct_probabilities: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.boxes_xyxy_px.keys() != self.scores.keys():
            raise ValueError("Predictions.scores: expected the same images as boxes_xyxy_px")
        for image_id, boxes in self.boxes_xyxy_px.items():
            if boxes.ndim != 2 or boxes.shape[1] != 4:
                raise ValueError(
                    f"Predictions.boxes_xyxy_px: image {image_id}: expected shape (N, 4), got {boxes.shape}"
                )
            if self.scores[image_id].shape != (len(boxes),):
                raise ValueError(
                    f"Predictions.scores: image {image_id}: expected shape ({len(boxes)},), "
                    f"got {self.scores[image_id].shape}"
                )


class FrameLine(Record):
    """A line of `frames.jsonl`; those who read it add the fields that matter to them."""

    frame: int


class _FrameLine(FrameLine):
    proposals_xyxy_px: tuple[_Box, ...]
    scores: tuple[Number, ...] | None = None
    direct: tuple[Number | None, ...] | None = None


class _ScoredBoxes(Record):
    boxes: tuple[_Box, ...]
    scores: tuple[Number, ...]


class _PublishedFile(RootModel[dict[str, Any]]):
    """By image id: either boxes with scores, or plain boxes."""


class _ScoredFile(RootModel[dict[str, _ScoredBoxes]]):
    model_config = ConfigDict(strict=True)


class _PlainFile(RootModel[dict[str, tuple[_Box, ...]]]):
    model_config = ConfigDict(strict=True)


def read_predictions(path: Path | str) -> Predictions:
    """The predictions in the file at `path`.

    A name ending in `.jsonl` holds one JSON object a line with `frame` (the image id), `proposals_xyxy_px` and
    `scores`, as `foreglow run` writes; `scores` may be null or absent in all lines, and `direct` in any line. Any
    other name holds one JSON object by image id, of `{"boxes": ..., "scores": ...}` or of plain lists of boxes, as the
    published code writes.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form; the message names the line or the key, and the field.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file, expected predictions")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    return _from_lines(data, path) if path.suffix.lower() == ".jsonl" else _from_object(data, path)


Line = TypeVar("Line", bound=FrameLine)


def frame_lines(data: bytes, model: type[Line], path: Path) -> Iterator[tuple[str, Line]]:
    """The lines of a `frames.jsonl` with where each is, for messages; empty ones are passed over.

    Raises:
        ValueError: If a line is not of that form, or a frame is there twice.
    """
    seen: set[int] = set()
    for number, line in enumerate(data.splitlines(), start=1):
        if not line.strip():
            continue
        origin = f"{path}: line {number}"
        parsed = parse_json(line, model, origin)
        if parsed.frame in seen:
            raise ValueError(f"{origin}: frame: expected each frame once, {parsed.frame} is there twice")
        seen.add(parsed.frame)
        yield origin, parsed


def _from_lines(data: bytes, path: Path) -> Predictions:
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    direct: dict[int, NDArray[np.float64]] = {}
    is_scored: bool | None = None
    for origin, parsed in frame_lines(data, _FrameLine, path):
        if is_scored is None:
            is_scored = parsed.scores is not None
        elif is_scored != (parsed.scores is not None):
            raise ValueError(f"{origin}: scores: expected in every line or in none, differs from the lines before")
        boxes[parsed.frame] = _as_boxes(parsed.proposals_xyxy_px)
        scores[parsed.frame] = _as_scores(parsed.scores, len(parsed.proposals_xyxy_px), origin)
        if parsed.direct is not None:
            direct[parsed.frame] = _as_scores(parsed.direct, len(parsed.proposals_xyxy_px), origin, "direct")
    return Predictions(boxes, scores, is_scored is not False, direct)


def _from_object(data: bytes, path: Path) -> Predictions:
    entries = parse_json(data, _PublishedFile, str(path)).root
    is_scored = not entries or any(isinstance(entry, dict) for entry in entries.values())
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    pairs: list[tuple[str, tuple[_Box, ...], tuple[float, ...] | None]]
    if is_scored:
        scored = parse_json(data, _ScoredFile, str(path)).root
        pairs = [(key, entry.boxes, entry.scores) for key, entry in scored.items()]
    else:
        plain = parse_json(data, _PlainFile, str(path)).root
        pairs = [(key, entry, None) for key, entry in plain.items()]
    for key, its_boxes, its_scores in pairs:
        if not (key.isascii() and key.isdigit() and len(key) < 20):
            raise ValueError(f"{path}: {key!r}: expected an image id")
        if int(key) in boxes:
            raise ValueError(f"{path}: {key}: expected each image id once, {int(key)} is there twice")
        boxes[int(key)] = _as_boxes(its_boxes)
        scores[int(key)] = _as_scores(its_scores, len(its_boxes), f"{path}: {key}")
    return Predictions(boxes, scores, is_scored)


def _as_boxes(boxes: tuple[_Box, ...]) -> NDArray[np.float64]:
    return np.array(boxes, np.float64).reshape(-1, 4)


def _as_scores(
    scores: tuple[float | None, ...] | None, num_boxes: int, origin: str, name: str = "scores"
) -> NDArray[np.float64]:
    """Shape (N,), NaN for a box without; all 1 where there are none at all."""
    if scores is None:
        return np.ones(num_boxes)
    if len(scores) != num_boxes:
        raise ValueError(f"{origin}: {name}: expected {num_boxes}, one a box, got {len(scores)}")
    return np.array(scores, np.float64)


def write_predictions(path: Path, predictions: Predictions) -> None:
    """Writes `predictions` in the published form, whole or not at all; `read_predictions` reads them back equal.

    Raises:
        ValueError: If a number is not finite.
        OSError: If the file cannot be written.
    """
    entries: dict[str, Any] = {}
    for image_id, boxes in predictions.boxes_xyxy_px.items():
        its_boxes, its_scores = boxes.tolist(), predictions.scores[image_id].tolist()
        entries[str(image_id)] = {"boxes": its_boxes, "scores": its_scores} if predictions.is_scored else its_boxes
    write_atomic(path, (json.dumps(entries, allow_nan=False) + "\n").encode())
