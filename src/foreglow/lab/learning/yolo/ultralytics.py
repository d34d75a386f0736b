"""YOLOv5u through ultralytics, for those who have installed it.

Ultralytics is licensed under the AGPL-3.0, which asks much of whoever builds on it; Foreglow neither contains nor
needs it. This file calls its public interface.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType
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
                data=str(data_file.resolve()),
                epochs=config.epochs,
                batch=config.batch,
                imgsz=config.image_size_px,
                device=_device(config),
                seed=config.seed,
                project=str(folder.resolve()),
                name=run.name,
                exist_ok=True,
                pretrained=False,
                plots=False,
                patience=0,
                workers=0 if config.device == "cpu" else 4,
            )
        best = run / "weights" / "best.pt"
        return best if best.exists() else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> UltralyticsDetector:
        """See `Backend.load`."""
        return UltralyticsDetector(_library().YOLO(str(weights)), config)


class UltralyticsDetector:
    """A trained YOLOv5u."""

    def __init__(self, network: Any, config: YoloConfig) -> None:
        self._network = network
        self._arguments = {
            "imgsz": config.image_size_px,
            "conf": MIN_SCORE,
            "iou": MAX_OVERLAP,
            "max_det": MAX_BOXES,
            "device": _device(config),
            "verbose": False,
        }
        self.num_parameters = count_parameters(network.model)
        self.num_multiply_adds = count_multiply_adds(network.model, config.image_size_px)

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Detector.detect`."""
        boxes = self._network.predict(colour(image), **self._arguments)[0].boxes
        return (
            np.asarray(boxes.xyxy.cpu(), np.float64).reshape(-1, 4),
            np.asarray(boxes.conf.cpu(), np.float64).reshape(-1),
        )


def _library() -> ModuleType:
    """The library, which is kept from using the network."""
    os.environ.setdefault("YOLO_OFFLINE", "true")
    return importlib.import_module("ultralytics")


def _device(config: YoloConfig) -> str | None:
    return None if config.device == "auto" else config.device


def _epochs_in(results: Path) -> int:
    """Lines of the library's table of epochs, without its head; 0 where there is none."""
    return max(0, len(results.read_text(encoding="utf-8").splitlines()) - 1) if results.exists() else 0
