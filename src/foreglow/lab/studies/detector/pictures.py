"""Which images of an experiment are worth showing: where a row of the table does best, and where worst."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import PVDN
from foreglow.lab.evaluation import Predictions, SplitLabels, match_lights
from foreglow.lab.studies.detector.plan import THRESHOLD
from foreglow.lab.studies.detector.run import DetectorResults
from foreglow.types import Detections, Frame, FrameResult, Proposals

NUM_BEST, NUM_WORST = 2, 3
HIDDEN_WEIGHT = 3.0
"""How much more a light counts whose vehicle has not shown a lamp so far: finding it is what this is about."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One image of one row.

    Attributes:
        row: Name of the row.
        image_id: The image.
        is_best: Whether it shows what works, rather than what does not.
        num_found: Lights in an accepted box.
        num_missed: Lights in none.
        num_false: Accepted boxes without a light.
    """

    row: str
    image_id: int
    is_best: bool
    num_found: int
    num_missed: int
    num_false: int


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A chosen image with what is to be drawn on it.

    Attributes:
        choice: What it stands for.
        frame: The image.
        result: Its accepted boxes, with scores.
        lights_px: Shape (K, 2): labelled lights.
        is_found: Shape (K,): whether one lies in an accepted box.
    """

    choice: Choice
    frame: Frame
    result: FrameResult
    lights_px: NDArray[np.float64]
    is_found: NDArray[np.bool_]


def choose(row: str, labels: SplitLabels, predictions: Predictions) -> tuple[Choice, ...]:
    """The best and the worst images of a row, best first, at most one of a scene each.

    The best have the most found lights less missed ones and false boxes, hidden vehicles' light counted three times;
    the worst the most missed lights and false boxes. Of equals, the first image.
    """
    matched = match_lights(labels, predictions)
    matches = matched.matches
    is_found = matched.best_scores > THRESHOLD
    weights = np.where(matched.is_hidden, HIDDEN_WEIGHT, 1.0)
    is_false = (matches.scores > THRESHOLD) & ~matches.has_point & ~matched.has_doubtful

    def of_images(places: NDArray[np.intp], values: NDArray[Any]) -> NDArray[np.float64]:
        return np.bincount(places, values, minlength=matches.num_images).astype(np.float64)

    found = of_images(matches.image_of_point, is_found * weights)
    missed = of_images(matches.image_of_point, ~is_found * weights)
    false = of_images(matches.image_of_box, is_false)
    good = np.where(found > 0, found - missed - false, -np.inf)

    def chosen(merits: NDArray[np.float64], num: int, is_best: bool) -> Iterator[Choice]:
        scenes: set[int] = set()
        for place in np.argsort(-merits, kind="stable"):
            image_id = matches.image_ids[place]
            scene = labels.sequence_of[image_id]
            if len(scenes) == num or not merits[place] > 0:
                return
            if scene not in scenes:
                scenes.add(scene)
                lights = is_found[matches.image_of_point == place]
                num_found = int(lights.sum())
                yield Choice(row, image_id, is_best, num_found, len(lights) - num_found, int(false[place]))

    return (*chosen(good, NUM_BEST, True), *chosen(missed + false, NUM_WORST, False))


def pictures(results: DetectorResults, dataset: PVDN) -> Iterator[Shown]:
    """The images to show of every row that was made, in the table's order.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If one is broken.
    """
    for row, predictions in results.predictions.items():
        for choice in choose(row, results.labels, predictions):
            frame = dataset.read(choice.image_id)
            scores = predictions.scores[choice.image_id]
            is_accepted = scores > THRESHOLD
            boxes = predictions.boxes_xyxy_px[choice.image_id][is_accepted]
            lights = results.labels.keypoints_px[choice.image_id].reshape(-1, 1, 2)
            is_inside = np.logical_and(boxes[:, :2] <= lights, lights <= boxes[:, 2:]).all(axis=2)
            result = _result(frame, boxes, scores[is_accepted])
            yield Shown(choice, frame, result, lights[:, 0], np.asarray(np.any(is_inside, axis=1)))


def _result(frame: Frame, boxes_xyxy_px: NDArray[np.float64], scores: NDArray[np.float64]) -> FrameResult:
    """Boxes as a pipeline would have given them: whole pixels, at least one wide and high."""
    corners = np.rint(boxes_xyxy_px).astype(np.int32)
    corners[:, 2:] = np.maximum(corners[:, 2:], corners[:, :2] + 1)
    proposals = Proposals(corners)
    found = np.clip(scores, 0.0, 1.0).astype(np.float32)
    return FrameResult(frame.frame, frame.timestamp_ns, proposals, Detections(proposals, found, 0.0))
