"""The plots of the evaluation's page."""

from __future__ import annotations

import math

import numpy as np

from foreglow.lab.evaluation.boxes.breakdown import Breakdown
from foreglow.lab.evaluation.boxes.examination import Ranking
from foreglow.lab.evaluation.boxes.score_calibration import Calibration
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, PALE, png, subplots

FEWEST_FALSE_BOXES = 0.01
"""Left end of the axis of false boxes a frame."""


def curve_plot(ranking: Ranking, threshold: float) -> bytes:
    """Precision, recall and F over the threshold, and precision over recall."""
    figure, axes = subplots(2)
    curve = ranking.curve
    axes[0].plot(curve.thresholds, curve.precision, color=BLUE, label="precision")
    axes[0].plot(curve.thresholds, curve.recall, color=AMBER, label="recall")
    axes[0].plot(curve.thresholds, curve.f1, color=INK, label="F")
    axes[0].axvline(threshold, color=GREY, linewidth=0.8, linestyle=":")
    axes[0].set(xlabel="threshold on the score", ylim=(0, 1), xlim=(0, 1))
    axes[0].legend(frameon=False)
    axes[1].plot(curve.recall, curve.precision, color=BLUE)
    axes[1].set(xlabel="recall", ylabel="precision", ylim=(0, 1), xlim=(0, 1))
    axes[1].set_title(f"average precision {ranking.average_precision:.3f}", fontsize=10, loc="left")
    return png(figure)


def hidden_plot(ranking: Ranking, breakdown: Breakdown) -> bytes:
    """Recall of hidden vehicles' light over false boxes a frame in images without any vehicle's light."""
    figure, axes = subplots(1)
    curve = ranking.hidden
    false_boxes = np.maximum(curve.false_boxes_per_frame, FEWEST_FALSE_BOXES)
    # Between two corners, the recall of the one with fewer false boxes can be had.
    axes[0].step(false_boxes[::-1], curve.recall[::-1], color=AMBER, where="post")
    group = breakdown.group("sight", "hidden")
    if group is not None and not math.isnan(breakdown.false_boxes_empty.per_frame):
        at_threshold = max(breakdown.false_boxes_empty.per_frame, FEWEST_FALSE_BOXES)
        axes[0].plot([at_threshold], [group.recall], "o", color=INK, label=f"threshold {breakdown.threshold:g}")
        axes[0].axhline(group.ceiling, color=GREY, linewidth=0.8, linestyle=":", label="all proposals")
        axes[0].legend(frameon=False, loc="lower right")
    axes[0].set(
        xscale="log",
        ylim=(0, 1),
        xlabel="false boxes a frame, images without any vehicle's light",
        ylabel="recall, light of hidden vehicles",
    )
    return png(figure)


def reliability_plot(calibration: Calibration) -> bytes:
    """Share of light artifacts over the mean score, in bins of equal counts and in bins of a tenth."""
    figure, axes = subplots(1, width_in=4.0, height_in=3.8)
    axes[0].plot([0, 1], [0, 1], color=GREY, linewidth=0.8, linestyle=":")
    kinds = (("tenths of the score", calibration.tenths, AMBER), ("equal counts", calibration.bins, BLUE))
    for label, bins, color in kinds:
        scores, shares = [part.mean_score for part in bins], [part.share for part in bins]
        axes[0].plot(scores, shares, color=color, marker="o", markersize=4, label=label)
    axes[0].legend(frameon=False)
    axes[0].set(xlabel="mean score of a bin", ylabel="share with a light artifact", xlim=(0, 1), ylim=(0, 1))
    axes[0].set_title(f"calibration error {calibration.ece:.3f}", fontsize=10, loc="left")
    return png(figure)


def kinds_plot(breakdown: Breakdown) -> bytes:
    """Recall by kind, and by what else divides the lights, beside the ceiling of all proposals."""
    groups = breakdown.groups
    listed = [*groups["kind"], *groups["sight"], *groups["strength"]]
    figure, axes = subplots(1, width_in=7.0, height_in=0.9 + 0.3 * len(listed))
    rows = np.arange(len(listed))
    axes[0].barh(rows, [group.ceiling for group in listed], color=PALE, height=0.7, label="all proposals")
    axes[0].barh(rows, [group.recall for group in listed], color=AMBER, height=0.4, label="accepted")
    axes[0].set_yticks(rows, [f"{group.name} ({group.num})" for group in listed])
    axes[0].invert_yaxis()
    axes[0].set(xlabel="recall", xlim=(0, 1))
    axes[0].legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return png(figure)


def distance_plot(breakdown: Breakdown) -> bytes:
    """F and recall over the distance to the vehicle, with the ceiling of all proposals."""
    groups = breakdown.groups["distance"]
    figure, axes = subplots(1)
    curves = {
        "F": ("f1", INK, "-"),
        "recall": ("recall", AMBER, "-"),
        "recall of all proposals": ("ceiling", GREY, ":"),
    }
    for label, (name, color, style) in curves.items():
        values = [getattr(group, name) for group in groups]
        axes[0].plot(values, color=color, linestyle=style, marker="o", markersize=4, label=label)
    axes[0].set_xticks(range(len(groups)), [group.name.removesuffix(" m") for group in groups])
    axes[0].set(xlabel="metres to the vehicle", ylim=(0, 1))
    axes[0].legend(frameon=False)
    return png(figure)
