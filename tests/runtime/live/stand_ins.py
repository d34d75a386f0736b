"""What stands in for cameras, lamps and stages that go wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

from foreglow import config
from foreglow.config import LiveConfig, PipelineConfig
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveLoop, LiveSource, LiveSummary
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult

RATE_HZ = 18.0
PERIOD_S = 1.0 / RATE_HZ

Step: TypeAlias = Frame | Exception | float
"""What a scripted camera does next: bring a frame, raise, or wait so many seconds."""


def live_config(**live: Any) -> PipelineConfig:
    """The preset with a beam, and other parameters of the loop."""
    base = config.preset("foreglow")
    beam = base.beam.model_copy(update={"policy": "foreglow"})
    return base.model_copy(update={"beam": beam, "live": LiveConfig(**live)})


class ScriptedCamera:
    """A camera that does what is written; `is_live` ones bring a frame each period, others wait until it is taken."""

    name = "scripted"
    num_frames: int | None = None
    skipped: Sequence[str] = ()

    def __init__(self, *scripts: Sequence[Step], is_live: bool = False, is_endless: bool = False) -> None:
        self._scripts = list(scripts)
        self._is_live = is_live
        self.is_lossless = not is_live
        self.is_endless = is_endless
        self.rate_hz: float | None = RATE_HZ
        self.max_silence_s: float | None = None if is_live else 60.0
        self._frame_ns, self._since_ns = 0, time.monotonic_ns()

    def now_ns(self) -> int:
        return self._frame_ns + (time.monotonic_ns() - self._since_ns if self._is_live else 0)

    def __iter__(self) -> Iterator[Frame]:
        if not self._scripts:
            raise OSError("scripted: gone for good")
        for step in self._scripts.pop(0):
            if isinstance(step, Exception):
                raise step
            if isinstance(step, float):
                time.sleep(step)
                continue
            if self._is_live:
                time.sleep(PERIOD_S)
            self._frame_ns, self._since_ns = step.timestamp_ns, time.monotonic_ns()
            yield step


class Lamps:
    """Keeps the commands that were sent, and when."""

    def __init__(self) -> None:
        self.commands: list[BeamCommand] = []
        self.times_s: list[float] = []
        self._came = threading.Condition()

    def send(self, command: BeamCommand) -> None:
        with self._came:
            self.commands.append(command)
            self.times_s.append(time.monotonic())
            self._came.notify_all()

    def close(self) -> None:
        assert self.commands[-1].mode == BeamMode.LOW  # whatever happened, they are left so

    @property
    def is_low(self) -> list[bool]:
        return [command.mode == BeamMode.LOW for command in self.commands]

    def of_frames(self) -> dict[int, BeamCommand]:
        """By the time of the image."""
        return {command.timestamp_ns: command for command in self.commands[:-1]}


class Keeper:
    """A live sink that keeps everything."""

    def __init__(self) -> None:
        self.results: list[tuple[Frame, FrameResult]] = []
        self.faults: list[tuple[str, ...]] = []
        self.ends: list[str] = []

    def write(self, frame: Frame, result: FrameResult) -> None:
        self.results.append((frame, result))

    def write_health(self, health: Any) -> None:
        self.faults.append(health.faults)

    def close(self) -> None:
        self.ends.append("close")

    def discard(self) -> None:
        self.ends.append("discard")


def run_live(
    source: LiveSource,
    configuration: PipelineConfig,
    make: Callable[[], Any] | None = None,
    sinks: Sequence[Any] = (),
    limit: int | None = None,
) -> tuple[LiveSummary, Lamps]:
    """Runs the loop to its end; the summary, and what the lamps got."""
    lamps = Lamps()
    loop = LiveLoop(source, make or (lambda: Pipeline(configuration)), configuration, outputs=[lamps], sinks=sinks)
    return loop.run(limit), lamps
