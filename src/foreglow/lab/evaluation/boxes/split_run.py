"""A pipeline's predictions for a whole split, with the run-time of its stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource
from foreglow.pipeline import Pipeline
from foreglow.runs.predictions import Predictions
from foreglow.types import Frame, FrameResult
from foreglow.types.arrays import check_kind

Progress: TypeAlias = Callable[[Frame, FrameResult], None]
"""Called after each frame; a result sink's `write` is one."""

Change: TypeAlias = Callable[[Frame], Frame]
"""What happens to a frame before the pipeline sees it; its time is not the pipeline's."""


@dataclass(frozen=True, slots=True, eq=False)
class SplitRun:
    """What a pipeline made of a split.

    Attributes:
        image_ids: The F images that were run, in order.
        predictions: All proposals of each image by its id, with their scores; without a classifier, without scores.
        stage_ms: By stage, shape (F,), its run-time for each image in milliseconds; reading and decoding are in none.
    """

    image_ids: tuple[int, ...]
    predictions: Predictions
    stage_ms: Mapping[str, NDArray[np.float64]]

    @classmethod
    def of(cls, results: Sequence[FrameResult]) -> SplitRun:
        """From the results of all images."""
        is_scored = all(result.detections is not None for result in results)
        stages = dict.fromkeys(name for result in results for name in result.stage_ms)
        boxes = {result.frame: result.proposals.boxes_xyxy_px.astype(np.float64) for result in results}
        scores = {
            result.frame: np.ones(len(result.proposals))
            if result.detections is None
            else result.detections.scores.astype(np.float64)
            for result in results
        }
        return cls(
            image_ids=tuple(boxes),
            predictions=Predictions(boxes, scores, is_scored),
            stage_ms={stage: np.array([result.stage_ms.get(stage, 0.0) for result in results]) for stage in stages},
        )

    @property
    def total_ms(self) -> NDArray[np.float64]:
        """Shape (F,): the stages' sum for each image, milliseconds."""
        return sum(self.stage_ms.values(), start=np.zeros(len(self.image_ids)))


def run_split(dataset: LabelledSource, pipeline: Pipeline, progress: Progress | None = None) -> SplitRun:
    """Runs `pipeline`, after a reset, over the selected images of `dataset` in order.

    Args:
        dataset: The split; images that it skips are in no result.
        pipeline: What runs; it is used up to its last frame, and not reset afterwards.
        progress: Called after each frame.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If an image is broken, the model does not fit, or there is no data set or no pipeline.
    """
    check_kind("dataset", dataset, LabelledSource)
    check_kind("pipeline", pipeline, Pipeline)
    return run_variants(dataset, {"": (pipeline, lambda frame: frame)}, progress)[""]


def run_variants(
    dataset: LabelledSource, variants: Mapping[str, tuple[Pipeline, Change]], progress: Progress | None = None
) -> dict[str, SplitRun]:
    """Like `run_split` for several pipelines at once, each with its own change of the frames; decodes only once.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If an image is broken, or a model does not fit.
    """
    results: dict[str, list[FrameResult]] = {name: [] for name in variants}
    for pipeline, _ in variants.values():
        pipeline.reset()
    for frame in dataset:
        for name, (pipeline, change) in variants.items():
            results[name].append(pipeline.step(change(frame)))
        if progress is not None and variants:
            progress(frame, results[name][-1])
    return {name: SplitRun.of(of_variant) for name, of_variant in results.items()}
