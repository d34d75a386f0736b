"""The detector's figures when its images are disturbed."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource
from foreglow.lab.evaluation.boxes.breakdown import SplitLabels, break_down, match_lights
from foreglow.lab.evaluation.boxes.disturbances import DISTURBANCES, Disturbance
from foreglow.lab.evaluation.boxes.split_run import Progress, SplitRun, run_variants
from foreglow.lab.evaluation.ratios import ratio
from foreglow.pipeline import Pipeline


@dataclass(frozen=True, slots=True)
class RobustnessRow:
    """The figures under one disturbance.

    Attributes:
        name: Of the disturbance.
        f1: F as `evaluate_boxes` has it, NaN where not defined.
        precision: Its precision.
        recall: Its recall.
        ceiling: Recall of all proposals.
        recall_hidden: Recall of hidden vehicles' light.
        false_boxes_per_frame: In all images.
        false_boxes_per_empty_frame: In images without any vehicle's light.
        proposals_per_frame: Boxes that are proposed.
    """

    name: str
    f1: float
    precision: float
    recall: float
    ceiling: float
    recall_hidden: float
    false_boxes_per_frame: float
    false_boxes_per_empty_frame: float
    proposals_per_frame: float


def robustness(
    dataset: LabelledSource,
    labels: SplitLabels,
    config: PipelineConfig,
    *,
    disturbances: Sequence[Disturbance] = DISTURBANCES,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[RobustnessRow, ...]:
    """The figures of the configured pipeline under each disturbance, at its own threshold, in one pass over the images.

    Args:
        dataset: The split.
        labels: Its labels.
        config: Of the pipeline; each disturbance has a pipeline of its own.
        disturbances: What is done to the images.
        seed: Of the disturbances; the same seed, the same images.
        progress: Called after each image.

    Raises:
        FileNotFoundError: If an image or the model is missing.
        ValueError: If an image is broken, the model does not fit, or two disturbances have the same name.
    """
    names = [disturbance.name for disturbance in disturbances]
    if len(set(names)) < len(names):
        raise ValueError(f"disturbances: expected each name once, got {', '.join(names)}")
    variants = {
        disturbance.name: (Pipeline(config), functools.partial(disturbance, seed=seed)) for disturbance in disturbances
    }
    runs = run_variants(dataset, variants, progress)
    return tuple(_row(name, run, labels, config.classifier.score_threshold) for name, run in runs.items())


def _row(name: str, run: SplitRun, labels: SplitLabels, threshold: float) -> RobustnessRow:
    matched = match_lights(labels, run.predictions)
    broken_down = break_down(matched, threshold)
    whole, hidden = broken_down.whole, broken_down.group("sight", "hidden")
    matches = matched.matches
    return RobustnessRow(
        name=name,
        f1=whole.f1,
        precision=broken_down.precision,
        recall=whole.recall,
        ceiling=whole.ceiling,
        recall_hidden=math.nan if hidden is None else hidden.recall,
        false_boxes_per_frame=broken_down.false_boxes.per_frame,
        false_boxes_per_empty_frame=broken_down.false_boxes_empty.per_frame,
        proposals_per_frame=ratio(matches.num_boxes, matches.num_images),
    )
