"""One axis of time for the frames of several sequences, each of which has times of its own."""

from __future__ import annotations

from foreglow.types import Frame

PAUSE_NS = 1_000_000_000
"""Between two sequences."""


class TimeAxis:
    """Puts the frames of a run on an axis on which time only goes forward.

    A sequence whose times do not go on from those of the one before follows `PAUSE_NS` after it; others, and the first,
    keep their times.
    """

    def __init__(self) -> None:
        self._sequence = ""
        self._latest_ns: int | None = None
        self._shift_ns = 0

    def time_ns(self, frame: Frame) -> int:
        """The frame's time on the axis."""
        if self._latest_ns is not None and frame.sequence != self._sequence:
            self._shift_ns = max(0, self._latest_ns + PAUSE_NS - frame.timestamp_ns)
        self._sequence = frame.sequence
        self._latest_ns = self.within_sequence_ns(frame.timestamp_ns)
        return self._latest_ns

    def within_sequence_ns(self, timestamp_ns: int) -> int:
        """A time of the latest frame's sequence on the axis."""
        return timestamp_ns + self._shift_ns
