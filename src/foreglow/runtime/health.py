"""Health reports of a live pipeline, and the sinks that receive them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from foreglow.runtime.run import ResultSink
from foreglow.types import BeamCommand


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a live pipeline.

    Attributes:
        timestamp_ns: The time of the report, by the frames' clock.
        faults: Names of the faults that are present, such as `camera_gone`; empty if there are none.
        num_frames: Frames that were processed so far.
        num_dropped: Frames that were dropped for a newer one.
        num_late: Frames whose command came more than a frame period after the image.
        beam: The command in force; None before the first.
        details: What is known about the faults, such as why the camera cannot be opened.
        is_timed: Whether `timestamp_ns` is a time of the frames: false before the first frame of a replay, with which
            its clock begins.
    """

    timestamp_ns: int
    faults: tuple[str, ...]
    num_frames: int
    num_dropped: int
    num_late: int
    beam: BeamCommand | None
    details: str = ""
    is_timed: bool = True


class LiveSink(ResultSink, Protocol):
    """A result sink that also receives the health, once a second and whenever the faults change.

    `FrameResult.stage_ms` of a live frame has three more parts: `capture` from exposure until the frame was read,
    `queue` until its processing began, and `send` for sending its command.
    """

    def write_health(self, health: Health) -> None:
        """Writes a health report."""
        ...
