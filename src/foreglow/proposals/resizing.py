"""Proposals at any size: frames are resized first, where no whole factor gives the size that is asked for."""

from __future__ import annotations

from typing import Protocol, cast

import cv2
import numpy as np

from foreglow.config import ProposalConfig
from foreglow.types import Image, Proposals


class _BackEnd(Protocol):
    def propose(self, image: Image) -> Proposals: ...


class ResizingProposer:
    """The proposals of resized frames, in pixels of the frames themselves: outwards to whole ones."""

    def __init__(self, config: ProposalConfig, back_end: type[_BackEnd]) -> None:
        self.config = config
        self._proposer = back_end(in_working_pixels(config))  # type: ignore[call-arg]

    def propose(self, image: Image) -> Proposals:
        """The proposals of `image`: shape (height, width), uint8 or uint16, any strides."""
        small = resized(image, self.config)
        boxes_xyxy = self._proposer.propose(small).boxes_xyxy_px.astype(np.int64)
        # In whole numbers: a factor is rounded, and a box at the border would reach beyond the frame.
        size, small_size = np.array(image.shape[::-1]), np.array(small.shape[::-1])
        corners = (boxes_xyxy[:, :2] * size // small_size, -(-boxes_xyxy[:, 2:] * size // small_size))
        return Proposals(np.concatenate(corners, axis=1).astype(np.int32))


def in_working_pixels(config: ProposalConfig) -> ProposalConfig:
    """`config` for frames that `resized` has resized; itself where none are."""
    if config.working_size_px is None:
        return config
    sizes = {"working_size_px": None, "reduction": 1, "reference_width_px": config.working_size_px[0]}
    return config.model_copy(update=sizes)


def resized(image: Image, config: ProposalConfig) -> Image:
    """`image` at the size that `config` asks for, bilinearly; itself where it asks for none."""
    if config.working_size_px is None:
        return image
    small = cv2.resize(np.ascontiguousarray(image), config.working_size_px, interpolation=cv2.INTER_LINEAR)
    return cast("Image", small)
