"""How long each part of a frame's work takes."""

from __future__ import annotations

import time


class Stopwatch:
    """Times the parts of a frame's work, one after another.

    Attributes:
        part: The part under way; None before the first and after the last.
        times_ms: Milliseconds by part, of the parts that have ended.
    """

    def __init__(self) -> None:
        self.part: str | None = None
        self.times_ms: dict[str, float] = {}
        self._begun_ns = 0

    def begin(self, part: str) -> None:
        """Ends the part under way, and begins the next one."""
        self.end()
        self.part = part

    def end(self) -> None:
        """Ends the part under way, if there is one."""
        now_ns = time.perf_counter_ns()
        if self.part is not None:
            self.times_ms[self.part] = (now_ns - self._begun_ns) / 1e6
        self.part, self._begun_ns = None, now_ns
