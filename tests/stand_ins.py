"""Small frames, sources and classifiers that tests stand the real ones in with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.config import PipelineConfig, ProposalConfig
from foreglow.types import Detections, Frame, FrameResult, Image, Proposals, Tracks, TrackState

REFERENCE = PipelineConfig(proposals=ProposalConfig(backend="reference", reference_width_px=128))
"""The paper's preset for the width of `night_image`, on the back end that needs no native core."""


def night_image(seed: int = 0, height_px: int = 96, width_px: int = 128, dtype: type = np.uint8) -> Image:
    """A noisy dark image with a bright blob that the paper's preset proposes at reference width `width_px`."""
    generator = np.random.default_rng(seed)
    image = generator.integers(2, 9, (height_px, width_px)).astype(np.float64)
    rows, columns = np.mgrid[:height_px, :width_px]
    centre = (
        generator.integers(height_px // 3, 2 * height_px // 3),
        generator.integers(width_px // 3, 2 * width_px // 3),
    )
    image += 220.0 * np.exp(-((rows - centre[0]) ** 2 + (columns - centre[1]) ** 2) / 50.0)
    scale = np.iinfo(dtype).max / 255
    return (np.clip(image, 0, 255) * scale).astype(dtype)


def night_frames(count: int, sequence: str = "S00001") -> list[Frame]:
    """Frames of `night_image`, 50 ms apart, with even numbers as in PVDN."""
    return [Frame(night_image(k), timestamp_ns=k * 50_000_000, frame=2 * k, sequence=sequence) for k in range(count)]


class ListSource:
    """A source over frames in memory."""

    name = "stand-in"
    rate_hz: float | None = 20.0

    def __init__(self, frames: Sequence[Frame], skipped: Sequence[str] = ()) -> None:
        self._frames = frames
        self.skipped = list(skipped)

    @property
    def num_frames(self) -> int | None:
        return len(self._frames)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._frames)


def result_of(
    frame: Frame, boxes: Sequence[Sequence[int]], scores: Sequence[float] | None = None, threshold: float = 0.5
) -> FrameResult:
    """A result with these boxes, classified where scores are given."""
    array: NDArray[np.int32] = np.array(boxes, np.int32).reshape(-1, 4)
    proposals = Proposals(array)
    detections = None if scores is None else Detections(proposals, np.array(scores, np.float32), threshold)
    return FrameResult(frame.frame, frame.timestamp_ns, proposals, detections, {"proposals": 0.25})


def tracks_of(
    boxes: Sequence[Sequence[float]],
    states: Sequence[TrackState] | None = None,
    ids: Sequence[int] | None = None,
    ranges_m: Sequence[float] | None = None,
    detections: Sequence[int] | None = None,
) -> Tracks:
    """Tracks with these boxes: confirmed, numbered from 0, each following the detection in its place."""
    count = len(boxes)
    ranges = np.full(count, np.nan) if ranges_m is None else np.array(ranges_m, np.float64)
    followed = range(count) if detections is None else detections
    return Tracks(
        ids=np.array(range(count) if ids is None else ids, np.int64),
        states=np.array([TrackState.CONFIRMED] * count if states is None else states, np.int64),
        boxes_xyxy_px=np.array(boxes, np.float64).reshape(-1, 4),
        confidences=np.full(count, 0.75),
        num_hits=np.full(count, 6),
        num_misses=np.array([int(index < 0) for index in followed], np.int64),
        ages_s=np.full(count, 0.25),
        ranges_m=ranges,
        sigmas_m=np.where(np.isnan(ranges), np.inf, 0.1 * ranges),
        detections=np.array(followed, np.int64),
    )
