"""Progress bars: one as a result sink, one for scenes that are driven, one for a training, one for what is counted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from foreglow.types import Frame, FrameResult

if TYPE_CHECKING:
    from foreglow.learning.training import Epoch


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


class SceneProgress:
    """Shows on stderr how many frames of how many scenes are driven; nothing where stderr is not a terminal."""

    def __init__(self, num_scenes: int, num_frames: int) -> None:
        """A bar over all frames of all scenes."""
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._num_scenes = num_scenes
        self._task = self._progress.add_task("", total=num_frames)
        self._done: dict[int, int] = {}
        self.num_finished = 0

    def __call__(self, sequence: int, num_done: int, num_frames: int) -> None:
        """Takes note that `num_done` of a scene's frames are there."""
        self._progress.start()
        self._progress.advance(self._task, num_done - self._done.get(sequence, 0))
        self._done[sequence] = num_done
        self.num_finished += num_done == num_frames
        self._progress.update(self._task, description=f"scenes {self.num_finished}/{self._num_scenes}, frames")

    @property
    def num_done(self) -> int:
        """Frames that are there."""
        return sum(self._done.values())

    def close(self) -> None:
        """Takes the bar away."""
        self._progress.stop()


class StepProgress:
    """Shows on stderr how far each named step of a long command is; nothing where stderr is not a terminal."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, what: str, num_done: int, num_all: int) -> None:
        """Takes note that `num_done` of `num_all` of a step are done; a step gets its bar when it is first heard of."""
        self._progress.start()
        if what not in self._tasks:
            self._tasks[what] = self._progress.add_task(what, total=num_all)
        self._progress.update(self._tasks[what], completed=num_done, total=num_all)

    def close(self) -> None:
        """Takes the bars away."""
        self._progress.stop()


class TrainingBar:
    """Shows on stderr how far a training is, and one line an epoch; without a terminal the lines alone."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(
            *columns, console=self._console, transient=True, disable=not self._console.is_terminal
        )
        self._task = self._progress.add_task("")
        self._best = 0.0

    def samples(self, split: str, num_done: int, num_images: int) -> None:
        """Takes note that the samples of `num_done` images are there."""
        self._show(f"{split} images", num_done, num_images)

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """Takes note of a step."""
        self._show(f"epoch {epoch}, steps", num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """Writes the epoch's line."""
        self._best = max(self._best, epoch.f1)
        self._console.print(
            f"epoch {epoch.number}/{num_epochs}: loss {epoch.train_loss:.4f}, validation {epoch.val_loss:.4f}, "
            f"P {epoch.precision:.3f} R {epoch.recall:.3f} F {epoch.f1:.3f} (best {self._best:.3f}), "
            f"{epoch.seconds:.0f} s",
            highlight=False,
            soft_wrap=True,
        )

    def close(self) -> None:
        """Takes the bar away."""
        self._progress.stop()

    def _show(self, description: str, num_done: int, total: int) -> None:
        self._progress.start()
        self._progress.update(self._task, description=description, completed=num_done, total=total)


class CountProgress:
    """Shows on stderr how many things of how many are done; nothing where stderr is no terminal."""

    def __init__(self, things: str = "") -> None:
        """A bar for `things`; their number is said with each call."""
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._things = things
        self._task = self._progress.add_task(things)

    def __call__(self, num_done: int, num_things: int) -> None:
        """Takes note that `num_done` of `num_things` are done."""
        self.show(self._things, num_done, num_things)

    def show(self, things: str, num_done: int, num_things: int) -> None:
        """The same for other things; takes the bar away at the last one."""
        self._progress.start()
        self._progress.update(self._task, description=things, completed=num_done, total=num_things)
        if num_done == num_things:
            self._progress.stop()

    def close(self) -> None:
        """Takes the bar away."""
        self._progress.stop()
