"""From keypoints to labelled boxes: which proposals hold a light artifact."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.matching import lies_in

Labels: TypeAlias = NDArray[np.int8]

POSITIVE, NEGATIVE, IGNORED = 1, 0, -1


def label_boxes(
    boxes_xyxy_px: NDArray[Any], keypoints_px: NDArray[Any], doubtful_px: NDArray[Any] | None = None
) -> Labels:
    """What each box is to a classifier: 1 with a keypoint in it, else -1 with a doubtful one in it, else 0.

    All four edges belong to a box, see `lies_in`.

    Args:
        boxes_xyxy_px: Shape (N, 4).
        keypoints_px: Shape (K, 2), columns x and y.
        doubtful_px: Shape (D, 2): light that is neither an instance nor a fault to find; None for none.

    Returns:
        Shape (N,), int8.

    >>> boxes = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [40, 0, 50, 10]])
    >>> label_boxes(boxes, np.array([[10, 10], [25, 5]]), np.array([[45, 5]])).tolist()
    [1, 1, -1]
    """
    labels = np.full(len(boxes_xyxy_px), NEGATIVE, np.int8)
    if doubtful_px is not None:
        labels[lies_in(doubtful_px, boxes_xyxy_px[:, None]).any(axis=1)] = IGNORED
    labels[lies_in(keypoints_px, boxes_xyxy_px[:, None]).any(axis=1)] = POSITIVE
    return labels
