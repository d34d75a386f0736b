"""What every tracker does."""

from __future__ import annotations

from typing import Protocol

from foreglow.config import TrackerConfig
from foreglow.types import Detections, Frame, Ranges, Tracks


class Tracker(Protocol):
    """Tracks the boxes from frame to frame."""

    def __init__(self, config: TrackerConfig) -> None: ...

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        """The tracks after `frame`; of the frame only its time, size, camera and motion are used, never the pixels."""
        ...

    def reset(self) -> None:
        """Forgets all tracks, as at the start of a sequence; ids begin again."""
        return
