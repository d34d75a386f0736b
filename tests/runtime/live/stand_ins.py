"""A sink that keeps everything, and a whole run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.faulty import Lamps
from foreglow.config import PipelineConfig
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveLoop, LiveSource, LiveSummary
from foreglow.types import Frame, FrameResult

BEGIN, END = 20, 30
"""In these frames something is wrong; there are 60."""


class Keeper:
    """A live sink that keeps everything."""

    def __init__(self) -> None:
        self.results: list[tuple[Frame, FrameResult]] = []
        self.faults: list[tuple[str, ...]] = []
        self.details: list[str] = []
        self.ends: list[str] = []

    def write(self, frame: Frame, result: FrameResult) -> None:
        self.results.append((frame, result))

    def write_health(self, health: Any) -> None:
        self.faults.append(health.faults)
        self.details.append(health.details)

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
    lamps: Lamps | None = None,
) -> tuple[LiveSummary, Lamps]:
    """Runs the loop to its end; the summary, and what the lamps got."""
    lamps = lamps or Lamps()
    loop = LiveLoop(source, make or (lambda: Pipeline(configuration)), configuration, outputs=[lamps], sinks=sinks)
    summary = loop.run(limit)
    assert lamps.is_low[-1:] in ([], [True])  # whatever happened, they are left so
    return summary, lamps
