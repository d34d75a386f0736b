"""From keypoints to labelled boxes: which proposals hold a light artifact."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource
from foreglow.lab.evaluation.boxes.matching import lies_in

Labels: TypeAlias = NDArray[np.int8]

POSITIVE, NEGATIVE, IGNORED = 1, 0, -1


def label_boxes(
    boxes_xyxy_px: NDArray[Any], keypoints_px: NDArray[Any], doubtful_px: NDArray[Any] | None = None
) -> Labels:
    """Label of each box for a classifier: 1 with a key point in it, else -1 with a doubtful one in it, else 0.

    All four edges belong to a box, see `lies_in`.

    Args:
        boxes_xyxy_px: Shape (N, 4).
        keypoints_px: Shape (K, 2), columns x and y.
        doubtful_px: Shape (D, 2): light that counts neither as an instance nor as a false detection.

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


def label_image(dataset: LabelledSource, image_id: int, boxes_xyxy_px: NDArray[Any]) -> Labels:
    """Label of each box of an image, shape (N,), by the data set's key points and doubtful light; see `label_boxes`.

    Raises:
        FileNotFoundError: If the image has no file of key points.
        ValueError: If that file is broken.
    """
    doubtful_px = np.array([light.position_px for light in dataset.doubtful(image_id)], np.int32).reshape(-1, 2)
    return label_boxes(boxes_xyxy_px, dataset.keypoints_px(image_id), doubtful_px)
