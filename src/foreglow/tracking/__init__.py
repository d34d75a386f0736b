"""The fourth stage: light artifacts tracked over time, and which of the tracks are plausible."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from foreglow.config import TrackerConfig
from foreglow.plugins import METHODS, make
from foreglow.tracking.interface import Tracker
from foreglow.tracking.published import PublishedTracker
from foreglow.tracking.tracker import AlphaBetaTracker
from foreglow.types.arrays import check_kind

__all__ = ["TRACKERS", "AlphaBetaTracker", "PublishedTracker", "Tracker", "make_tracker"]

TRACKERS: Mapping[str, type[Tracker]] = MappingProxyType(
    {"alpha_beta": AlphaBetaTracker, "published": PublishedTracker}
)
"""Our trackers by name."""


def make_tracker(config: TrackerConfig) -> Tracker:
    """The tracker that `config.method` names: one of `TRACKERS`, or a plug-in.

    Raises:
        ValueError: If it names none, or one that cannot be imported or lacks a method.
    """
    check_kind("config", config, TrackerConfig)
    return make("tracker.method", config.method, TRACKERS, "foreglow.trackers", config, methods=METHODS["tracker"])
