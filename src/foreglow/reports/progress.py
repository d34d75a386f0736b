"""Progress bars: as a result sink, and for scenes under way."""

from __future__ import annotations

from contextlib import AbstractContextManager
from types import TracebackType

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


class SceneProgress(AbstractContextManager["SceneProgress"]):
    """Shows on stderr how many scenes and frames are done; a call reports one scene's state.

    Shows nothing where stderr is not a terminal.
    """

    def __init__(self, num_scenes: int, num_frames: int) -> None:
        """A bar over all frames of all scenes."""
        console = Console(stderr=True)
        columns = (
            TextColumn("scene {task.fields[scenes]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("frames"),
            TimeRemainingColumn(),
        )
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._num_scenes = num_scenes
        self._task = self._progress.add_task("frames", total=num_frames, scenes=f"0/{num_scenes}")
        self._done: dict[int, int] = {}
        self._finished: set[int] = set()

    def __call__(self, scene: int, num_done: int, num_frames: int) -> None:
        """Scene number `scene` has `num_done` of its `num_frames` frames."""
        self._done[scene] = num_done
        if num_done == num_frames:
            self._finished.add(scene)
        scenes = f"{len(self._finished)}/{self._num_scenes}"
        self._progress.update(self._task, completed=sum(self._done.values()), scenes=scenes)

    def __enter__(self) -> SceneProgress:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._progress.stop()
