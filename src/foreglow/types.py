"""The values that flow through the pipeline: Frame -> Proposals -> Detections, and the FrameResult that keeps them.

Every type is frozen and checked once, when it is made. Arrays are plural, boxes are half-open
`xyxy` in full-frame pixels (x = column to the right, y = row downwards), and no array may be written to afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, shape (height, width), uint8 or uint16, linear index (row, column)."""

Boxes: TypeAlias = NDArray[np.int32]
"""Boxes, shape (N, 4), int32, columns x1, y1, x2, y2 in full-frame pixels, half-open."""


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of `array`; the owner's own flag stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One grey camera image and when it was taken.

    Attributes:
        image: Shape (height, width), uint8 or uint16, at least 1x1; any strides.
        timestamp_ns: Time of exposure in nanoseconds; the zero is the source's own.
        frame: Number that identifies the image in its source (PVDN: the image id; else its index from 0).
        sequence: Name of the sequence, empty where the source has none.
        path: Where the image came from, for messages; empty for an array in memory.

    Raises:
        ValueError: If the image is not two-dimensional, is empty, or is neither uint8 nor uint16.
    """

    image: Image
    timestamp_ns: int
    frame: int = 0
    sequence: str = ""
    path: str = ""

    def __post_init__(self) -> None:
        origin = f"{self.path}: " if self.path else ""
        if not isinstance(self.image, np.ndarray) or self.image.ndim != 2:
            shape = getattr(self.image, "shape", type(self.image).__name__)
            raise ValueError(f"{origin}Frame.image: expected a grey array of shape (height, width), got {shape}")
        if self.image.dtype not in (np.uint8, np.uint16):
            raise ValueError(f"{origin}Frame.image: expected uint8 or uint16, got {self.image.dtype}")
        if self.image.size == 0:
            raise ValueError(f"{origin}Frame.image: expected at least one pixel, got shape {self.image.shape}")
        object.__setattr__(self, "image", _frozen(self.image))

    @property
    def width_px(self) -> int:
        """Number of columns."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return int(self.image.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Boxes that may hold a light artifact, sorted by y1, x1, y2, x2.

    Attributes:
        boxes_xyxy_px: Shape (N, 4), int32, half-open, full-frame pixels; N = 0 means that nothing stands out.

    Raises:
        ValueError: If the shape, the dtype or a box's order of corners is wrong.
    """

    boxes_xyxy_px: Boxes

    def __post_init__(self) -> None:
        boxes = self.boxes_xyxy_px
        if boxes.ndim != 2 or boxes.shape[1] != 4:
            raise ValueError(f"Proposals.boxes_xyxy_px: expected shape (N, 4), got {boxes.shape}")
        if boxes.dtype != np.int32:
            raise ValueError(f"Proposals.boxes_xyxy_px: expected int32, got {boxes.dtype}")
        is_ordered = boxes[:, :2] < boxes[:, 2:]
        if not np.logical_and.reduce(is_ordered, axis=None):
            bad = int(np.flatnonzero(~is_ordered.all(axis=1))[0])
            raise ValueError(
                f"Proposals.boxes_xyxy_px: box {bad} is {boxes[bad].tolist()}, expected x1 < x2 and y1 < y2"
            )
        object.__setattr__(self, "boxes_xyxy_px", _frozen(boxes))

    def __len__(self) -> int:
        return len(self.boxes_xyxy_px)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """All proposals of a frame with their scores.

    Attributes:
        proposals: The proposals that were scored.
        scores: Shape (N,), float32 in [0, 1], one for each proposal: how sure the classifier is of a light artifact.
        score_threshold: A proposal is accepted when its score is above this.

    Raises:
        ValueError: If the scores' shape or dtype is wrong, or one is outside [0, 1] or NaN.
    """

    proposals: Proposals
    scores: NDArray[np.float32]
    score_threshold: float

    def __post_init__(self) -> None:
        scores, count = self.scores, len(self.proposals)
        if scores.shape != (count,) or scores.dtype != np.float32:
            raise ValueError(
                f"Detections.scores: expected float32 of shape ({count},), got {scores.dtype} of shape {scores.shape}"
            )
        if count and not (np.minimum.reduce(scores) >= 0.0 and np.maximum.reduce(scores) <= 1.0):
            raise ValueError("Detections.scores: expected values in [0, 1], got NaN or a value outside")
        object.__setattr__(self, "scores", _frozen(scores))

    def __len__(self) -> int:
        return len(self.proposals)

    @property
    def boxes_xyxy_px(self) -> Boxes:
        """All scored boxes, shape (N, 4), int32, half-open, full-frame pixels."""
        return self.proposals.boxes_xyxy_px

    @property
    def is_accepted(self) -> NDArray[np.bool_]:
        """Shape (N,): which boxes are light artifacts; compared in double precision, as when files are evaluated."""
        return np.asarray(self.scores.astype(np.float64) > self.score_threshold)

    @property
    def accepted_boxes_xyxy_px(self) -> Boxes:
        """The accepted boxes, shape (M, 4), int32, half-open, full-frame pixels."""
        return self.boxes_xyxy_px[self.is_accepted]


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What the pipeline made of one frame.

    Attributes:
        frame: The frame's number in its source, as in `Frame.frame`.
        timestamp_ns: The frame's time of exposure in nanoseconds.
        proposals: Boxes that may hold a light artifact.
        detections: The scored proposals; None where no classifier is configured (never an empty stand-in).
        stage_ms: Run-time of each stage in milliseconds, by stage name; a measurement, not part of the result's
            identity.
    """

    frame: int
    timestamp_ns: int
    proposals: Proposals
    detections: Detections | None
    stage_ms: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "stage_ms", MappingProxyType(dict(self.stage_ms)))
