"""Boxes in one image: as proposals, with scores, with ranges."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foreglow.numbers import checked_share
from foreglow.types.arrays import Boxes, Value, check_kind, checked_array
from foreglow.types.kinds import LIGHT_KINDS, checked_kinds, direct_of_kinds, names_of_kinds

_INT32, _FLOAT32, _FLOAT64 = np.dtype(np.int32), np.dtype(np.float32), np.dtype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Proposals(Value):
    """Boxes that may hold a light artifact; a `Proposer` sorts them by y1, x1, y2, x2.

    Attributes:
        boxes_xyxy_px: Shape (N, 4), int32, half-open, full-frame pixels; N = 0 means that nothing stands out.

    Raises:
        ValueError: If the shape, the dtype or a box's order of corners is wrong.
    """

    boxes_xyxy_px: Boxes

    def __post_init__(self) -> None:
        boxes = checked_array("Proposals.boxes_xyxy_px", self.boxes_xyxy_px, _INT32, (None, 4))
        is_ordered = boxes[:, :2] < boxes[:, 2:]
        if not np.logical_and.reduce(is_ordered, axis=None):
            bad = int(np.flatnonzero(~is_ordered.all(axis=1))[0])
            raise ValueError(
                f"Proposals.boxes_xyxy_px: box {bad} is {boxes[bad].tolist()}, expected x1 < x2 and y1 < y2"
            )
        object.__setattr__(self, "boxes_xyxy_px", boxes)

    def __len__(self) -> int:
        return len(self.boxes_xyxy_px)


@dataclass(frozen=True, slots=True, eq=False)
class Detections(Value):
    """All proposals of a frame with their scores.

    Attributes:
        proposals: The proposals that were scored.
        scores: Shape (N,), float32 in [0, 1], the classifier's probability of a light artifact in each proposal.
        score_threshold: A proposal is accepted if its score is above this.
        light_kinds: Shape (N, 4), float32, the probabilities of the kinds of `LIGHT_KINDS` if it is light of a vehicle
            at all; they sum to 1. NaN where the model does not tell. An empty array becomes NaNs.

    Raises:
        ValueError: If a field is of a wrong type, an array's shape or dtype is wrong, a score or the threshold is
            outside [0, 1] or NaN, or kinds do not sum to 1.
    """

    proposals: Proposals
    scores: NDArray[np.float32]
    score_threshold: float
    light_kinds: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, len(LIGHT_KINDS)), np.float32))

    def __post_init__(self) -> None:
        check_kind("Detections.proposals", self.proposals, Proposals)
        count = len(self.proposals)
        scores = checked_array("Detections.scores", self.scores, _FLOAT32, (count,))
        if count and not (np.minimum.reduce(scores) >= 0.0 and np.maximum.reduce(scores) <= 1.0):
            raise ValueError("Detections.scores: expected values in [0, 1], got NaN or a value outside")
        threshold = checked_share("Detections.score_threshold", self.score_threshold)
        light_kinds = checked_kinds("Detections.light_kinds", self.light_kinds, count, np.float32)
        object.__setattr__(self, "scores", scores)
        object.__setattr__(self, "score_threshold", threshold)
        object.__setattr__(self, "light_kinds", light_kinds)

    def __len__(self) -> int:
        return len(self.proposals)

    @property
    def boxes_xyxy_px(self) -> Boxes:
        """All scored boxes, shape (N, 4), int32, half-open, full-frame pixels."""
        return self.proposals.boxes_xyxy_px

    @property
    def is_accepted(self) -> NDArray[np.bool_]:
        """Shape (N,): which boxes are light artifacts; compared in double precision, as in the evaluation of files."""
        return np.asarray(self.scores.astype(np.float64) > self.score_threshold)

    @property
    def kinds(self) -> NDArray[np.float32]:
        """Shape (N, 5): the probabilities of `KINDS`, which sum to 1; NaN where the model does not tell."""
        none = np.where(np.isnan(self.light_kinds[:, 0]), np.float32(np.nan), 1 - self.scores)
        return np.column_stack([self.scores[:, None] * self.light_kinds, none])

    @property
    def kind_names(self) -> tuple[str | None, ...]:
        """For each box the most probable of `LIGHT_KINDS`, whether it is accepted or not; None where it is unknown."""
        return names_of_kinds(self.light_kinds)

    @property
    def direct_probabilities(self) -> NDArray[np.float32]:
        """Shape (N,): probability of a lamp in sight, front or rear, if it is light of a vehicle; NaN where unknown."""
        return direct_of_kinds(self.light_kinds)

    @property
    def accepted_boxes_xyxy_px(self) -> Boxes:
        """The accepted boxes, shape (M, 4), int32, half-open, full-frame pixels."""
        return self.boxes_xyxy_px[self.is_accepted]


@dataclass(frozen=True, slots=True, eq=False)
class Ranges(Value):
    """Range of the light in each box: from the camera along the viewing ray, to the lamp or the surface that it lights.

    Attributes:
        detections: The boxes.
        ranges_m: Shape (N,), float64, positive; NaN where unknown.
        sigmas_m: Shape (N,), float64, standard deviation, positive; infinite where the range is NaN, or where the
            estimator does not know its own error.

    Raises:
        ValueError: If a type, a shape or a dtype is wrong, a range is not positive, or a range that is NaN has a finite
            sigma.
    """

    detections: Detections
    ranges_m: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        check_kind("Ranges.detections", self.detections, Detections)
        count = len(self.detections)
        for name in ("ranges_m", "sigmas_m"):
            object.__setattr__(self, name, checked_array(f"Ranges.{name}", getattr(self, name), _FLOAT64, (count,)))
        is_unknown = np.isnan(self.ranges_m)
        if (self.ranges_m <= 0).any() or np.isinf(self.ranges_m).any():
            raise ValueError("Ranges.ranges_m: expected positive numbers or NaN, got zero, a negative or infinity")
        if not (self.sigmas_m > 0).all() or np.isfinite(self.sigmas_m[is_unknown]).any():
            raise ValueError("Ranges.sigmas_m: expected positive numbers, and infinity beside a range that is NaN")

    def __len__(self) -> int:
        return len(self.detections)
