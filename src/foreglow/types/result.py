"""The results of all stages for one frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from foreglow.numbers import checked_whole
from foreglow.types.arrays import Image, Value, check_kind, check_members, check_numbers, checked_time_ns
from foreglow.types.beam import BeamCommand
from foreglow.types.boxes import Detections, Proposals, Ranges
from foreglow.types.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Rectangle
    from matplotlib.text import Text

    from foreglow.types.arrays import Image
    from foreglow.types.boxes import Detections, Proposals
    from foreglow.types.tracks import Tracks

COLOURS = {"proposal": "#fabe46", "rejected": "#91a0b4", "accepted": "#5aeb78", "track": "#5abeff"}
"""Of the annotated videos."""


def plot(
    proposals: Proposals, detections: Detections | None, tracks: Tracks | None, image: Image | None, axes: Axes | None
) -> Axes:
    """As `FrameResult.plot`."""
    try:
        from matplotlib import pyplot
        from matplotlib.patches import Rectangle
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "FrameResult.plot: matplotlib is not installed: pip install 'foreglow[plots]'", name=error.name
        ) from None
    shown = pyplot.subplots(layout="constrained")[1] if axes is None else axes

    labels: list[tuple[float, Text, Rectangle]] = []

    def add(box: Any, kind: str, text: str = "", weight: float = 0.0) -> None:
        x1, y1, x2, y2 = np.asarray(box, np.float64) - 0.5  # pixels are centred on whole numbers
        drawn = Rectangle((x1, y1), x2 - x1, y2 - y1, fill=False, edgecolor=COLOURS[kind])
        shown.add_patch(drawn)
        if text:
            written = shown.text(x1, y1, text, color=COLOURS[kind], fontsize="small", verticalalignment="bottom")
            labels.append((weight, written, drawn))

    if image is not None:
        shown.imshow(image, cmap="gray", norm="asinh")
    if detections is None:
        for box in proposals.boxes_xyxy_px:
            add(box, "proposal")
    else:
        columns = detections.boxes_xyxy_px, detections.scores, detections.is_accepted
        for box, score, is_accepted in zip(*columns, strict=True):
            add(box, "accepted" if is_accepted else "rejected", f"{score:.2f}", weight=is_accepted + score)
    if tracks is not None:
        for index in np.flatnonzero(tracks.is_plausible):
            range_m = tracks.ranges_m[index]
            text = f"#{tracks.ids[index]}" + ("" if np.isnan(range_m) else f" {range_m:.0f} m")
            add(tracks.boxes_xyxy_px[index], "track", text, weight=3.0)
    shown.set(xlabel="column, pixels", ylabel="row, pixels", aspect="equal")
    if image is None:
        shown.autoscale_view()
        if not shown.yaxis_inverted():
            shown.invert_yaxis()
    labels.sort(key=lambda label: -label[0])
    _spread(shown, [(text, box) for _, text, box in labels])
    return shown


def _spread(axes: Axes, labels: Sequence[tuple[Text, Rectangle]]) -> None:
    """Moves labels to where they lie over no other at the figure's size; the first of them choose first.

    A label is above its box, below it or right of it; where all of these are taken, it is moved up, line by line.
    """
    if not labels:
        return
    axes.figure.canvas.figure.draw_without_rendering()  # now texts have a size
    to_data, moved = axes.transData.inverted(), {text for text, _ in labels}
    others = [text.get_window_extent().extents for text in axes.texts if text not in moved]
    taken = np.array(others, np.float64).reshape(-1, 4)
    for text, box in labels:
        x1, y1, x2, y2 = box.get_window_extent().extents
        size = text.get_window_extent().size
        lows = [(x1, y2), (x1, y1 - size[1]), (x2, y2 - size[1])]
        lows += [(x1, y2 + line * size[1]) for line in range(1, len(taken) + 2)]
        for low in np.array(lows):
            if not ((taken[:, :2] < low + size) & (low < taken[:, 2:])).all(axis=1).any():
                break
        taken = np.concatenate([taken, [[*low, *(low + size)]]])
        text.set_position(to_data.transform(low).tolist())


_KINDS = (
    ("proposals", Proposals),
    ("detections", Detections),
    ("ranges", Ranges),
    ("tracks", Tracks),
    ("beam", BeamCommand),
)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult(Value):
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

    Raises:
        ValueError: If a field is of another type, or number or time is no whole number of 64 bits.
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
        object.__setattr__(self, "frame", checked_whole("FrameResult.frame", self.frame, -(2**63), 2**63 - 1))
        object.__setattr__(self, "timestamp_ns", checked_time_ns("FrameResult.timestamp_ns", self.timestamp_ns))
        for name, kind in _KINDS:
            value = getattr(self, name)
            if value is not None or name == "proposals":
                check_kind(f"FrameResult.{name}", value, kind)
        check_kind("FrameResult.stage_ms", self.stage_ms, Mapping)
        object.__setattr__(self, "stage_ms", MappingProxyType(dict(self.stage_ms)))

    def plot(self, image: Image | None = None, axes: Axes | None = None) -> Axes:
        """Draws boxes with their scores, and plausible tracks with their ranges, into axes of matplotlib.

        Args:
            image: What is shown below them: the image of the frame.
            axes: Where to draw; None makes a new figure.

        Raises:
            ModuleNotFoundError: If matplotlib is not installed (extra `plots`).
            ValueError: If the image is no array (height, width) of numbers, or there are no axes in `axes`.
        """
        if image is not None:
            check_numbers("image", image, (None, None))
        if axes is not None:
            check_members("axes", axes, "axes of matplotlib", "add_patch", "imshow", "set_title")
        shown = plot(self.proposals, self.detections, self.tracks, image, axes)
        shown.set_title(f"frame {self.frame}")
        return shown
