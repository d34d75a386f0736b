"""TensorBoard event files of a training, written if TensorBoard is installed."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from foreglow.lab.learning.training import Epoch, TrainingProgress


def event_files_wanted() -> bool:
    """Whether TensorBoard is installed."""
    return importlib.util.find_spec("tensorboard") is not None


class WithEventFiles:
    """Passes on the progress of a training, and writes the figures of every epoch as events into its folder."""

    def __init__(self, folder: Path, progress: TrainingProgress | None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder))
        self._progress = progress

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:
        """As `TrainingProgress.step`."""
        if self._progress is not None:
            self._progress.step(epoch, num_done, num_steps)

    def epoch(self, epoch: Epoch, num_epochs: int) -> None:
        """As `TrainingProgress.epoch`."""
        for name, value in dataclasses.asdict(epoch).items():
            if name != "number":
                self._writer.add_scalar(name, value, epoch.number)
        self._writer.flush()
        if self._progress is not None:
            self._progress.epoch(epoch, num_epochs)
