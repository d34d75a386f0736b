"""One time axis for frames of several sequences, each of which has its own times."""

from __future__ import annotations

from foreglow.datasets.bags import PAUSE_NS
from foreglow.types import Frame


class TimeAxis:
    """Assigns times to the frames of a run so that time never goes back.

    A sequence that would begin less than `PAUSE_NS` after the end of the previous one is shifted to begin that much
    after it; all other sequences keep their times.
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
        """The time on the axis of a time in the latest frame's sequence."""
        return timestamp_ns + self._shift_ns
