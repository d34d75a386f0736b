"""The fourth stage: light artifacts tracked over time, and which of the tracks are plausible."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from foreglow.config import TrackerConfig
from foreglow.plugins import make
from foreglow.tracking.published import PublishedTracker
from foreglow.tracking.tracker import AlphaBetaTracker
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


TRACKERS: Mapping[str, type[Tracker]] = MappingProxyType(
    {"alpha_beta": AlphaBetaTracker, "published": PublishedTracker}
)
"""Our trackers by name."""


def make_tracker(config: TrackerConfig) -> Tracker:
    """The tracker that `config.method` names: one of `TRACKERS`, or a plug-in.

    Raises:
        ValueError: If it names none, or one that cannot be imported.
    """
    return make("tracker.method", config.method, TRACKERS, "foreglow.trackers", config, method="update")
