"""What the car knew while a drive was recorded: calibration, motion and the road ahead, put beside the images."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

from foreglow.datasets.source import FrameSource
from foreglow.geometry import Camera
from foreglow.types import EgoMotion, Frame, RoadAhead


class VehicleData(Protocol):
    """Answers for each frame of a source, by its sequence and its time."""

    def camera(self, frame: Frame) -> Camera | None:
        """Calibration of the camera that took `frame`, for images of its size; None where unknown."""
        ...

    def motion(self, frame: Frame) -> EgoMotion | None:
        """How the vehicle moved at the time of `frame`; None where unknown."""
        ...

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead as the car knew it at the time of `frame`; None where unknown."""
        ...


class Equipped:
    """The frames of another source, each with what a `VehicleData` knows of it.

    What a frame already carries stays where the data know nothing.

    Attributes:
        source: The other source.
        data: What is known of its frames.
    """

    def __init__(self, source: FrameSource, data: VehicleData) -> None:
        self.source = source
        self.data = data

    @property
    def name(self) -> str:
        """The other source's."""
        return self.source.name

    @property
    def rate_hz(self) -> float | None:
        """The other source's."""
        return self.source.rate_hz

    @property
    def num_frames(self) -> int | None:
        """The other source's."""
        return self.source.num_frames

    @property
    def skipped(self) -> Sequence[str]:
        """The other source's."""
        return self.source.skipped

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.source:
            yield equip(frame, self.data)


def equip(frame: Frame, data: VehicleData) -> Frame:
    """`frame` with what `data` knows of it.

    Raises:
        ValueError: If the calibration is for images of another size, or a file behind the data is broken.
    """
    return dataclasses.replace(
        frame,
        camera=data.camera(frame) or frame.camera,
        motion=data.motion(frame) or frame.motion,
        road=data.road(frame) or frame.road,
    )
