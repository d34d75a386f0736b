"""A progress bar as a result sink."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from foreglow.types import Frame, FrameResult


class ProgressSink:
    """Shows on stderr how many frames are done; shows nothing where stderr is not a terminal."""

    def __init__(self, num_frames: int | None) -> None:
        """A bar over `num_frames`, or a mere count where their number is unknown."""
        console = Console(stderr=True)
        columns = (TextColumn("frames"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._progress.add_task("frames", total=num_frames)

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Counts one frame."""
        self._progress.start()
        self._progress.advance(self._task)

    def close(self) -> None:
        """Takes the bar away."""
        self._progress.stop()

    def discard(self) -> None:
        """Takes the bar away."""
        self._progress.stop()
