"""The results of all stages for one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from foreglow.types.arrays import Image
from foreglow.types.beam import BeamCommand
from foreglow.types.boxes import Detections, Proposals, Ranges
from foreglow.types.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """The results of all stages for one frame.

    Attributes:
        frame: The frame's number in its source, as in `Frame.frame`.
        timestamp_ns: The frame's time of exposure in nanoseconds.
        proposals: Boxes that may hold a light artifact.
        detections: The scored proposals; None if no classifier is configured.
        ranges: Range of the light in each box; None without detections, without an estimator, or if the frame has no
            camera.
        tracks: The tracks after this frame; None without detections or without a tracker.
        beam: The command to our headlamps; None without tracks, or if no beam is configured.
        stage_ms: Run-time of each stage in milliseconds, by stage name; differs from run to run.
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

    def plot(self, image: Image | None = None, axes: Axes | None = None) -> Axes:
        """Draws boxes with their scores, and plausible tracks with their ranges, into axes of matplotlib.

        Args:
            image: What is shown below them: the image of the frame.
            axes: Where to draw; None makes a new figure.

        Raises:
            ModuleNotFoundError: If matplotlib is not installed (extra `plots`).
        """
        from foreglow.types.plotting import plot

        shown = plot(self.proposals, self.detections, self.tracks, image, axes)
        shown.set_title(f"frame {self.frame}")
        return shown
