"""All that the stages made of one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from foreglow.types.beam import BeamCommand
from foreglow.types.boxes import Detections, Proposals, Ranges
from foreglow.types.tracks import Tracks


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What the pipeline made of one frame.

    Attributes:
        frame: The frame's number in its source, as in `Frame.frame`.
        timestamp_ns: The frame's time of exposure in nanoseconds.
        proposals: Boxes that may hold a light artifact.
        detections: The scored proposals; None where no classifier is configured (never an empty stand-in).
        ranges: How far away the light in each box is; None without detections, without an estimator or where the
            frame has no camera.
        tracks: What is followed over time; None without detections or without a tracker.
        beam: What our headlamps shall shine; None without tracks, or where no beam is configured.
        stage_ms: Run-time of each stage in milliseconds, by stage name; a measurement, not part of the result's
            identity.
    """

    frame: int
    timestamp_ns: int
    proposals: Proposals
    detections: Detections | None
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    ranges: Ranges | None = None
    tracks: Tracks | None = None
    beam: BeamCommand | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stage_ms", MappingProxyType(dict(self.stage_ms)))
