"""What a run drives, frame by frame."""

from __future__ import annotations

from typing import Protocol

from foreglow.config import PipelineConfig
from foreglow.types import Frame, FrameResult


class Described(Protocol):
    """What a summary says of a pipeline."""

    config: PipelineConfig

    @property
    def dispatch(self) -> str | None:
        """As `Pipeline.dispatch`."""
        ...


class Stepper(Described, Protocol):
    """A `Pipeline`, or what stands in for one."""

    def step(self, frame: Frame) -> FrameResult:
        """The result of `frame`."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        ...
