"""What the detections of a frame measure, as the filter takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.tracking.association import UNASSIGNED, Assignment, centres_and_sizes
from foreglow.tracking.states import NUM_CHANNELS, RANGE
from foreglow.types import Detections, Ranges


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N measurements.

    Attributes:
        values: Shape (N, NUM_CHANNELS): centre x, y, width, height, range; NaN where unknown.
        sigmas_m: Shape (N,), of the range; infinite where it comes without one, NaN where the range is unknown.
        scores: Shape (N,).
        direct_probabilities: Shape (N,); NaN where unknown.
        places: Shape (N,), in the frame's detections.
    """

    values: Floats
    sigmas_m: Floats
    scores: Floats
    direct_probabilities: Floats
    places: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.places)

    def taken(self, assigned: Assignment) -> Measurements:
        """For each track the measurement that it takes: NaN and place -1 where it takes none."""
        nothing = np.full((1, NUM_CHANNELS), np.nan)
        return Measurements(  # -1 as an index is the row that is put behind them
            np.concatenate([self.values, nothing])[assigned],
            np.append(self.sigmas_m, np.nan)[assigned],
            np.append(self.scores, np.nan)[assigned],
            np.append(self.direct_probabilities, np.nan)[assigned],
            np.append(self.places, UNASSIGNED)[assigned],
        )


def measurements(detections: Detections, ranges: Ranges | None, min_score: float) -> Measurements:
    """Those of all detections with a score above `min_score`."""
    scores = detections.scores.astype(np.float64)
    places = np.flatnonzero(scores > min_score)
    values = np.full((len(places), NUM_CHANNELS), np.nan)
    values[:, :RANGE] = centres_and_sizes(detections.boxes_xyxy_px[places].astype(np.float64))
    sigmas_m = np.full(len(places), np.nan)
    if ranges is not None:
        values[:, RANGE] = ranges.ranges_m[places]
        sigmas_m = np.where(np.isnan(values[:, RANGE]), np.nan, ranges.sigmas_m[places])
    direct_probabilities = detections.direct_probabilities[places].astype(np.float64)
    return Measurements(values, sigmas_m, scores[places], direct_probabilities, places)
