"""Live sources and their clocks; recorded frames are replayed as if they were taken now."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from foreglow.datasets import FrameSource, how_read, lost_parts, unread_end
from foreglow.datasets.source import check_source
from foreglow.numbers import checked_number
from foreglow.runs.origin import origin_name
from foreglow.runtime.live.watch import MAX_DELAY_NS
from foreglow.types import BeamCommand, Frame
from foreglow.types.arrays import check_kind, check_members

START_S = 120.0
"""Longest time that a source without a rate of its own, such as a renderer, may take for a frame."""

READ_AFTER = 0.5
"""The next recorded frame is read after this share of a frame period, so that decoding does not disturb computing."""


MIN_SPEED = 0.01
"""Slowest replay."""

MAX_GAP_NS = 10_000_000_000
"""A longer gap between two recorded frames is not waited for: a single wrong time may be hours away."""


class LiveSource(FrameSource, Protocol):
    """Frames in real time; iterating waits for each of them."""

    @property
    def max_silence_s(self) -> float | None:
        """A longer time without a frame, by the wall clock, is a fault; None derives it from the rate."""
        ...

    @property
    def speed(self) -> float:
        """Speed of the source's clock relative to the wall clock while frames come; infinite with `is_lossless`."""
        ...

    @property
    def is_lossless(self) -> bool:
        """Whether the source waits until each frame was taken, so that none is dropped."""
        ...

    @property
    def is_endless(self) -> bool:
        """Whether it is a camera: lost if it ends or raises, and opened again by iterating again."""
        ...

    def now_ns(self) -> int:
        """The time now, by the frames' clock."""
        ...


def check_live_source(field: str, source: object) -> None:
    """Checks that `source` is what `LiveSource` describes.

    Raises:
        ValueError: As `check_source`, or if it is a recording that is not replayed, or its speed or longest silence is
            no positive number; the message begins with `field`.
    """
    check_source(field, source)
    expected = "frames in real time, as of Paced(source) or a camera"
    check_members(field, source, expected, "max_silence_s", "speed", "is_lossless", "is_endless", "now_ns")
    for name in ("speed", "max_silence_s"):
        value = getattr(source, name)
        if not (value is None and name == "max_silence_s") and not checked_number(f"{field}: {name}", value) > 0.0:
            raise ValueError(f"{field}: {name}: expected a positive number, got {value}")


class ClosedLoop(ABC):
    """A live source whose coming frames are lit by our own beam commands; a `BeamOutput`, too."""

    @abstractmethod
    def send(self, command: BeamCommand) -> None:
        """Sends a command to the lamps that light the coming frames."""

    @abstractmethod
    def lux(self, frame: Frame) -> Mapping[str, float]:
        """Illuminance at other drivers' eyes by our lamps, lux by vehicle, in the latest frame; empty for any other."""

    @abstractmethod
    def close(self) -> None:
        """Ends the connection to the lamps."""


def has_jumped(step_ns: int) -> bool:
    """Whether a frame so long after the one before begins a time axis of its own, by `MAX_GAP_NS` or `MAX_DELAY_NS`."""
    return not -MAX_DELAY_NS <= step_ns <= MAX_GAP_NS


class Paced:
    """Replays another source's frames at their own timestamps, or faster; the clock runs at the same speed.

    A sequence begins one frame period after the previous one, and so do frames after a gap of more than `MAX_GAP_NS`,
    or behind which time has gone back by more than `MAX_DELAY_NS`. At infinite speed each frame comes as soon as the
    previous one was taken, and the clock stands still at the latest frame.
    """

    max_silence_s: float | None = None
    is_endless = False

    def __init__(self, source: FrameSource, speed: float = 1.0) -> None:
        """Replays `source` so many times as fast as it was recorded.

        Raises:
            ValueError: If `source` is none, or the speed is below `MIN_SPEED`.
        """
        check_source("source", source)
        speed = checked_number("speed", speed)
        if not speed >= MIN_SPEED:
            raise ValueError(f"speed: expected a positive number of at least {MIN_SPEED:g}, got {speed}")
        self._source = source
        self.name, self.num_frames = origin_name(source), source.num_frames
        self.rate_hz = None if source.rate_hz is None else float(source.rate_hz)
        self.how_read = how_read(source)
        self.speed, self.is_lossless = speed, math.isinf(speed)
        self._zero_ns = 0, time.monotonic_ns()  # the same moment by the frames' clock, and by the machine's
        if self.is_lossless:
            self.max_silence_s = START_S

    @property
    def source(self) -> FrameSource:
        """The replayed source."""
        return self._source

    @property
    def skipped(self) -> Sequence[str]:
        """The lines of the replayed source."""
        return self._source.skipped

    @property
    def lost_parts(self) -> Sequence[str]:
        """Those of `skipped` that are about a part of the file in which there may be any number of frames."""
        return lost_parts(self._source)

    @property
    def _wait_s(self) -> float:
        """A frame period by the wall clock; 0 if the rate is not known."""
        return 0.0 if self.rate_hz is None else 1.0 / (self.rate_hz * self.speed)

    def now_ns(self) -> int:
        """The time of the frame at hand, plus the time since it came, at the replay's speed."""
        first_ns, start_ns = self._zero_ns
        return first_ns if self.is_lossless else first_ns + round((time.monotonic_ns() - start_ns) * self.speed)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, at their time.

        Raises:
            ValueError: If the source yields something else; after the last one, if a part of the source is lost in
                which there may have been others, or if none of the images behind it can be read.
        """
        sequence, latest_ns = None, 0
        for frame in self._source:
            check_kind("source", frame, Frame)
            is_new = has_jumped(frame.timestamp_ns - latest_ns)
            latest_ns = frame.timestamp_ns
            if frame.sequence != sequence or is_new or self.is_lossless:
                if sequence is not None and not self.is_lossless:
                    time.sleep(self._wait_s)  # by then the previous frame has been processed
                sequence, self._zero_ns = frame.sequence, (frame.timestamp_ns, time.monotonic_ns())
            first_ns, start_ns = self._zero_ns
            wait_ns = (frame.timestamp_ns - first_ns) / self.speed - (time.monotonic_ns() - start_ns)
            if wait_ns > 0:
                time.sleep(wait_ns / 1e9)
            yield frame
            if not self.is_lossless:
                time.sleep(READ_AFTER * self._wait_s)
        lost = self.lost_parts
        if lost:
            more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
            raise ValueError(f"expected a whole recording, frames may be lost: {lost[0]}{more}")
        unread = unread_end(self._source)
        if unread and sequence is not None:
            last = f"the last {len(unread)} cannot" if len(unread) > 1 else "the last one cannot"
            raise ValueError(f"expected images up to the end, {last} be read: {unread[0]}")
