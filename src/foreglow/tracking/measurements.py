"""The detections of a frame as measurements for the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.tracking.association import UNASSIGNED, Assignment, centres_and_sizes
from foreglow.tracking.states import NUM_CHANNELS, RANGE
from foreglow.types import LIGHT_KINDS, Detections, Ranges


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N measurements.

    Attributes:
        values: Shape (N, NUM_CHANNELS): centre x, y, width, height, range; NaN where unknown.
        sigmas_m: Shape (N,), standard deviation of the range; infinite if it has none, NaN if the range is unknown.
        scores: Shape (N,), of the classifier.
        light_kinds: Shape (N, 4), as in `Detections`.
        detections: Shape (N,), indices in the frame's detections.
    """

    values: Floats
    sigmas_m: Floats
    scores: Floats
    light_kinds: Floats
    detections: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.detections)

    def taken(self, assigned: Assignment) -> Measurements:
        """The measurement assigned to each track; NaN and the index -1 for a track without one."""
        return Measurements(  # index -1 picks the row that is appended
            np.concatenate([self.values, _NOTHING.values])[assigned],
            np.concatenate([self.sigmas_m, _NOTHING.sigmas_m])[assigned],
            np.concatenate([self.scores, _NOTHING.scores])[assigned],
            np.concatenate([self.light_kinds, _NOTHING.light_kinds])[assigned],
            np.concatenate([self.detections, _NOTHING.detections])[assigned],
        )


_NOTHING = Measurements(
    values=np.full((1, NUM_CHANNELS), np.nan),
    sigmas_m=np.full(1, np.nan),
    scores=np.full(1, np.nan),
    light_kinds=np.full((1, len(LIGHT_KINDS)), np.nan),
    detections=np.full(1, UNASSIGNED),
)
"""The measurement of a track without one."""


def measurements(detections: Detections, ranges: Ranges | None, min_score: float) -> Measurements:
    """The measurements of all detections with a score above `min_score`."""
    scores = detections.scores.astype(np.float64)
    kept = np.flatnonzero(scores > min_score)
    values = np.full((len(kept), NUM_CHANNELS), np.nan)
    values[:, :RANGE] = centres_and_sizes(detections.boxes_xyxy_px[kept].astype(np.float64))
    sigmas_m = np.full(len(kept), np.nan)
    if ranges is not None:
        values[:, RANGE] = ranges.ranges_m[kept]
        sigmas_m = np.where(np.isnan(values[:, RANGE]), np.nan, ranges.sigmas_m[kept])
    return Measurements(values, sigmas_m, scores[kept], detections.light_kinds[kept].astype(np.float64), kept)
