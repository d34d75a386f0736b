"""The fourth stage: light artifacts followed over time, and which of them are plausible."""

from __future__ import annotations

from typing import Protocol

from foreglow.types import Detections, Frame, Ranges, Tracks


class Tracker(Protocol):
    """Follows the boxes from frame to frame."""

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        """The tracks after `frame`; of the frame only its time, size and motion are used, never the pixels."""
        ...

    def reset(self) -> None:
        """Forgets all tracks, as at the start of a sequence; ids begin again."""
        ...
