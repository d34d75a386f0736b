"""YOLOv5u through ultralytics, for those who have installed it.

Ultralytics is licensed under the AGPL-3.0, which has far-reaching conditions for everything built on it; Foreglow
neither contains nor needs it. This file calls its public interface.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.learning.yolo.interface import TorchDetector, YoloConfig, training_arguments

SIZES = ("n", "s", "m", "l", "x")


class UltralyticsBackend:
    """YOLOv5u of ultralytics."""

    package = "ultralytics"
    licence = "AGPL-3.0"

    def version(self) -> str:
        """See `Backend.version`."""
        return str(_library().__version__)

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """See `Backend.train`."""
        if config.size not in SIZES:
            raise ValueError(f"size: expected one of {', '.join(SIZES)} for ultralytics, got {config.size!r}")
        make_network = _library().YOLO
        run = folder / "run"
        checkpoint = run / "weights" / "last.pt"
        if checkpoint.exists() and _epochs_in(run / "results.csv") < config.epochs:
            make_network(str(checkpoint)).train(resume=True)
        elif not checkpoint.exists():
            make_network(f"yolov5{config.size}.yaml").train(
                **training_arguments(config, data_file, run), device=_device(config), plots=False
            )
        best = run / "weights" / "best.pt"
        return best if best.exists() else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> UltralyticsDetector:
        """See `Backend.load`."""
        return UltralyticsDetector(_library().YOLO(str(weights)), config)


class UltralyticsDetector(TorchDetector):
    """A trained YOLOv5u."""

    def __init__(self, network: Any, config: YoloConfig) -> None:
        super().__init__(network, config.image_size_px)
        self._device = _device(config)

    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        boxes = self._network.predict(image, device=self._device, verbose=False, **self._arguments)[0].boxes
        return boxes.xyxy.cpu(), boxes.conf.cpu()


def _library() -> ModuleType:
    """The library, prevented from using the network."""
    os.environ.setdefault("YOLO_OFFLINE", "true")
    return importlib.import_module("ultralytics")


def _device(config: YoloConfig) -> str | None:
    return None if config.device == "auto" else config.device


def _epochs_in(results: Path) -> int:
    """Number of lines of the library's table of epochs, without its header; 0 without a table."""
    return max(0, len(results.read_text(encoding="utf-8").splitlines()) - 1) if results.exists() else 0
