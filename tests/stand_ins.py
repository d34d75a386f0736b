"""Small frames, sources and classifiers that tests stand the real ones in with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.config import PipelineConfig, ProposalConfig
from foreglow.types import Detections, Frame, FrameResult, Image, Proposals

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
