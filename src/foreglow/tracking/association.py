"""Which detection belongs to which track: overlaps, the range gate, and two assignment rules.

Overlaps are matrices of shape (M, N), tracks by detections. An assignment is an array of shape (M,): for each track
the index of its detection, or -1; no detection is assigned twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from foreglow.geometry import Floats

Assignment: TypeAlias = NDArray[np.int64]

UNASSIGNED = -1


def corners(boxes_cxcywh: Floats, enlargement: float = 1.0) -> Floats:
    """Boxes as x1, y1, x2, y2, shape (N, 4), from centre and size, scaled about the centre by `enlargement`."""
    halves = boxes_cxcywh[:, 2:4] * (enlargement / 2.0)
    centres = boxes_cxcywh[:, :2]
    return np.concatenate([centres - halves, centres + halves], axis=1)


def centres_and_sizes(boxes_xyxy: NDArray[np.float64]) -> Floats:
    """Boxes as centre x, y, width, height, shape (N, 4)."""
    low, high = boxes_xyxy[:, :2], boxes_xyxy[:, 2:]
    return np.concatenate([(low + high) / 2.0, high - low], axis=1)


def overlaps(boxes_xyxy: Floats, others_xyxy: Floats) -> Floats:
    """Intersection over union of every box with every other box, shape (M, N), in [0, 1]; areas are positive.

    >>> overlaps(np.array([[0.0, 0, 2, 2]]), np.array([[0.0, 0, 2, 2], [1, 0, 3, 2], [2, 0, 4, 2]])).round(3).tolist()
    [[1.0, 0.333, 0.0]]
    """
    rows, columns = boxes_xyxy[:, None], others_xyxy[None]
    extents = np.minimum(rows[..., 2:], columns[..., 2:]) - np.maximum(rows[..., :2], columns[..., :2])
    np.maximum(extents, 0.0, out=extents)
    intersections = extents[..., 0] * extents[..., 1]
    areas = [(boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]) for boxes in (boxes_xyxy, others_xyxy)]
    return np.asarray(intersections / (areas[0][:, None] + areas[1] - intersections))


def is_range_apart(ranges_m: tuple[Floats, Floats], sigmas_m: tuple[Floats, Floats], gate: float) -> NDArray[np.bool_]:
    """Shape (M, N): which ranges differ by more than `gate` combined standard deviations; False where one is unknown.

    Args:
        ranges_m: Ranges of the tracks, shape (M,), and of the detections, shape (N,); NaN where unknown.
        sigmas_m: Their standard deviations; infinite or NaN where unknown.
        gate: Number of standard deviations.
    """
    limits_m = gate * np.hypot(sigmas_m[0][:, None], sigmas_m[1])
    return np.asarray(np.abs(ranges_m[0][:, None] - ranges_m[1]) > limits_m)


def assign_greatest(overlap: Floats, min_overlap: float) -> Assignment:
    """Each detection takes the track that it overlaps most; a track wanted by several goes to the greatest overlap.

    The other detections are left without a track. Ties go to the first track and the first detection.

    Source: Ewecker et al., arXiv 2107.11302; the paper does not say which detection wins a track.

    >>> assign_greatest(np.array([[0.6, 0.5], [0.0, 0.4]]), 0.1).tolist()  # the second detection wants the first track
    [0, -1]
    """
    num_detections = overlap.shape[1]
    wanted = overlap.argmax(axis=0)
    claims = np.zeros_like(overlap)
    claims[wanted, np.arange(num_detections)] = overlap[wanted, np.arange(num_detections)]
    return np.where(claims.max(axis=1) > min_overlap, claims.argmax(axis=1), UNASSIGNED)


def assign_optimal(overlap: Floats, min_overlap: float) -> Assignment:
    """The assignment with the greatest sum of overlaps, counting only overlaps above `min_overlap`.

    >>> assign_optimal(np.array([[0.6, 0.5], [0.4, 0.0]]), 0.1).tolist()
    [1, 0]
    """
    allowed = np.where(overlap > min_overlap, overlap, 0.0)
    rows, columns = linear_sum_assignment(allowed, maximize=True)
    assigned = np.full(len(overlap), UNASSIGNED, np.int64)
    assigned[rows] = np.where(allowed[rows, columns] > 0.0, columns, UNASSIGNED)
    return assigned


ASSOCIATIONS: Mapping[str, Callable[[Floats, float], Assignment]] = MappingProxyType(
    {"greatest_iou": assign_greatest, "optimal": assign_optimal}
)
"""All assignment rules by name."""


def is_duplicate(
    overlap: Floats, is_detected: NDArray[np.bool_], num_hits: NDArray[np.int64], max_overlap: float
) -> NDArray[np.bool_]:
    """Which tracks, shape (M,), follow an object that another track follows as well.

    Two tracks that overlap by more than `max_overlap` follow one object unless both were detected in this frame: then
    the detector sees two objects. The duplicate is the track with fewer hits, or the later one if they have the same.

    Args:
        overlap: Shape (M, M), of the tracks with each other.
        is_detected: Shape (M,), in this frame.
        num_hits: Shape (M,), detections of each track so far.
        max_overlap: Largest overlap of two separate objects.
    """
    order = np.arange(len(num_hits))
    is_weaker = (num_hits[:, None] < num_hits) | ((num_hits[:, None] == num_hits) & (order[:, None] > order))
    is_both = is_detected[:, None] & is_detected
    return np.asarray(((overlap > max_overlap) & is_weaker & ~is_both).any(axis=1))
