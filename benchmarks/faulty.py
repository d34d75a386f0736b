"""Cameras, stages and lamps that go wrong as they are told to, for measuring and for testing the live loop."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np

from foreglow import config
from foreglow.beam.faults import GuardFault
from foreglow.config import LiveConfig, PipelineConfig
from foreglow.pipeline import Pipeline
from foreglow.types import BeamCommand, BeamMode, Frame, Image

RATE_HZ = 18.0
PERIOD_S = 1.0 / RATE_HZ

Step: TypeAlias = Frame | BaseException | float
"""What a scripted camera does next: bring a frame, raise, or wait so many seconds."""

STAGES = {
    "proposals": ("proposer", "propose"),
    "classifier": ("classifier", "classify"),
    "distance": ("estimator", "estimate"),
    "tracking": ("tracker", "update"),
    "beam": ("beam", "command"),
}


def _with_image(frame: Frame, image: Image) -> Frame:
    return dataclasses.replace(frame, image=image)


WRONG_FRAMES: dict[str, Callable[[Sequence[Frame]], list[Frame]]] = {
    GuardFault.FROZEN: lambda frames: [_with_image(frame, frames[0].image) for frame in frames],
    GuardFault.BLACK: lambda frames: [_with_image(frame, frame.image // 64) for frame in frames],
    GuardFault.SATURATED: lambda frames: [_with_image(frame, np.full_like(frame.image, 255)) for frame in frames],
    GuardFault.DAMAGED: lambda frames: [dataclasses.replace(frame, is_damaged=True) for frame in frames],
    GuardFault.NO_CAMERA: lambda frames: [dataclasses.replace(frame, camera=None) for frame in frames],
    GuardFault.NO_SPEED: lambda frames: [dataclasses.replace(frame, motion=None) for frame in frames],
}
"""By fault, what makes good frames show it; the first frozen one is still right."""


def live_config(**live: Any) -> PipelineConfig:
    """The preset with a beam, and other parameters of the loop."""
    return config.preset("foreglow").commanding().model_copy(update={"live": LiveConfig(**live)})


class ScriptedCamera:
    """A camera that does what is written; `is_live` ones bring a frame each period, others wait until it is taken."""

    name = "scripted"
    num_frames: int | None = None
    skipped: Sequence[str] = ()

    def __init__(self, *scripts: Sequence[Step], is_live: bool = False, is_endless: bool = False) -> None:
        self._scripts = list(scripts)
        self._is_live = is_live
        self.is_lossless = not is_live
        self.speed = 1.0 if is_live else math.inf
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
            if isinstance(step, BaseException):
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
        pass

    @property
    def is_low(self) -> list[bool]:
        return [command.mode == BeamMode.LOW for command in self.commands]

    def of_frames(self) -> dict[int, BeamCommand]:
        """By the time of the image."""
        return {command.timestamp_ns: command for command in self.commands[:-1]}


def spoil(pipeline: Pipeline, stage: str, what: Callable[[int], Any]) -> None:
    """Does `what` with the time of each frame before a stage looks at it."""
    part, method = STAGES[stage]
    stages = pipeline._stages
    target = getattr(stages, part)
    known = getattr(target, method)
    step = pipeline.step
    now_ns = [0]

    def stepping(frame: Frame, **context: Any) -> Any:
        now_ns[0] = frame.timestamp_ns
        return step(frame, **context)

    def spoiled(*arguments: Any, **context: Any) -> Any:
        what(now_ns[0])
        return known(*arguments, **context)

    pipeline.step = stepping  # type: ignore[method-assign, assignment]
    setattr(stages, part, Spoiled(target, method, spoiled))


class Spoiled:
    """Another object, with one method in place of its own."""

    def __init__(self, target: Any, method: str, replacement: Callable[..., Any]) -> None:
        self._target = target
        setattr(self, method, replacement)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)
