"""How a live pipeline is: what is wrong now, and what was lost; and who wants to be told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from foreglow.runtime.run import ResultSink
from foreglow.types import BeamCommand, Frame, FrameResult


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a live pipeline at one time.

    Attributes:
        timestamp_ns: The time, by the frames' clock.
        faults: What is wrong now, names such as `camera_gone`; empty when all is well.
        num_frames: Frames that were run so far.
        num_dropped: Frames that were passed over for a newer one.
        num_late: Frames whose command came later than one frame's time after the image.
        beam: The command in force; None before the first.
    """

    timestamp_ns: int
    faults: tuple[str, ...]
    num_frames: int
    num_dropped: int
    num_late: int
    beam: BeamCommand | None


class LiveSink(ResultSink, Protocol):
    """A result sink that is also told of the health: once a second, and whenever the faults change.

    `FrameResult.stage_ms` of a live frame has more than the stages: `capture` from exposure until it was read, `queue`
    until its turn, `send` for its command's way onto the bus.
    """

    def write_health(self, health: Health) -> None:
        """Takes what is known now."""
        ...


class ResultsOnly:
    """A result sink as a live one, which is not told of the health."""

    def __init__(self, sink: ResultSink) -> None:
        self._sink = sink

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Passes a result on."""
        self._sink.write(frame, result)

    def write_health(self, health: Health) -> None:
        """Does nothing."""

    def close(self) -> None:
        """Completes the sink."""
        self._sink.close()

    def discard(self) -> None:
        """Lets the sink let go."""
        self._sink.discard()
