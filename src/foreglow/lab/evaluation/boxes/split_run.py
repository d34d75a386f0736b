"""A pipeline's predictions for a whole split, with the run-time of its stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import PVDN
from foreglow.pipeline import Pipeline
from foreglow.runs.predictions import Predictions
from foreglow.types import Frame, FrameResult

Progress: TypeAlias = Callable[[Frame, FrameResult], None]
"""Called after each frame; a result sink's `write` is one."""

Change: TypeAlias = Callable[[Frame], Frame]
"""What happens to a frame before the pipeline sees it; its time is not the pipeline's."""


@dataclass(frozen=True, slots=True, eq=False)
class SplitRun:
    """What a pipeline made of a split.

    Attributes:
        image_ids: The images that were run, in order.
        predictions: All proposals of each image by its id, with their scores; without a classifier, without scores.
        stage_ms: By stage, shape (F,), its run-time for each image in milliseconds; reading and decoding are in none.
        timestamp_ns: Time of exposure by image id, as `Frame.timestamp_ns`.
        sequence_of: Id of its sequence by image id.
    """

    image_ids: tuple[int, ...]
    predictions: Predictions
    stage_ms: Mapping[str, NDArray[np.float64]]
    timestamp_ns: Mapping[int, int]
    sequence_of: Mapping[int, int]

    @property
    def total_ms(self) -> NDArray[np.float64]:
        """Shape (F,): the stages' sum for each image, milliseconds."""
        return sum(self.stage_ms.values(), start=np.zeros(len(self.image_ids)))


def run_split(dataset: PVDN, pipeline: Pipeline, progress: Progress | None = None) -> SplitRun:
    """Runs `pipeline` over the selected images of `dataset` in order, and resets it at the start of each sequence.

    Args:
        dataset: The split; images that it skips are in no result.
        pipeline: What runs; it is used up to its last frame, and not reset afterwards.
        progress: Called after each frame.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If an image is broken, or the model does not fit.
    """
    return run_variants(dataset, {"": (pipeline, _unchanged)}, progress)[""]


def run_variants(
    dataset: PVDN, variants: Mapping[str, tuple[Pipeline, Change]], progress: Progress | None = None
) -> dict[str, SplitRun]:
    """Like `run_split` for several pipelines at once, each with its own change of the frames; decodes only once.

    Args:
        dataset: The split.
        variants: By name, a pipeline of its own, and what is done to the frames that it sees.
        progress: Called after each frame, with the last variant's result.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If an image is broken, or a model does not fit.
    """
    gathered = {name: _Gathered() for name in variants}
    sequence: int | None = None
    for frame in dataset:
        its_sequence = dataset.sequence(frame.frame).id
        for name, (pipeline, change) in variants.items():
            if its_sequence != sequence:
                pipeline.reset()
            result = pipeline.step(change(frame))
            gathered[name].add(result, its_sequence)
        sequence = its_sequence
        if progress is not None and variants:
            progress(frame, result)
    return {name: one.as_run() for name, one in gathered.items()}


@dataclass(slots=True)
class _Gathered:
    """Results so far, frame by frame."""

    results: list[FrameResult] = field(default_factory=list)
    sequences: list[int] = field(default_factory=list)

    def add(self, result: FrameResult, sequence: int) -> None:
        self.results.append(result)
        self.sequences.append(sequence)

    def as_run(self) -> SplitRun:
        image_ids = tuple(result.frame for result in self.results)
        stages = dict.fromkeys(name for result in self.results for name in result.stage_ms)
        boxes = {one.frame: one.proposals.boxes_xyxy_px.astype(np.float64) for one in self.results}
        is_scored = all(result.detections is not None for result in self.results)
        return SplitRun(
            image_ids=image_ids,
            predictions=Predictions(boxes, {one.frame: _scores(one) for one in self.results}, is_scored),
            stage_ms={name: np.array([one.stage_ms.get(name, 0.0) for one in self.results]) for name in stages},
            timestamp_ns={one.frame: one.timestamp_ns for one in self.results},
            sequence_of=dict(zip(image_ids, self.sequences, strict=True)),
        )


def _scores(result: FrameResult) -> NDArray[np.float64]:
    if result.detections is None:
        return np.ones(len(result.proposals))
    return result.detections.scores.astype(np.float64)


def _unchanged(frame: Frame) -> Frame:
    return frame
