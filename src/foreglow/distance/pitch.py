"""The body's pitch against the road under it, and how well it is known."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from foreglow.distance.markings import MarkingFinder
from foreglow.types import Frame

REST_SIGMA_RAD = math.radians(0.12)
"""Standard deviation of a body's pitch on an ordinary road when it is not measured; from the simulator's drives."""

SENSOR_SIGMA_RAD = math.radians(0.05)
"""Assumed standard deviation of a pitch sensor; none was at hand."""


class Pitch(NamedTuple):
    """Pitch of the body against the road, nose up, and its standard deviation with the calibration's; both rad."""

    rad: float
    sigma_rad: float


class PitchSource(Protocol):
    """Gives the pitch of the body in each frame."""

    def pitch(self, frame: Frame) -> Pitch:
        """The pitch in `frame`, on top of the calibration's."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames."""
        ...


def with_mount(sigma_rad: float, frame: Frame) -> float:
    """`sigma_rad` together with the calibration's own standard deviation of the pitch."""
    return sigma_rad if frame.camera is None else math.hypot(sigma_rad, frame.camera.mount_sigmas.pitch_rad)


class FixedPitch:
    """The calibration's pitch: the body at rest."""

    def pitch(self, frame: Frame) -> Pitch:
        """Zero, on top of the calibration's."""
        return Pitch(0.0, with_mount(REST_SIGMA_RAD, frame))

    def reset(self) -> None:
        """There is nothing to forget."""


class MotionPitch:
    """The pitch in `Frame.motion`; at rest where it has none."""

    def pitch(self, frame: Frame) -> Pitch:
        """The measured pitch."""
        if frame.motion is None or math.isnan(frame.motion.pitch_rad):
            return Pitch(0.0, with_mount(REST_SIGMA_RAD, frame))
        return Pitch(frame.motion.pitch_rad, with_mount(SENSOR_SIGMA_RAD, frame))

    def reset(self) -> None:
        """There is nothing to forget."""


class MarkingsPitch:
    """The pitch that the lane markings show, weighted with the body at rest; at rest where no markings are seen.

    Each frame is measured by itself: a body sways about once a second, too fast to be tracked at a few frames a second.
    """

    def __init__(self) -> None:
        self.finder = MarkingFinder()

    def pitch(self, frame: Frame) -> Pitch:
        """The pitch in `frame`."""
        lane = self.finder.find(frame)
        rest_sigma_rad = with_mount(REST_SIGMA_RAD, frame)
        trust = rest_sigma_rad**2 / (rest_sigma_rad**2 + lane.pitch_sigma_rad**2)
        return Pitch(trust * lane.pitch_rad, rest_sigma_rad * math.sqrt(1.0 - trust))

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
