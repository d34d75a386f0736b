"""What the car knew while a drive was recorded: calibration, motion and the road ahead, added to its frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.source import FileSource, FrameSource, check_source
from foreglow.geometry import Camera
from foreglow.types import EgoMotion, Frame, RoadAhead
from foreglow.types.arrays import check_kind, check_members
from foreglow.wording import shortened


class VehicleData(Protocol):
    """Looks up what the car knew at a frame, by its sequence and its time."""

    def camera(self, frame: Frame) -> Camera | None:
        """Calibration of the camera that took `frame`, for images of its size; None where unknown."""
        ...

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Motion of the vehicle at the time of `frame`; None where unknown."""
        ...

    @property
    def tells_motion(self) -> bool:
        """Whether the motion is unknown where it says nothing, whatever else there is, such as a recorded motion."""
        return False

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead as the car knew it at the time of `frame`; None where unknown."""
        ...

    def is_reported(self, frame: Frame) -> bool | None:  # noqa: ARG002
        """Whether the car's production system reports a vehicle at the time of `frame`; None where unknown."""
        return None

    @property
    def of_one_drive(self) -> Sequence[str]:
        """What of the data is looked up by time alone, such as a log, and so belongs to one drive; for messages."""
        return ()


class Equipped:
    """The frames of another source with vehicle data.

    A frame keeps what it already carries where the data know nothing, but for a motion that is theirs to tell.

    Attributes:
        source: The other source.
        data: The vehicle data of its frames.
    """

    def __init__(self, source: FrameSource, data: VehicleData) -> None:
        """Takes both.

        Raises:
            ValueError: If one of them is something else.
        """
        check_source("source", source)
        check_members("data", data, "vehicle data", "camera", "motion", "road", "of_one_drive")
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
        if not self.data.of_one_drive:
            for frame in self.source:
                yield equip(frame, self.data)
            return
        spans_ns: dict[str, tuple[int, int]] = {}
        for frame in self.source:
            check_kind("source", frame, Frame)
            first_ns, last_ns = spans_ns.get(frame.sequence, (frame.timestamp_ns, frame.timestamp_ns))
            span_ns = min(first_ns, frame.timestamp_ns), max(last_ns, frame.timestamp_ns)
            if len(spans_ns) > (frame.sequence in spans_ns) and spans_ns.get(frame.sequence) != span_ns:
                _check_apart(self, spans_ns, frame.sequence, span_ns)
            spans_ns[frame.sequence] = span_ns
            yield equip(frame, self.data)

    def check(self, limit: int | None = None) -> None:
        """Checks that a log or poses are not applied to several drives, as far as this is known before reading frames.

        Args:
            limit: So many frames will be read; None for all.

        Raises:
            ValueError: If sequences of a set, which are drives of their own, overlap in time.
        """
        source = self.source
        if isinstance(source, Equipped):
            Equipped(source.source, self.data).check(limit)
        elif isinstance(source, LabelledSource) and self.data.of_one_drive:
            ids: dict[str, list[int]] = {}
            for image_id in source.frame_ids[:limit]:
                ids.setdefault(source.sequence(image_id).directory, []).append(image_id)
            spans_ns: dict[str, tuple[int, int]] = {}
            for name, (first, *others) in ids.items():
                span_ns = timestamp_ns(source, first), timestamp_ns(source, (others or [first])[-1])
                _check_apart(self, spans_ns, name, span_ns)
                spans_ns[name] = span_ns


def fitting(camera: Camera, width_px: int, height_px: int, origin: object) -> Camera:
    """The calibration, scaled to frames of another size.

    Raises:
        ValueError: If the frames' sides have another ratio than the calibration's, which was read from `origin`.
    """
    if (camera.width_px, camera.height_px) == (width_px, height_px):
        return camera
    if not camera.has_shape_of(width_px, height_px):
        raise ValueError(
            f"{origin}: image: expected the frames' size or its multiple, {width_px}x{height_px} px, "
            f"got {camera.width_px}x{camera.height_px} px"
        )
    return camera.scaled(width_px, height_px)


