"""YOLOX through libreyolo (MIT), the extra `yolo`."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.learning.yolo.interface import TorchDetector, YoloConfig, training_arguments

SHORT_EPOCHS = 30
"""Shorter schedules do without mosaic and mixup, which slow the first epochs down and make small lights vanish."""

# The library's values for 300 epochs; in a shorter schedule, at most a tenth of the epochs.
_WARMUP_EPOCHS, _LAST_EPOCHS = 5, 15


class LibreBackend:
    """YOLOX of libreyolo."""

    package = "libreyolo"
    licence = "MIT"

    def version(self) -> str:
        """See `Backend.version`."""
        import libreyolo

        return str(libreyolo.__version__)

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """See `Backend.train`."""
        from libreyolo import LibreYOLOX

        run = folder / "run"
        checkpoint = run / "weights" / "last.pt"
        num_done = _epochs_in(checkpoint)
        if num_done < config.epochs:
            network = LibreYOLOX(None, size=config.size, nb_classes=1, device=config.device)
            network.train(
                **training_arguments(config, data_file, run),
                **schedule(config),
                device=config.device,
                resume=str(checkpoint) if num_done else False,
            )
        best = run / "weights" / "best.pt"
        return best if best.exists() and _read(best)["best_mAP50_95"] > 0 else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> LibreDetector:
        """See `Backend.load`."""
        from libreyolo import LibreYOLO

        return LibreDetector(LibreYOLO(str(weights), device=config.device), config.image_size_px)


class LibreDetector(TorchDetector):
    """A trained YOLOX."""

    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        found = self._network(image, color_format="bgr", **self._arguments)
        result = found[0] if isinstance(found, list) else found
        return result.boxes.xyxy, result.boxes.conf


def schedule(config: YoloConfig) -> dict[str, Any]:
    """The library's recipe for 300 epochs; for fewer epochs, with its parts in proportion.

    >>> schedule(YoloConfig(epochs=300))["warmup_epochs"], schedule(YoloConfig())["warmup_epochs"]
    (5, 1)
    """
    tenth = max(1, config.epochs // 10)
    is_short = config.epochs < SHORT_EPOCHS
    return {
        "warmup_epochs": min(_WARMUP_EPOCHS, tenth),
        "no_aug_epochs": min(_LAST_EPOCHS, tenth),
        "mosaic_prob": 0.0 if is_short else 1.0,
        "mixup_prob": 0.0 if is_short else 1.0,
        "eval_interval": tenth,
        "save_period": 0,
    }


def _epochs_in(checkpoint: Path) -> int:
    """Number of epochs that the training in `checkpoint` has done; 0 without a checkpoint.

    Raises:
        ValueError: If it is broken, for example because the process was killed while writing it.
    """
    return int(_read(checkpoint)["epoch"]) + 1 if checkpoint.exists() else 0


def _read(checkpoint: Path) -> dict[str, Any]:
    import torch

    try:
        content = torch.load(checkpoint, map_location="cpu", weights_only=True)
        return {name: content[name] for name in ("epoch", "best_mAP50_95")}
    except (pickle.UnpicklingError, RuntimeError, EOFError, KeyError, TypeError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise ValueError(f"{checkpoint}: expected a checkpoint ({reason}); remove it to begin again") from error
