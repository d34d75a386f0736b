"""Which kinds of light a detector takes for which, where a simulated data set stores whose light is in its boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.files import fields_to_json
from foreglow.lab.evaluation.boxes.breakdown import SplitLabels
from foreglow.lab.evaluation.ratios import ratio
from foreglow.runs.predictions import Predictions
from foreglow.types import KINDS

NONE = KINDS.index("none")


@dataclass(frozen=True, slots=True, eq=False)
class KindConfusion:
    """What boxes are against what they are called.

    A box is of the kind with the greatest share of its light; our own and fixed light together are `none`. It is called
    `none` unless it is accepted, and otherwise the most probable kind of light.

    Attributes:
        counts: Shape (5, 5), of boxes: true kinds in the rows, called kinds in the columns, both as `KINDS`.
        num_unknown: Boxes that the data set stores no shares of, or that a model does not tell the kind of.
    """

    counts: NDArray[np.int64]
    num_unknown: int

    @property
    def kinds(self) -> tuple[str, ...]:
        """The order of rows and columns."""
        return KINDS

    @property
    def recalls(self) -> tuple[float, ...]:
        """Of each kind's boxes, the share that is called by it; NaN without boxes."""
        return tuple(ratio(int(row[index]), int(row.sum())) for index, row in enumerate(self.counts))

    @property
    def right(self) -> float:
        """Share of the accepted boxes whose kind is right; NaN without any."""
        accepted = self.counts[:, :NONE]
        return ratio(int(np.trace(accepted)), int(accepted.sum()))

    def to_json(self) -> dict[str, Any]:
        """All by name."""
        return fields_to_json(self, "kinds", "recalls", "right")


def kind_confusion(labels: SplitLabels, predictions: Predictions, threshold: float) -> KindConfusion | None:
    """The table of `predictions` by the shares in `labels`; None without shares, or if the predictions tell no kinds.

    Boxes and stored proposals, of whatever preset, are the same if their coordinates are equal.
    """
    if not (labels.shares and predictions.light_kinds):
        return None
    counts = np.zeros((len(KINDS), len(KINDS)), np.int64)
    for image_id, light_kinds in predictions.light_kinds.items():
        stored = [by_image[image_id] for by_image in labels.shares.values() if image_id in by_image]
        kind_of = {
            tuple(box): kind
            for found in stored
            for box, kind in zip(found.boxes_xyxy_px.tolist(), found.kinds.argmax(axis=1).tolist(), strict=True)
        }
        is_accepted = predictions.scores[image_id] > threshold
        called = np.where(is_accepted, light_kinds.argmax(axis=1), NONE)
        boxes = map(tuple, predictions.boxes_xyxy_px[image_id].tolist())
        for box, call, is_unknown in zip(boxes, called, np.isnan(light_kinds[:, 0]), strict=True):
            if box in kind_of and not is_unknown:
                counts[kind_of[box], call] += 1
    num_boxes = sum(map(len, predictions.boxes_xyxy_px.values()))
    return KindConfusion(counts, num_boxes - int(counts.sum()))
