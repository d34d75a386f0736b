"""One axis of time for a log of several sequences, which share none."""

from __future__ import annotations

from foreglow.types import Frame

PAUSE_NS = 1_000_000_000
"""Between two sequences in a log."""


class TimeAxis:
    """The times of frames in a log: their own, where these go on.

    A sequence whose times do not go on from those of the one before follows `PAUSE_NS` after it: in a log, time only
    goes forward.
    """

    def __init__(self) -> None:
        self._sequence = ""
        self._latest_ns: int | None = None
        self.shift_ns = 0
        """What the latest frame's time was moved by."""

    def time_ns(self, frame: Frame) -> int:
        """The frame's time in the log."""
        if self._latest_ns is not None and frame.sequence != self._sequence:
            self.shift_ns = max(0, self._latest_ns + PAUSE_NS - frame.timestamp_ns)
        self._sequence = frame.sequence
        self._latest_ns = frame.timestamp_ns + self.shift_ns
        return self._latest_ns