def timestamp_ns(source: LabelledSource, image_id: int) -> int:
    """When an image was taken, as its frame has it."""
    return round(source.sequence(image_id).start_time_ms * 1_000_000) + round(source.time_s(image_id) * 1e9)


def _check_apart(
    equipped: Equipped, spans_ns: Mapping[str, tuple[int, int]], name: str, span_ns: tuple[int, int]
) -> None:
    """ValueError if the sequence `name` overlaps another in time: by its time, a log would say the same of both."""
    for other, (first_ns, last_ns) in spans_ns.items():
        if other != name and max(first_ns, span_ns[0]) <= min(last_ns, span_ns[1]):
            lasts = f"{other} lasts from {first_ns / 1e9:.3f} to {last_ns / 1e9:.3f} s"
            raise ValueError(
                f"{' and '.join(equipped.data.of_one_drive)}: expected one drive, to which such a file belongs, got "
                f"sequences of {equipped.name} that overlap in time: {lasts}, {name} begins at "
                f"{span_ns[0] / 1e9:.3f} s; give one sequence as the source{_example(equipped.source, other)}"
            )


def _example(source: FrameSource, directory: str) -> str:
    """How one sequence of a split is given."""
    folder = source.root / "images" / directory if isinstance(source, LabelledSource) else None
    return f", such as {folder}" if folder is not None and folder.is_dir() else ""


def equip(frame: Frame, data: VehicleData) -> Frame:
    """`frame` with what `data` knows about it.

    Raises:
        ValueError: If the calibration is for images of another size, or a file behind the data is broken.
    """
    check_kind("source", frame, Frame)
    motion, is_reported = data.motion(frame), data.is_reported(frame)
    return dataclasses.replace(
        frame,
        camera=data.camera(frame) or frame.camera,
        motion=motion if data.tells_motion else motion or frame.motion,
        road=data.road(frame) or frame.road,
        is_reported=frame.is_reported if is_reported is None else is_reported,
    )


def origin_of(source: FrameSource) -> Path | None:
    """The file or folder that `source` reads, as it was given; None for sources that are no `FileSource`."""
    if isinstance(source, Equipped):
        return origin_of(source.source)
    return source.origin if isinstance(source, FileSource) else None


def lost_parts(source: FrameSource) -> Sequence[str]:
    """`FileSource.lost_parts` of what `source` reads; empty for sources that are no `FileSource`."""
    if isinstance(source, Equipped):
        return lost_parts(source.source)
    return source.lost_parts if isinstance(source, FileSource) else ()


def unread_end(source: FrameSource) -> Sequence[str]:
    """`FileSource.unread_end` of what `source` reads; empty for sources that are no `FileSource`."""
    if isinstance(source, Equipped):
        return unread_end(source.source)
    return source.unread_end if isinstance(source, FileSource) else ()


def how_read(source: FrameSource) -> dict[str, str | None]:
    """What a `RunSummary` says of how `source` is read: `topic` and `on_error`, by which it is read the same way again,
    and `source_lack`; None of other sources.
    """
    if isinstance(source, Equipped):
        return how_read(source.source)
    if isinstance(source, FileSource):
        return {"topic": source.topic, "on_error": source.on_error, "source_lack": source.lack or None}
    return dict.fromkeys(("topic", "on_error", "source_lack"))


def part_names(source: FrameSource) -> tuple[str, ...]:
    """Names of the sequences in the order of their frames; a single empty name for a source without sequences."""
    if isinstance(source, Equipped):
        return part_names(source.source)
    return source.directories if isinstance(source, LabelledSource) else ("",)


def part_of(source: FrameSource, name: str) -> FrameSource:
    """The frames of the sequence that `part_names` calls `name`.

    Raises:
        ValueError: If it calls none so.
    """
    if isinstance(source, Equipped):
        return Equipped(part_of(source.source, name), source.data)
    if isinstance(source, LabelledSource):
        return source.only(name)
    check_source("source", source)
    if name != "":
        raise ValueError(f"name: expected none, as {source.name} has no sequences, got {shortened(name)}")
    return source
