"""A training on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from foreglow.display.progress import Bar

if TYPE_CHECKING:
    from foreglow.lab.learning.training import Epoch


class TrainingBar(Bar):
    """Shows the progress of a training and prints a line per epoch; without a terminal, the lines alone."""

    def __init__(self) -> None:
        super().__init__()
        self._best = 0.0

    def samples(self, split: str, num_done: int, num_images: int) -> None:
        """Shows that the samples of `num_done` images are prepared."""
        self._show(f"{split} images", num_done, num_images)

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """Shows that `num_done` steps of an epoch are done."""
        self._show(f"epoch {epoch}, steps", num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """Prints the line of a finished epoch."""
        self._best = max(self._best, epoch.f1)
        self._console.print(
            f"epoch {epoch.number}/{num_epochs}: loss {epoch.train_loss:.4f}, validation {epoch.val_loss:.4f}, "
            f"P {epoch.precision:.3f} R {epoch.recall:.3f} F {epoch.f1:.3f} (best {self._best:.3f}), "
            f"{epoch.seconds:.0f} s",
            highlight=False,
            soft_wrap=True,
        )
