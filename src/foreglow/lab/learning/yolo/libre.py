"""YOLOX through libreyolo (MIT), the extra `yolo`."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.learning.yolo.interface import (
    MAX_BOXES,
    MAX_OVERLAP,
    MIN_SCORE,
    YoloConfig,
    colour,
    count_multiply_adds,
    count_parameters,
)

SHORT_EPOCHS = 30
"""Schedules below this have no mosaic and mixup: they slow the first epochs down and shrink small lights away."""

# The library's values for 300 epochs; a shorter schedule has at most a tenth of itself of either.
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
                data=str(data_file.resolve()),  # its own home for data sets is asked first otherwise
                project=str(folder),
                name=run.name,
                exist_ok=True,
                resume=str(checkpoint) if num_done else False,
                pretrained=False,
                **training_arguments(config),
            )
        best = run / "weights" / "best.pt"
        return best if best.exists() and _read(best)["best_mAP50_95"] > 0 else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> LibreDetector:
        """See `Backend.load`."""
        from libreyolo import LibreYOLO

        return LibreDetector(LibreYOLO(str(weights), device=config.device), config.image_size_px)


class LibreDetector:
    """A trained YOLOX."""

    def __init__(self, network: Any, size_px: int) -> None:
        self._network = network
        self._size_px = size_px
        self.num_parameters = count_parameters(network.model)
        self.num_multiply_adds = count_multiply_adds(network.model, size_px)

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Detector.detect`."""
        found = self._network(
            colour(image),
            conf=MIN_SCORE,
            iou=MAX_OVERLAP,
            max_det=MAX_BOXES,
            imgsz=self._size_px,
            color_format="bgr",
        )
        result = found[0] if isinstance(found, list) else found
        return (
            np.asarray(result.boxes.xyxy, np.float64).reshape(-1, 4),
            np.asarray(result.boxes.conf, np.float64).reshape(-1),
        )


def training_arguments(config: YoloConfig) -> dict[str, Any]:
    """What libreyolo is told; its recipe for 300 epochs, with the parts of a shorter one in proportion.

    >>> training_arguments(YoloConfig(epochs=300))["warmup_epochs"], training_arguments(YoloConfig())["warmup_epochs"]
    (5, 1)
    """
    tenth = max(1, config.epochs // 10)
    is_short = config.epochs < SHORT_EPOCHS
    return {
        "epochs": config.epochs,
        "batch": config.batch,
        "imgsz": config.image_size_px,
        "device": config.device,
        "seed": config.seed,
        "workers": 0 if config.device == "cpu" else 4,
        "warmup_epochs": min(_WARMUP_EPOCHS, tenth),
        "no_aug_epochs": min(_LAST_EPOCHS, tenth),
        "mosaic_prob": 0.0 if is_short else 1.0,
        "mixup_prob": 0.0 if is_short else 1.0,
        "eval_interval": tenth,
        "patience": 0,
        "save_period": 0,
    }


def _epochs_in(checkpoint: Path) -> int:
    """How many epochs the training in `checkpoint` has done; 0 where there is none.

    Raises:
        ValueError: If it is broken, such as by a kill while it was written.
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
