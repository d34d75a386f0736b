"""Where live frames come from, and by what clock: what is recorded or simulated, as if it happened now."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from foreglow.beam.messages import CommandEncoder
from foreglow.beam.receiver import LampReceiver
from foreglow.datasets import FrameSource
from foreglow.lab.simulation import Drive, Scene, with_beam
from foreglow.types import BeamCommand, Frame

START_S = 120.0
"""A renderer may need this long for its first frame."""


ANSWER_S = 1.0
"""The lamps wait so long for a frame's command, by the wall's clock."""


READ_AFTER = 0.5
"""The next recorded frame is read after this share of a frame's time, so that decoding does not disturb computing."""


class LiveSource(FrameSource, Protocol):
    """Frames as they come; iterating waits for each."""

    @property
    def max_silence_s(self) -> float | None:
        """A longer time without a frame, by the wall's clock, is a fault; None goes by the rate."""
        ...

    @property
    def speed(self) -> float:
        """How many times as fast as the wall's its clock goes while frames come; infinite with `is_lossless`."""
        ...

    @property
    def is_lossless(self) -> bool:
        """Whether the source waits until a frame was taken, so that none is dropped."""
        ...

    @property
    def is_endless(self) -> bool:
        """Whether it is a camera: lost where it ends or raises, and then opened anew by iterating again."""
        ...

    def now_ns(self) -> int:
        """The time now, by the clock of the frames."""
        ...


class Paced:
    """Another source's frames at the pace of their own times, or a multiple of it, by a clock that goes as fast.

    A sequence follows the one before after a frame's time. At infinite speed each frame comes as soon as the one
    before was taken; the clock then stands at the latest one.
    """

    max_silence_s: float | None = None
    is_endless = False

    def __init__(self, source: FrameSource, speed: float = 1.0) -> None:
        """Takes the source.

        Raises:
            ValueError: If the speed is not positive.
        """
        if not speed > 0:
            raise ValueError(f"speed: expected a positive number, got {speed}")
        self._source = source
        self.speed = speed
        self._first_ns = self._start_ns = 0
        if self.is_lossless:
            self.max_silence_s = START_S

    @property
    def name(self) -> str:
        """The other source's."""
        return self._source.name

    @property
    def rate_hz(self) -> float | None:
        """The other source's, by its own clock."""
        return self._source.rate_hz

    @property
    def num_frames(self) -> int | None:
        """The other source's."""
        return self._source.num_frames

    @property
    def skipped(self) -> Sequence[str]:
        """The other source's."""
        return self._source.skipped

    @property
    def is_lossless(self) -> bool:
        """At infinite speed."""
        return math.isinf(self.speed)

    @property
    def _wait_s(self) -> float:
        """A frame's time by the wall's clock; 0 where the rate is not known."""
        return 0.0 if self.rate_hz is None else 1.0 / (self.rate_hz * self.speed)

    def now_ns(self) -> int:
        """Goes on between frames, at the speed."""
        if self.is_lossless:
            return self._first_ns
        return self._first_ns + round((time.monotonic_ns() - self._start_ns) * self.speed)

    def __iter__(self) -> Iterator[Frame]:
        sequence: str | None = None
        for frame in self._source:
            if frame.sequence != sequence or self.is_lossless:
                if sequence is not None and not self.is_lossless:
                    time.sleep(self._wait_s)  # the frame before is done with by then
                sequence, self._first_ns, self._start_ns = frame.sequence, frame.timestamp_ns, time.monotonic_ns()
            wait_ns = (frame.timestamp_ns - self._first_ns) / self.speed - (time.monotonic_ns() - self._start_ns)
            if wait_ns > 0:
                time.sleep(wait_ns / 1e9)
            yield frame
            if not self.is_lossless:
                time.sleep(READ_AFTER * self._wait_s)


class DriveAround:
    """A simulated drive in closed loop: our own commands light the frames to come, through the bus and the lamps.

    Time stands still while a frame is rendered: the next one comes one frame's time after the one before, and shows
    the light of that one's command.
    """

    max_silence_s: float | None = START_S
    speed = 1.0
    is_lossless = False
    is_endless = False

    def __init__(self, scene: Scene, quality: str = "training") -> None:
        """A drive through `scene`, with our matrix beam.

        Raises:
            ValueError: If there is no such quality.
        """
        self._drive = Drive(with_beam(scene, "matrix"), quality)
        self._answered = threading.Event()
        self._frame_ns, self._begun_ns = 0, time.monotonic_ns()
        self._period_ns = round(1e9 / scene.rate_hz)
        self._encoder = CommandEncoder()
        self._lamps = LampReceiver()
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        """Of the scene, with its seed."""
        return self._drive.name

    @property
    def rate_hz(self) -> float | None:
        """Of the scene."""
        return self._drive.rate_hz

    @property
    def num_frames(self) -> int | None:
        """Of the drive."""
        return self._drive.num_frames

    @property
    def skipped(self) -> Sequence[str]:
        """Nothing is."""
        return ()

    def now_ns(self) -> int:
        """Goes on after a frame, but not beyond the next one."""
        return self._frame_ns + min(time.monotonic_ns() - self._begun_ns, self._period_ns)

    def __iter__(self) -> Iterator[Frame]:
        self._lamps = LampReceiver()
        self._drive.set_led_levels(self._lamps.shining(0)[0])
        for known in self._drive.frames():
            self._answered.clear()
            self._frame_ns, self._begun_ns = known.frame.timestamp_ns, time.monotonic_ns()
            yield known.frame
            self._answered.wait(ANSWER_S)
            with self._lock:
                levels, _ = self._lamps.shining(max(self.now_ns(), known.frame.timestamp_ns + self._period_ns))
            self._drive.set_led_levels(levels)

    def send(self, command: BeamCommand) -> None:
        """Brings a command to the lamps of the drive."""
        with self._lock:
            now_ns = self.now_ns()
            for frame in self._encoder.frames(command):
                self._lamps.receive(now_ns, frame.frame_id, frame.data)
        self._answered.set()

    def close(self) -> None:
        """Nothing is open."""

    def lux(self, frame: Frame) -> Mapping[str, float]:
        """The light of our lamps at other drivers' eyes in the latest frame, lux by vehicle; empty for another one."""
        known = self._drive.latest
        if known is None or known.frame.timestamp_ns != frame.timestamp_ns:
            return {}
        return {f"vehicle {one.vehicle_id}": one.eye_lx.get("ego", 0.0) for one in known.vehicles}
