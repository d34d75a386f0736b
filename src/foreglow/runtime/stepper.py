"""Anything that is driven through the frames of a run, one by one."""

from __future__ import annotations

from typing import Protocol

from foreglow.config import PipelineConfig
from foreglow.types import Frame, FrameResult


class Stepper(Protocol):
    """A `Pipeline`, or a substitute for one such as `Replay`."""

    config: PipelineConfig

    @property
    def dispatch(self) -> str | None:
        """As `Pipeline.dispatch`."""
        ...

    def step(self, frame: Frame) -> FrameResult:
        """The result of `frame`."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        ...
