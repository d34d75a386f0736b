"""The pictures of the report on detectors: where a row of the table does best, and where worst."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource
from foreglow.display.overlay import Measures, Picture, annotate
from foreglow.lab.evaluation import Predictions, SplitLabels, match_lights
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import Figure
from foreglow.lab.studies.detector.plan import THRESHOLD
from foreglow.lab.studies.detector.run import DetectorResults
from foreglow.types import Detections, Frame, FrameResult, Proposals

PICTURE_WIDTH_PX = 900
JPEG_QUALITY = 82
FOUND_BGR, MISSED_BGR = (120, 235, 90), (60, 60, 250)

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
        is_found: Shape (K,): whether it lies in an accepted box.
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

    def by_image(image_of: NDArray[np.intp], values: NDArray[Any]) -> NDArray[np.float64]:
        return np.bincount(image_of, values, minlength=matches.num_images).astype(np.float64)

    found = by_image(matches.image_of_point, is_found * weights)
    missed = by_image(matches.image_of_point, ~is_found * weights)
    false = by_image(matches.image_of_box, is_false)
    good = np.where(found > 0, found - missed - false, -np.inf)

    def chosen(merits: NDArray[np.float64], num: int, is_best: bool) -> Iterator[Choice]:
        scenes: set[int] = set()
        for index in np.argsort(-merits, kind="stable"):
            image_id = matches.image_ids[index]
            scene = labels.sequence_of[image_id]
            if len(scenes) == num or not merits[index] > 0:
                return
            if scene not in scenes:
                scenes.add(scene)
                lights = is_found[matches.image_of_point == index]
                num_found = int(lights.sum())
                yield Choice(row, image_id, is_best, num_found, len(lights) - num_found, int(false[index]))

    return (*chosen(good, NUM_BEST, True), *chosen(missed + false, NUM_WORST, False))


def pictures(results: DetectorResults, dataset: LabelledSource) -> Iterator[Shown]:
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


def figure(shown: Shown) -> Figure:
    """The drawn image, with what is found in it, and what is not, in words."""
    choice = shown.choice
    words = f"{choice.num_found} found, {choice.num_missed} missed, {choice.num_false} false"
    mark = "works" if choice.is_best else "does not"
    data = jpeg(draw(shown), PICTURE_WIDTH_PX, JPEG_QUALITY)
    return Figure(data, f"{mark}: {shown.frame.sequence}, image {choice.image_id}: {words}")


def draw(shown: Shown) -> Picture:
    """The brightened image with its accepted boxes, and a mark at every labelled light: green if found, red if not."""
    measures = Measures.of(shown.frame.width_px, shown.frame.height_px)
    picture = annotate(shown.frame, shown.result)[: shown.frame.height_px * measures.enlargement]  # without its caption
    for (x, y), is_found in zip(shown.lights_px.tolist(), shown.is_found.tolist(), strict=True):
        centre = (round((x + 0.5) * measures.enlargement), round((y + 0.5) * measures.enlargement))
        if is_found:
            cv2.circle(picture, centre, 3 * measures.bold_px, FOUND_BGR, measures.thin_px, cv2.LINE_AA)
        else:
            size_px = 9 * measures.bold_px
            cv2.drawMarker(picture, centre, MISSED_BGR, cv2.MARKER_TILTED_CROSS, size_px, measures.bold_px, cv2.LINE_AA)
    return picture


def _result(frame: Frame, boxes_xyxy_px: NDArray[np.float64], scores: NDArray[np.float64]) -> FrameResult:
    """Boxes as a pipeline would have given them: whole pixels, at least one wide and high."""
    corners = np.rint(boxes_xyxy_px).astype(np.int32)
    corners[:, 2:] = np.maximum(corners[:, 2:], corners[:, :2] + 1)
    proposals = Proposals(corners)
    found = np.clip(scores, 0.0, 1.0).astype(np.float32)
    return FrameResult(frame.frame, frame.timestamp_ns, proposals, Detections(proposals, found, 0.0))
