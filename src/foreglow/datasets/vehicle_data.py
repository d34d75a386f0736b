"""What the car knew while a drive was recorded: calibration, motion and the road ahead, added to its frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.source import FileSource, FrameSource
from foreglow.geometry import Camera
from foreglow.types import EgoMotion, Frame, RoadAhead


class VehicleData(Protocol):
    """Looks up what the car knew at a frame, by its sequence and its time."""

    def camera(self, frame: Frame) -> Camera | None:
        """Calibration of the camera that took `frame`, for images of its size; None where unknown."""
        ...

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Motion of the vehicle at the time of `frame`; None where unknown."""
        ...

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead as the car knew it at the time of `frame`; None where unknown."""
        ...

    def is_reported(self, frame: Frame) -> bool | None:  # noqa: ARG002
        """Whether the car's production system reports a vehicle at the time of `frame`; None where unknown."""
        return None


class Equipped:
    """The frames of another source with vehicle data.

    A frame keeps what it already carries where the data know nothing.

    Attributes:
        source: The other source.
        data: The vehicle data of its frames.
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
    """`frame` with what `data` knows about it.

    Raises:
        ValueError: If the calibration is for images of another size, or a file behind the data is broken.
    """
    is_reported = data.is_reported(frame)
    return dataclasses.replace(
        frame,
        camera=data.camera(frame) or frame.camera,
        motion=data.motion(frame) or frame.motion,
        road=data.road(frame) or frame.road,
        is_reported=frame.is_reported if is_reported is None else is_reported,
    )


def origin_of(source: FrameSource) -> Path | None:
    """The file or folder that `source` reads, as it was given; None for sources that are no `FileSource`."""
    if isinstance(source, Equipped):
        return origin_of(source.source)
    return source.origin if isinstance(source, FileSource) else None


def part_names(source: FrameSource) -> tuple[str, ...]:
    """Names of the sequences in the order of their frames; a single empty name for a source without sequences."""
    if isinstance(source, Equipped):
        return part_names(source.source)
    return source.directories if isinstance(source, LabelledSource) else ("",)


def part_of(source: FrameSource, name: str) -> FrameSource:
    """The frames of the sequence that `part_names` calls `name`."""
    if isinstance(source, Equipped):
        return Equipped(part_of(source.source, name), source.data)
    return source.only(name) if isinstance(source, LabelledSource) else source
