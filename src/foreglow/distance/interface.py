"""What every range estimator does."""

from __future__ import annotations

from typing import Protocol

from foreglow.config import DistanceConfig
from foreglow.types import Detections, Frame, Ranges


class RangeEstimator(Protocol):
    """Estimates the range of every box of a frame, and its standard deviation."""

    def __init__(self, config: DistanceConfig) -> None: ...

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        """The ranges of `detections` in `frame`, which must have a camera; NaN and infinity where unknown."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        return
