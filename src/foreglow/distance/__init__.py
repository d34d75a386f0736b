"""The third stage: how far away the light in each box is.

All estimators work in the vehicle's frame (x forward, y left, z up, z = 0 the road under the car) and give the range
from the camera along the viewing ray, to what shines or is lit.
"""

from __future__ import annotations

from typing import Protocol

from foreglow.config import DistanceConfig
from foreglow.types import Detections, Frame, Ranges


class RangeEstimator(Protocol):
    """Gives every box of a frame a range and its standard deviation."""

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        """The ranges of `detections` in `frame`, whose `camera` must be there; NaN and infinity where unknown."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        ...


ESTIMATORS: dict[str, type[RangeEstimator]] = {}
"""All estimators by name."""


def make_estimator(config: DistanceConfig) -> RangeEstimator:
    """The estimator that `config` names.

    Raises:
        ValueError: If it names none.
    """
    raise ValueError(f"distance.estimator: expected one of {', '.join(ESTIMATORS)}, got {config.estimator!r}")
