"""The progress of a training: what is called, the lines on the terminal, and TensorBoard's event files."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from foreglow.display.progress import Bar

UNDEFINED = "–"
"""In place of a figure for which there is nothing to count."""


@dataclass(frozen=True, slots=True)
class Epoch:
    """Figures of one pass over the training samples.

    Attributes:
        learning_rate: Rate of its last step.
        train_loss: Mean loss over its augmented samples, during training.
        val_loss: Loss of the validation samples after it, without augmentation; positives weighted as in training.
        precision: Precision of the validation boxes whose score is above `threshold`.
        recall: Recall of the validation boxes by these.
        f1: F of the validation boxes by these; NaN without positives.
        kind_accuracy: Share of the validation boxes with light whose kind is right, each kind counted alike; NaN if
            kinds are not trained.
        seconds: Duration, validation included.
        threshold: Boxes with a score above it count as accepted.
    """

    number: int
    learning_rate: float
    train_loss: float
    val_loss: float
    precision: float
    recall: float
    f1: float
    kind_accuracy: float
    seconds: float
    threshold: float = 0.5


class TrainingProgress(Protocol):
    """Callbacks for the progress of a training."""

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """Called when `num_done` of the `num_steps` steps of epoch number `epoch` are done."""
        ...

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """Called when `epoch` is done, out of at most `num_epochs`."""
        ...


class RunProgress(TrainingProgress, Protocol):
    """Callbacks for the progress of a run: first the samples of both splits, then the training."""

    def samples(self, split: str, num_done: int, num_images: int) -> None:
        """Called when the samples of `num_done` images of a split are collected."""
        ...


class TrainingBar(Bar):
    """Shows the progress of a run and prints a line per epoch; without a terminal, the lines alone."""

    def samples(self, split: str, num_done: int, num_images: int) -> None:
        """See `RunProgress.samples`."""
        self._show(f"{split} images", num_done, num_images)

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """See `TrainingProgress.step`."""
        self._show(f"epoch {epoch}, steps", num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """See `TrainingProgress.epoch`."""
        figures = {"P": epoch.precision, "R": epoch.recall, "F": epoch.f1}
        told = " ".join(
            f"{name} {UNDEFINED if math.isnan(value) else f'{value:.3f}'}" for name, value in figures.items()
        )
        self._console.print(
            f"epoch {epoch.number}/{num_epochs}: loss {epoch.train_loss:.4f}, validation {epoch.val_loss:.4f}, "
            f"{told} at a score > {epoch.threshold:g}, "
            f"{epoch.seconds:.0f} s",
            highlight=False,
            soft_wrap=True,
        )


class WithEventFiles:
    """Passes on the progress of a training, and writes the figures of every epoch as events into its folder."""

    def __init__(self, folder: Path, progress: TrainingProgress | None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder))
        self._progress = progress

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """See `TrainingProgress.step`."""
        if self._progress is not None:
            self._progress.step(epoch, num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """See `TrainingProgress.epoch`."""
        for name, value in dataclasses.asdict(epoch).items():
            if name != "number":
                self._writer.add_scalar(name, value, epoch.number)
        self._writer.flush()
        if self._progress is not None:
            self._progress.epoch(epoch, num_epochs)
