"""The metrics over all score thresholds at once, and the threshold for a given rate of false boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.boxes.matching import Matches
from foreglow.lab.evaluation.ratios import ratios


@dataclass(frozen=True, slots=True, eq=False)
class QualityCurve:
    """The metrics of `evaluate_boxes` by threshold. All arrays have shape (T,); NaN where nothing was to be rated.

    Attributes:
        thresholds: Ascending; a box counts if its score is above.
        precision: tp / (tp + fp).
        recall: tp / (tp + fn).
        f1: tp / (tp + (fp + fn) / 2).
        q: q_k * q_b.
        q_k: Mean over the boxes with a keypoint of 1 / keypoints in the box.
        q_b: Mean over the keypoints in a box of 1 / boxes around the keypoint.
        false_boxes_per_frame: fp / images.
    """

    thresholds: Floats
    precision: Floats
    recall: Floats
    f1: Floats
    q: Floats
    q_k: Floats
    q_b: Floats
    false_boxes_per_frame: Floats

    @property
    def best(self) -> tuple[float, float]:
        """The lowest threshold from 0 up with the highest F, and that F; both NaN where there is no keypoint."""
        can_be_set = self.thresholds >= 0  # a threshold below 0 counts boxes of score 0, and no command takes one
        thresholds, f1 = self.thresholds[can_be_set], self.f1[can_be_set]
        if np.isnan(self.recall).all():
            return math.nan, math.nan
        index = int(np.nanargmax(f1))
        return float(thresholds[index]), float(f1[index])

    @property
    def average_precision(self) -> float:
        """Area under precision over recall, where precision is the best one at this recall or a higher one.

        Recall is that of keypoints and precision mixes keypoints and boxes, as everywhere here; what no box holds
        counts as never found. NaN without keypoints.
        """
        if np.isnan(self.recall).any():
            return math.nan
        precision = np.nan_to_num(self.precision, nan=0.0)  # without any box that counts: recall is 0 there
        envelope = np.maximum.accumulate(precision)  # thresholds ascend, so recall falls
        return float(np.sum(-np.diff(self.recall, append=0.0) * envelope))


@dataclass(frozen=True, slots=True, eq=False)
class RecallCurve:
    """Recall of some keypoints over false boxes of some images. All arrays have shape (T,).

    Attributes:
        recall: Share of the keypoints in a box that counts; NaN without keypoints.
        false_boxes_per_frame: NaN without images.
    """

    thresholds: Floats
    recall: Floats
    false_boxes_per_frame: Floats

    def corners(self, num: int = 400) -> RecallCurve:
        """Of each recall the highest threshold, which has the fewest false boxes; if need be, `num` of them by rank.

        Nothing is lost by leaving out the others; by leaving out corners, some recall between those that are kept is.
        """
        corners = np.flatnonzero(np.append(self.recall[1:] != self.recall[:-1], True))
        if len(corners) > num:
            corners = corners[np.linspace(0, len(corners) - 1, num).astype(int)]
        return RecallCurve(self.thresholds[corners], self.recall[corners], self.false_boxes_per_frame[corners])


def quality_curve(matches: Matches, thresholds: Floats | None = None) -> QualityCurve:
    """The metrics at `thresholds`; None for all that make a difference: every score, and one below all.

    Sorted scores and running sums: as quick for ten thousand thresholds as for ten.

    Raises:
        ValueError: If the boxes have no scores.

    >>> from foreglow.lab.evaluation.boxes.matching import match_boxes
    >>> from foreglow.runs.predictions import Predictions
    >>> boxes = np.array([[0.0, 0, 9, 9], [20, 0, 29, 9]])
    >>> matches = match_boxes({1: np.array([[4, 4]])}, Predictions({1: boxes}, {1: np.array([0.8, 0.6])}))
    >>> quality_curve(matches, np.array([0.5, 0.7])).precision.tolist()
    [0.5, 1.0]
    """
    if not matches.is_scored:
        raise ValueError("quality_curve: expected boxes with scores, got boxes without")
    if thresholds is None:
        thresholds = distinct_thresholds(matches.scores)
    points_in_box = matches.points_in_box
    is_true = points_in_box > 0
    tp = num_above(matches.best_scores(), thresholds).astype(np.float64)
    fp = num_above(matches.scores[~is_true], thresholds).astype(np.float64)
    fn = matches.num_points - tp
    true_boxes = num_above(matches.scores[is_true], thresholds).astype(np.float64)
    q_k = ratios(_sum_above(matches.scores[is_true], 1.0 / points_in_box[is_true], thresholds), true_boxes)
    q_b = ratios(_sum_above(*_share_changes(matches), thresholds), tp)
    return QualityCurve(
        thresholds=thresholds,
        precision=ratios(tp, tp + fp),
        recall=ratios(tp, tp + fn),
        f1=ratios(tp, tp + 0.5 * (fp + fn)),
        q=q_k * q_b,
        q_k=q_k,
        q_b=q_b,
        false_boxes_per_frame=ratios(fp, matches.num_images),
    )


def recall_curve(best_scores: Floats, false_scores: Floats, num_images: int) -> RecallCurve:
    """Recall of some keypoints over the false boxes of some images, at all thresholds that make a difference.

    Args:
        best_scores: Shape (P,), of each keypoint the highest score of the boxes around it; -inf without any.
        false_scores: Shape (B,), the scores of the false boxes.
        num_images: How many images those are from.
    """
    thresholds = distinct_thresholds(np.concatenate([best_scores[np.isfinite(best_scores)], false_scores]))
    found = num_above(best_scores, thresholds).astype(np.float64)
    false = num_above(false_scores, thresholds).astype(np.float64)
    return RecallCurve(thresholds, ratios(found, len(best_scores)), ratios(false, num_images))


def threshold_at_false_boxes(false_scores: Floats, num_images: int, limit: float) -> float:
    """The lowest threshold from 0 up with at most `limit` false boxes a frame: as sensitive as that allows.

    Args:
        false_scores: Shape (B,), scores of the false boxes, from 0 to 1.
        num_images: How many images they are from.
        limit: False boxes a frame.

    Raises:
        ValueError: If there is no image, or the limit is negative or NaN.

    >>> threshold_at_false_boxes(np.array([0.9, 0.4, 0.7]), 10, 0.1)
    0.7
    """
    if num_images < 1:
        raise ValueError(f"num_images: expected at least one image, got {num_images}")
    if not limit >= 0:
        raise ValueError(f"limit: expected 0 or more false boxes a frame, got {limit}")
    num_allowed = math.floor(limit * num_images + 1e-9)  # 0.2 a frame of 15 images is 3, not 2
    if num_allowed >= len(false_scores):
        return 0.0
    return max(0.0, float(np.sort(false_scores)[::-1][num_allowed]))


def distinct_thresholds(scores: Floats) -> Floats:
    """Every score once, ascending, after one that is below all: one threshold for each set of boxes that can count."""
    distinct = np.unique(scores)
    below = 0.0 if not len(distinct) or distinct[0] > 0 else np.nextafter(distinct[0], -np.inf)
    return np.concatenate([[below], distinct])


def num_above(scores: Floats, thresholds: Floats) -> NDArray[np.intp]:
    """Shape (T,): how many of `scores` are above each threshold."""
    return np.asarray(len(scores) - np.searchsorted(np.sort(scores), thresholds, side="right"))


def _sum_above(scores: Floats, values: Floats, thresholds: Floats) -> Floats:
    """Shape (T,): the sum of the `values` whose score is above each threshold."""
    order = np.argsort(scores)
    from_here = np.concatenate([np.cumsum(values[order][::-1])[::-1], [0.0]])
    return np.asarray(from_here[np.searchsorted(scores[order], thresholds, side="right")])


def _share_changes(matches: Matches) -> tuple[Floats, Floats]:
    """At which scores the sum over the found keypoints of 1 / boxes around it changes, and by how much.

    As the threshold falls, the r-th box around a keypoint turns 1 / (r - 1) into 1 / r; the first one 0 into 1.
    """
    scores = matches.scores[matches.pair_box]
    order = np.lexsort((-scores, matches.pair_point))
    point = matches.pair_point[order]
    first = np.searchsorted(point, point)
    rank = np.arange(len(point)) - first + 1.0
    change: Floats = np.asarray(1.0 / rank, np.float64)
    change[rank > 1] -= 1.0 / (rank[rank > 1] - 1.0)
    return scores[order], change
