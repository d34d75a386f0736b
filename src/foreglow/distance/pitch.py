"""The body's pitch against the road under it, and how well it is known."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from foreglow.distance.markings import MarkingFinder
from foreglow.types import Frame

REST_SIGMA_RAD = math.radians(0.12)
"""Of a body on its springs on an ordinary road, when nobody measures it: what the simulator's drives have."""

SENSOR_SIGMA_RAD = math.radians(0.05)
"""Assumed of a pitch sensor; none was at hand."""


class Pitch(NamedTuple):
    """Nose up against the road, and its standard deviation; both rad."""

    rad: float
    sigma_rad: float


class PitchSource(Protocol):
    """Says how the body is pitched in each frame."""

    def pitch(self, frame: Frame) -> Pitch:
        """The pitch in `frame`, beyond that of the calibration."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames."""
        ...


class FixedPitch:
    """That of the calibration: the body at rest."""

    def pitch(self, frame: Frame) -> Pitch:  # noqa: ARG002
        """No more than the calibration has."""
        return Pitch(0.0, REST_SIGMA_RAD)

    def reset(self) -> None:
        """There is nothing to forget."""


class MotionPitch:
    """What `Frame.motion` tells; at rest where it tells nothing."""

    def pitch(self, frame: Frame) -> Pitch:
        """The measured pitch."""
        if frame.motion is None or math.isnan(frame.motion.pitch_rad):
            return Pitch(0.0, REST_SIGMA_RAD)
        return Pitch(frame.motion.pitch_rad, SENSOR_SIGMA_RAD)

    def reset(self) -> None:
        """There is nothing to forget."""


class MarkingsPitch:
    """What the lane markings tell, weighted with the body at rest; at rest where they tell nothing.

    Every frame stands for itself: a body sways once a second, too fast to be followed at a few frames a second.
    """

    def __init__(self) -> None:
        self.finder = MarkingFinder()

    def pitch(self, frame: Frame) -> Pitch:
        """The pitch in `frame`."""
        lane = self.finder.find(frame)
        trust = REST_SIGMA_RAD**2 / (REST_SIGMA_RAD**2 + lane.pitch_sigma_rad**2)
        return Pitch(trust * lane.pitch_rad, REST_SIGMA_RAD * math.sqrt(1.0 - trust))

    def reset(self) -> None:
        """There is nothing to forget."""


PITCH_SOURCES: dict[str, type[PitchSource]] = {"fixed": FixedPitch, "motion": MotionPitch, "markings": MarkingsPitch}
"""All sources by the name that `DistanceConfig.pitch` has for them."""


def make_pitch_source(name: str) -> PitchSource:
    """The source called `name`.

    Raises:
        ValueError: If there is none; the message lists those that exist.
    """
    if name not in PITCH_SOURCES:
        raise ValueError(f"distance.pitch: expected one of {', '.join(PITCH_SOURCES)}, got {name!r}")
    return PITCH_SOURCES[name]()
