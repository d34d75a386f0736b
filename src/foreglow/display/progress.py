"""Progress bars on stderr: of a run, of scenes that are driven, of the steps of a long command, of a training."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from foreglow.types import Frame, FrameResult

if TYPE_CHECKING:
    from foreglow.lab.learning.training import Epoch


class _Bar:
    """A bar on stderr; nothing where stderr is not a terminal."""

    def __init__(self, description: str = "", total: int | None = None) -> None:
        self._console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        is_shown = self._console.is_terminal
        self._progress = Progress(*columns, console=self._console, transient=True, disable=not is_shown)
        self._task = self._progress.add_task(description, total=total)

    def close(self) -> None:
        """Takes the bar away; it comes back when there is more to show."""
        self._progress.stop()

    def _show(self, description: str, num_done: int, total: int | None) -> None:
        self._progress.start()
        self._progress.update(self._task, description=description, completed=num_done, total=total)


class ProgressSink(_Bar):
    """Shows how many frames of a run are done."""

    def __init__(self, num_frames: int | None) -> None:
        """A bar over `num_frames`, or a mere count where their number is unknown."""
        super().__init__("frames", num_frames)

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Counts one frame."""
        self._progress.start()
        self._progress.advance(self._task)

    def discard(self) -> None:
        """Takes the bar away."""
        self.close()


class PartsProgress(_Bar):
    """Shows how many frames of a run are done whose sequences are run apart."""

    def __init__(self, num_frames: int | None) -> None:
        """A bar over `num_frames`, or a mere count where their number is unknown."""
        super().__init__()
        self._num_frames = num_frames
        self._done: dict[str, int] = {}

    def __call__(self, sequence: str, num_done: int) -> None:
        """Takes note that `num_done` frames of a sequence are done."""
        self._done[sequence] = num_done
        self._show("frames", sum(self._done.values()), self._num_frames)


class SceneProgress(_Bar):
    """Shows how many frames of how many scenes are driven."""

    def __init__(self, num_scenes: int, num_frames: int) -> None:
        """A bar over all frames of all scenes."""
        super().__init__()
        self._num_scenes, self._num_frames = num_scenes, num_frames
        self._done: dict[int, int] = {}
        self.num_finished = 0

    def __call__(self, sequence: int, num_done: int, num_frames: int) -> None:
        """Takes note that `num_done` of a scene's frames are there."""
        self._done[sequence] = num_done
        self.num_finished += num_done == num_frames
        self._show(f"scenes {self.num_finished}/{self._num_scenes}, frames", self.num_done, self._num_frames)

    @property
    def num_done(self) -> int:
        """Frames that are there."""
        return sum(self._done.values())


class StepProgress(_Bar):
    """Shows how far the present step of a long command is."""

    def __call__(self, step: str, num_done: int, num_all: int) -> None:
        """Takes note that `num_done` of the `num_all` of a step, such as `images`, are done."""
        self._show(step, num_done, num_all)
        if num_done == num_all:
            self.close()


class TrainingBar(_Bar):
    """Shows how far a training is, and one line an epoch; without a terminal the lines alone."""

    def __init__(self) -> None:
        super().__init__()
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
