"""Every stage of the detector on one frame, side by side, as the paper draws its pipeline; and the road ahead."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.classifier import OnnxClassifier
from foreglow.config import PipelineConfig
from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, png, show_image
from foreglow.lab.reports.road_picture import show_road
from foreglow.proposals import ReferenceProposer
from foreglow.proposals.reference import Verdict
from foreglow.proposals.resizing import in_working_pixels, resized
from foreglow.types import Frame, FrameResult
from foreglow.types.white import full_scale

VERDICTS: dict[Verdict, tuple[str, str]] = {
    "kept": ("kept", AMBER),
    "size": ("too small or too large", GREY),
    "deviation": ("too even", BLUE),
}
"""Words and colours of what the filters make of a box."""

GAMMA = 0.4
"""Working images are shown with this exponent: most of a night frame is dark."""

PANEL_IN = (4.2, 3.3)


def stage_picture(frame: Frame, result: FrameResult, config: PipelineConfig) -> bytes:
    """A PNG with a panel for each stage that made `result` of `frame`, and one for the road ahead where it is known.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        ValueError: If the frame is smaller than one working pixel.
    """
    from matplotlib.figure import Figure

    proposer = ReferenceProposer(in_working_pixels(config.proposals))
    frame = full_scale(frame, config.guard.white_level)
    image = resized(frame.image, config.proposals)
    stages = proposer.stages(image)
    if stages is None:
        raise ValueError(f"{frame.path}: expected an image of at least one working pixel, got {frame.image.shape}")
    figure = Figure(figsize=(3 * PANEL_IN[0], 3 * PANEL_IN[1]), layout="constrained")
    panels = iter(figure.subplots(3, 3).flat)

    show_image(next(panels), frame.image, "frame", norm="asinh")
    _show_working(next(panels), stages.blurred, "I: reduced, stretched, blurred")
    _show_working(next(panels), stages.mean, "local mean of I")
    _show_working(next(panels), stages.threshold, "threshold T")
    show_image(next(panels), stages.binary, f"I > T: {np.count_nonzero(stages.binary)} pixels")
    show_image(next(panels), _coloured(stages.labels), f"{int(stages.labels.max())} blobs")
    judged = proposer.judged(stages, image.shape[1])
    axes = next(panels)
    num_kept = sum(verdict == "kept" for _, verdict in judged)
    num_still = num_kept - len(result.proposals)
    words = f", {num_still} of them stand still" if num_still else ""
    _show_working(axes, stages.blurred, f"{len(judged)} boxes: {num_kept} pass the filters{words}")
    for verdict, (words, colour) in VERDICTS.items():
        boxes = [box for box, its_verdict in judged if its_verdict == verdict]
        _add_boxes(axes, np.array(boxes).reshape(-1, 4), colour)
        axes.plot([], [], "s", color=colour, label=f"{words}: {len(boxes)}")
    axes.legend(loc="lower left", fontsize=7)
    _show_scores(next(panels), frame, result, config)
    _show_road(next(panels), frame)
    return png(figure)


def _show_working(axes: Any, image: Floats, title: str) -> None:
    show_image(axes, np.clip(image, 0.0, 1.0) ** GAMMA, title, vmin=0.0, vmax=1.0)


def _coloured(labels: NDArray[np.int32]) -> NDArray[np.float64]:
    """Shape (H, W, 3): each blob in a colour of its own, on black."""
    colours = 0.35 + 0.65 * np.random.default_rng(0).random((int(labels.max()) + 1, 3))
    colours[0] = 0.0
    return np.asarray(colours[labels])


def _add_boxes(axes: Any, boxes_xyxy: NDArray[Any], colour: str, line: str = "-", width: float = 0.9) -> None:
    from matplotlib.patches import Rectangle

    for x1, y1, x2, y2 in (boxes_xyxy - 0.5).tolist():  # pixels are centred on whole numbers
        axes.add_patch(
            Rectangle((x1, y1), x2 - x1, y2 - y1, fill=False, edgecolor=colour, linestyle=line, linewidth=width)
        )


def _show_scores(axes: Any, frame: Frame, result: FrameResult, config: PipelineConfig) -> None:
    """The proposals with their scores, and around accepted ones the part of the frame that the classifier sees."""
    detections = result.detections
    if detections is None:
        show_image(axes, frame.image, "no classifier", norm="asinh")
        return
    accepted = detections.is_accepted
    show_image(axes, frame.image, f"enlarged boxes and scores: {np.count_nonzero(accepted)} accepted", norm="asinh")
    boxes = detections.boxes_xyxy_px
    centres, sizes = boxes[:, :2] + (boxes[:, 2:] - boxes[:, :2]) // 2, boxes[:, 2:] - boxes[:, :2]
    support = OnnxClassifier(config.classifier).spec.support
    enlarged = np.concatenate([centres - support * sizes, centres + support * sizes], axis=1)
    limits = [frame.width_px, frame.height_px] * 2
    _add_boxes(axes, np.clip(enlarged[accepted], 0, limits), GREEN, ":")
    _add_boxes(axes, boxes[~accepted], GREY, width=0.6)
    _add_boxes(axes, boxes[accepted], GREEN, width=1.4)
    for (x1, y1, _, _), score in zip(boxes[accepted].tolist(), detections.scores[accepted].tolist(), strict=True):
        axes.text(x1, y1 - 4, f"{score:.2f}", color=GREEN, fontsize=7)


def _show_road(axes: Any, frame: Frame) -> None:
    if frame.camera is None or frame.road is None:
        axes.set_axis_off()
        return
    show_road(axes, frame.image, frame.camera, frame.road)
