"""Predictions of a trained YOLO for a split, in full-frame pixels."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource
from foreglow.lab.evaluation import Predictions
from foreglow.lab.learning.yolo.backends import make_backend
from foreglow.lab.learning.yolo.export import Progress, squashed
from foreglow.lab.learning.yolo.interface import Detector
from foreglow.lab.learning.yolo.training import YoloRun
from foreglow.types import Frame


@dataclass(frozen=True, slots=True, eq=False)
class YoloPredictions:
    """The predictions of a YOLO for a split.

    Attributes:
        predictions: Boxes and scores by image id, full-frame pixels, best first; all with a score above 0.01.
        frame_ms: Shape (F,): run-time of each frame in milliseconds, with scaling but without reading and decoding.
    """

    predictions: Predictions
    frame_ms: NDArray[np.float64]


def predict_yolo(
    run: YoloRun, dataset: LabelledSource, *, num_threads: int | None = None, progress: Progress | None = None
) -> YoloPredictions:
    """Runs the network of `run` over the selected images of `dataset`.

    Args:
        run: A finished training.
        dataset: The split.
        num_threads: Number of CPU threads; None does not change it.
        progress: Called after each frame.

    Raises:
        FileNotFoundError: If the weights or an image are missing.
        ValueError: If an image is broken, or does not have 8 bits.
        ModuleNotFoundError: If the library is not installed.
    """
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    times_ms: list[float] = []
    if not run.weights.is_file():
        raise FileNotFoundError(f"{run.weights}: no such file, expected the weights of the run {run.folder}")
    detector = make_backend(run.config.backend).load(run.weights, run.config)
    with _threads(num_threads):
        for num_done, frame in enumerate(dataset, start=1):
            started = time.perf_counter_ns()
            boxes[frame.frame], scores[frame.frame] = detect_in_frame(detector, frame, run.export_size_px)
            times_ms.append((time.perf_counter_ns() - started) / 1e6)
            if progress is not None:
                progress(num_done, len(dataset))
    return YoloPredictions(Predictions(boxes, scores), np.array(times_ms))


def detect_in_frame(detector: Detector, frame: Frame, size_px: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes (N, 4), xyxy, full-frame pixels, clipped to the frame, and scores (N,), both sorted by falling score.

    Args:
        detector: A trained network.
        frame: The frame, 8 bits.
        size_px: Side of the square that the frame is scaled to.

    Raises:
        ValueError: If the frame does not have 8 bits.
    """
    boxes, scores = detector.detect(squashed(frame.image, size_px, frame.path))
    size_xyxy_px = np.array([frame.width_px, frame.height_px] * 2, np.float64)
    in_frame = np.clip(boxes / size_px * size_xyxy_px, 0.0, size_xyxy_px)
    order = np.argsort(-scores, kind="stable")
    return in_frame[order], scores[order]


@contextlib.contextmanager
def _threads(num_threads: int | None) -> Iterator[None]:
    """Lets torch use this many threads inside the block."""
    if num_threads is None:
        yield
        return
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(num_threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
