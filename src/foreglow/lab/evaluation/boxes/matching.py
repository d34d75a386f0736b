"""Which points of an image lie in which boxes: what every figure of the evaluation is counted from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.runs.predictions import Predictions, check_image_ids
from foreglow.types.arrays import check_kind, check_numbers

NEVER = -np.inf
"""Score of what no box holds: below every threshold."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """All points and all boxes of a set of images, one after another, and which point lies in which box.

    Point p is in image `image_ids[image_of_point[p]]`, box b in `image_ids[image_of_box[b]]`; pair m says that point
    `pair_point[m]` lies in box `pair_box[m]`. There is no assignment: a box may hold several points, and a point may
    lie in several boxes.

    Attributes:
        image_ids: The images with ground truth, in the given order.
        image_of_point: Shape (P,), index into `image_ids`.
        image_of_box: Shape (B,), index into `image_ids`.
        scores: Shape (B,), float64; a box counts if its score is above a threshold. Infinite without scores.
        pair_point: Shape (M,).
        pair_box: Shape (M,).
    """

    image_ids: tuple[int, ...]
    image_of_point: NDArray[np.intp]
    image_of_box: NDArray[np.intp]
    scores: NDArray[np.float64]
    pair_point: NDArray[np.intp]
    pair_box: NDArray[np.intp]

    @property
    def num_images(self) -> int:
        """Images with ground truth."""
        return len(self.image_ids)

    @property
    def num_points(self) -> int:
        """Points, over all images."""
        return len(self.image_of_point)

    @property
    def num_boxes(self) -> int:
        """Boxes, over all images, whatever their score."""
        return len(self.scores)

    @property
    def is_scored(self) -> bool:
        """Whether the boxes have scores that a threshold can divide."""
        return not np.isposinf(self.scores).any()

    @property
    def points_in_box(self) -> NDArray[np.intp]:
        """Shape (B,): n_K, how many points each box holds."""
        return np.bincount(self.pair_box, minlength=self.num_boxes)

    @property
    def has_point(self) -> NDArray[np.bool_]:
        """Shape (B,): whether the box holds a point."""
        return np.asarray(self.points_in_box > 0)

    def boxes_around_point(self, threshold: float = NEVER) -> NDArray[np.intp]:
        """Shape (P,): n_B, how many boxes with a score above `threshold` each point lies in."""
        is_counted = self.scores[self.pair_box] > threshold
        return np.bincount(self.pair_point[is_counted], minlength=self.num_points)

    def best_scores(self) -> NDArray[np.float64]:
        """Shape (P,): the highest score of the boxes around each point; -inf where there is none.

        A point is found at a threshold if this is above it, and within reach of any threshold if this is finite.
        """
        best = np.full(self.num_points, NEVER)
        np.maximum.at(best, self.pair_point, self.scores[self.pair_box])
        return best


def lies_in(points_px: NDArray[Any], boxes_xyxy_px: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether points lie in boxes: x1 <= x <= x2 and y1 <= y <= y2, all four edges included, as in the published code.

    Args:
        points_px: Shape (..., 2), columns x and y.
        boxes_xyxy_px: Shape (..., 4); leading axes are broadcast against those of the points.

    >>> boxes = np.array([[0, 0, 10, 10], [20, 0, 30, 10]])
    >>> lies_in(np.array([[10, 10], [25, 5]])[:, None], boxes).tolist()
    [[True, False], [False, True]]
    """
    x, y = points_px[..., 0], points_px[..., 1]
    x1, y1, x2, y2 = (boxes_xyxy_px[..., column] for column in range(4))
    return np.asarray((x1 <= x) & (x <= x2) & (y1 <= y) & (y <= y2))


def smallest_box(position_px: Sequence[float] | NDArray[Any], boxes_xyxy_px: NDArray[Any]) -> int | None:
    """Index of the smallest of the boxes that hold the point, the first of equals; None if none does.

    >>> smallest_box((5.0, 5.0), np.array([[0, 0, 9, 9], [4, 4, 6, 6]], np.int32))
    1
    """
    holding = np.flatnonzero(lies_in(np.array(position_px), boxes_xyxy_px))
    if not len(holding):
        return None
    sizes_px = boxes_xyxy_px[holding, 2:] - boxes_xyxy_px[holding, :2]
    return int(holding[sizes_px.prod(axis=1).argmin()])


def match_boxes(points_px: Mapping[int, NDArray[Any]], predictions: Predictions) -> Matches:
    """Which of `points_px` lie in which boxes of `predictions`.

    All four edges belong to a box, see `lies_in`, although boxes are half-open elsewhere. Images of the predictions
    without an entry in `points_px` are left out; images that the predictions do not mention have no boxes.

    Args:
        points_px: By image id, shape (K, 2), columns x and y, full-frame pixels; K = 0 where there is nothing.
        predictions: Boxes and scores by image id.

    Raises:
        ValueError: If the points have another shape or are not finite, or an argument is of another type.

    >>> predictions = Predictions({7: np.array([[5.0, 5, 10, 10]])}, {7: np.ones(1)})
    >>> matches = match_boxes({7: np.array([[10, 10]])}, predictions)
    >>> matches.pair_point.tolist(), matches.pair_box.tolist()
    ([0], [0])
    """
    check_kind("predictions", predictions, Predictions)
    check_kind("keypoints_px", points_px, Mapping)
    check_image_ids("keypoints_px", points_px)
    points, boxes, scores = [np.empty((0, 2))], [np.empty((0, 4))], [np.empty(0)]
    for image_id, its_points in points_px.items():
        check_numbers(f"keypoints_px: image {image_id}", its_points, (None, 2))
        its_boxes = predictions.boxes_xyxy_px.get(image_id, boxes[0])
        points.append(np.asarray(its_points, np.float64))
        boxes.append(its_boxes)
        scores.append(predictions.scores.get(image_id, scores[0]))
    num_points = np.array([*map(len, points[1:])], np.intp)
    num_boxes = np.array([*map(len, boxes[1:])], np.intp)
    image_of_point = np.repeat(np.arange(len(num_points)), num_points)
    image_of_box = np.repeat(np.arange(len(num_boxes)), num_boxes)
    all_scores = np.concatenate(scores)
    pair_point, pair_box = _pairs(np.concatenate(points), num_points, np.concatenate(boxes), image_of_box)
    return Matches(
        image_ids=tuple(points_px),
        image_of_point=image_of_point,
        image_of_box=image_of_box,
        scores=all_scores if predictions.is_scored else np.full(len(all_scores), np.inf),
        pair_point=pair_point,
        pair_box=pair_box,
    )


def _pairs(
    points: NDArray[np.float64],
    num_points: NDArray[np.intp],
    boxes: NDArray[np.float64],
    image_of_box: NDArray[np.intp],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Index of the point and of the box of every point that lies in a box of its image."""
    # Every box meets every point of its image: pair p joins pair_box[p] and pair_point[p].
    num_partners = num_points[image_of_box]
    pair_box = np.repeat(np.arange(len(boxes)), num_partners)
    first_point = (np.cumsum(num_points) - num_points)[image_of_box]
    first_pair = np.cumsum(num_partners) - num_partners
    pair_point = np.arange(len(pair_box)) - np.repeat(first_pair - first_point, num_partners)
    is_inside = lies_in(points[pair_point], boxes[pair_box])
    return pair_point[is_inside], pair_box[is_inside]
