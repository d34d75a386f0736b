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


def with_jumps(assigned: Assignment, tracks_cxcywh: Floats, boxes_cxcywh: Floats, reach: float) -> Assignment:
    """`assigned`, where tracks without a detection take detections without a track that are near.

    Near means that the offset of the centres, in mean widths and heights of the two boxes, is at most `reach`; the
    nearest pairs go first. Light that runs along a guard rail jumps by its own width and changes its size, so that
    boxes need not overlap.

    Args:
        assigned: Shape (M,), as every assignment.
        tracks_cxcywh: Shape (M, 4), predicted centres and sizes.
        boxes_cxcywh: Shape (N, 4), centres and sizes of the detections.
        reach: Greatest offset.

    >>> boxes = np.array([[0.0, 0, 4, 4], [50, 0, 4, 4]])
    >>> with_jumps(np.array([-1, -1]), boxes, np.array([[6.0, 0, 2, 2], [90, 0, 2, 2]]), 2.5).tolist()
    [0, -1]
    """
    free_tracks = np.flatnonzero(assigned == UNASSIGNED)
    free_boxes = np.setdiff1d(np.arange(len(boxes_cxcywh)), assigned)
    if not (len(free_tracks) and len(free_boxes)):
        return assigned
    tracks, boxes = tracks_cxcywh[free_tracks, np.newaxis], boxes_cxcywh[free_boxes]
    offsets = 2.0 * (tracks[..., :2] - boxes[:, :2]) / (tracks[..., 2:4] + boxes[:, 2:4])
    distances = np.hypot(offsets[..., 0], offsets[..., 1])
    assigned = assigned.copy()
    for index in np.argsort(distances, axis=None, kind="stable")[: np.count_nonzero(distances <= reach)]:
        track, box = divmod(int(index), len(free_boxes))
        if assigned[free_tracks[track]] == UNASSIGNED and free_boxes[box] not in assigned:
            assigned[free_tracks[track]] = free_boxes[box]
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
