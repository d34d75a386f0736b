"""Progress bars on stderr: of a run, of simulated scenes, of the steps of a long command."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from foreglow.types import Frame, FrameResult


class Bar:
    """A progress bar on stderr, shown only on a terminal; it closes at the end of a `with` block."""

    def __init__(self, description: str = "", total: int | None = None) -> None:
        self._console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        is_shown = self._console.is_terminal
        self._progress = Progress(*columns, console=self._console, transient=True, disable=not is_shown)
        self._task = self._progress.add_task(description, total=total)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the bar until there is more to show."""
        self._progress.stop()

    def _show(self, description: str, num_done: int, total: int | None) -> None:
        self._progress.start()
        self._progress.update(self._task, description=description, completed=num_done, total=total)


class ProgressSink(Bar):
    """A result sink that shows how many frames of a run are done."""

    def __init__(self, num_frames: int | None) -> None:
        """A bar over `num_frames`, or a mere count if their number is unknown."""
        super().__init__("frames", num_frames)

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Counts one frame."""
        self._progress.start()
        self._progress.advance(self._task)

    def discard(self) -> None:
        """Removes the bar."""
        self.close()


class PartsProgress(Bar):
    """Shows how many frames are done of a run that works on several sequences at once."""

    def __init__(self, num_frames: int | None) -> None:
        """A bar over `num_frames`, or a mere count if their number is unknown."""
        super().__init__()
        self._num_frames = num_frames
        self._done: dict[str, int] = {}

    def __call__(self, sequence: str, num_done: int) -> None:
        """Shows that `num_done` frames of a sequence are done."""
        self._done[sequence] = num_done
        self._show("frames", sum(self._done.values()), self._num_frames)


class SceneProgress(Bar):
    """Shows how many frames and how many scenes are simulated."""

    def __init__(self, num_scenes: int, num_frames: int) -> None:
        """A bar over all frames of all scenes."""
        super().__init__()
        self._num_scenes, self._num_frames = num_scenes, num_frames
        self._done: dict[int, int] = {}
        self.num_finished = 0

    def __call__(self, sequence: int, num_done: int, num_frames: int) -> None:
        """Shows that `num_done` of a scene's frames are done."""
        self._done[sequence] = num_done
        self.num_finished += num_done == num_frames
        self._show(f"scenes {self.num_finished}/{self._num_scenes}, frames", self.num_done, self._num_frames)

    @property
    def num_done(self) -> int:
        """Number of frames that are done."""
        return sum(self._done.values())


class StepProgress(Bar):
    """Shows the progress of the current step of a long command."""

    def __call__(self, step: str, num_done: int, num_all: int) -> None:
        """Shows that `num_done` of `num_all` items of a step, such as `images`, are done."""
        self._show(step, num_done, num_all)
        if num_done == num_all:
            self.close()

    def of(self, step: str) -> Callable[[int, int], None]:
        """The callback for a single step."""
        return functools.partial(self, step)
