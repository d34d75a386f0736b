"""The libraries that train and run YOLOs: YOLOX through libreyolo (MIT, the extra `yolo`), YOLOv5u through ultralytics.

Ultralytics is licensed under the AGPL-3.0, which has far-reaching conditions for everything built on it; Foreglow
neither contains nor needs it, and calls its public interface for those who have installed it.
"""

from __future__ import annotations

import importlib
import os
from abc import ABC, abstractmethod
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from foreglow.config import FrozenModel
from foreglow.files import MIB, read_text
from foreglow.lab.learning.kept_files import check_torch_file, read_torch_file
from foreglow.plugins import first_line_of

MIN_SCORE = 0.01
"""Boxes below this score are dropped; low, so that any threshold can be tried afterwards."""

MAX_OVERLAP = 0.45
"""Non-maximum suppression: largest intersection over union of two boxes (libreyolo's default)."""

MAX_BOXES = 300
"""Largest number of boxes per image. Both libraries' default."""

SHORT_EPOCHS = 30
"""Shorter schedules do without mosaic and mixup, which slow the first epochs down and make small lights vanish."""

# libreyolo's values for 300 epochs; in a shorter schedule, at most a tenth of the epochs.
_WARMUP_EPOCHS, _LAST_EPOCHS = 5, 15


class YoloConfig(FrozenModel):
    """How a YOLO is trained; everything else is the library's default.

    Attributes:
        size: Nano, tiny, small, medium, large or extra large; the paper uses `s` and `x`.
        image_size_px: Side of the network's square images, a multiple of 32; the paper uses 960.
        epochs: Passes over the training split.
        batch: Images in one step.
        seed: Seed of the initial weights, the order and the augmentation.
        device: `auto`, `cpu`, or the number of a GPU such as `0`.
        weights: File of weights to start from, such as those that ultralytics trained on COCO; empty for random ones.
    """

    backend: Literal["libreyolo", "ultralytics"] = "libreyolo"
    size: Literal["n", "t", "s", "m", "l", "x"] = "s"
    image_size_px: Annotated[int, Field(ge=32, le=4096, multiple_of=32)] = 320
    epochs: Annotated[int, Field(ge=1, le=100_000)] = 3
    batch: Annotated[int, Field(ge=1, le=4096)] = 16
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    device: Annotated[str, Field(pattern=r"^(auto|cpu|\d+)$")] = "auto"
    weights: str = ""

    @model_validator(mode="after")
    def _check(self) -> YoloConfig:
        if self.weights and self.backend != "ultralytics":
            raise ValueError(f"weights: expected none with {self.backend}, only ultralytics starts from given ones")
        return self


class Detector(Protocol):
    """A trained network."""

    num_parameters: int
    num_multiply_adds: int
    """For one image."""

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes, shape (N, 4), xyxy in pixels of `image`, and scores, shape (N,), after non-maximum suppression.

        Args:
            image: A grey square; the network scales it to its own size.
        """
        ...


class Backend(ABC):
    """A library that trains and runs YOLOs; every method raises `ModuleNotFoundError` if it is not installed."""

    SIZES: tuple[str, ...] = ("n", "t", "s", "m", "l", "x")

    @abstractmethod
    def version(self) -> str:
        """The installed version."""

    def check(self, config: YoloConfig) -> None:
        """Passes what can be trained here, before anything is exported or written.

        Raises:
            FileNotFoundError: If the weights to start from are missing.
            ValueError: If they are damaged, the library does not have this size, or there is no such GPU.
        """
        if config.size not in self.SIZES:
            raise ValueError(f"size: expected one of {', '.join(self.SIZES)} for {config.backend}, got {config.size!r}")
        if config.weights:
            if not Path(config.weights).is_file():
                raise FileNotFoundError(f"{config.weights}: no such file, expected weights to start from")
            check_torch_file(Path(config.weights))
        if not is_here(config.device):
            raise ValueError(f"device: expected auto or cpu, torch has no GPU with the number {config.device}")

    @abstractmethod
    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """Trains from random or the given weights, or continues a training in `folder`; returns the best weights' path.

        Raises:
            ValueError: If a checkpoint in `folder` is broken.
        """

    @abstractmethod
    def load(self, weights: Path, config: YoloConfig) -> Detector:
        """The network in `weights`.

        Raises:
            ValueError: If the file is damaged.
        """


class _TorchDetector(ABC):
    def __init__(self, network: Any, size_px: int) -> None:
        """Takes the library's network, whose torch module is `network.model`."""
        self._network = network
        self.num_parameters = sum(parameter.numel() for parameter in network.model.parameters())
        self.num_multiply_adds = count_multiply_adds(network.model, size_px)
        self._arguments = {"imgsz": size_px, "conf": MIN_SCORE, "iou": MAX_OVERLAP, "max_det": MAX_BOXES}

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        boxes, scores = self._found(np.repeat(image[:, :, None], 3, axis=2))
        return np.asarray(boxes, np.float64).reshape(-1, 4), np.asarray(scores, np.float64).reshape(-1)

    @abstractmethod
    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        """Boxes and scores on the CPU as the library returns them, for an image of shape (H, W, 3)."""


class LibreBackend(Backend):
    """YOLOX of libreyolo."""

    def version(self) -> str:
        """See `Backend.version`."""
        return str(importlib.import_module("libreyolo").__version__)

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """See `Backend.train`."""
        from libreyolo import LibreYOLOX

        run = folder / "run"
        best, checkpoint = run / "weights" / "best.pt", run / "weights" / "last.pt"
        num_done = int(_read_checkpoint(checkpoint)["epoch"]) + 1 if checkpoint.exists() else 0
        if num_done < config.epochs:
            network = LibreYOLOX(None, size=config.size, nb_classes=1, device=config.device)
            arguments = training_arguments(config, data_file, run)
            if num_done:  # refused beside pretrained=False, which would begin from random weights again
                del arguments["pretrained"]
                arguments["resume"] = str(checkpoint)
            network.train(**arguments, **schedule(config), device=config.device)
        return best if best.exists() and _read_checkpoint(best)["best_mAP50_95"] > 0 else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> Detector:
        """See `Backend.load`."""
        from libreyolo import LibreYOLO

        check_torch_file(weights)
        return _LibreDetector(LibreYOLO(str(weights), device=config.device), config.image_size_px)


class _LibreDetector(_TorchDetector):
    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        found = self._network(image, color_format="bgr", **self._arguments)
        result = found[0] if isinstance(found, list) else found
        return result.boxes.xyxy, result.boxes.conf


class UltralyticsBackend(Backend):
    """YOLOv5u of ultralytics."""

    SIZES = ("n", "s", "m", "l", "x")

    def version(self) -> str:
        """See `Backend.version`."""
        return str(_ultralytics().__version__)

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """See `Backend.train`."""
        make_network = _ultralytics().YOLO
        for split in ("train", "val"):  # labels as it read them last; it takes others of the same size for those
            (data_file.parent / "labels" / f"{split}.cache").unlink(missing_ok=True)
        run = folder / "run"
        best, checkpoint = run / "weights" / "best.pt", run / "weights" / "last.pt"
        if not checkpoint.exists():
            make_network(config.weights or f"yolov5{config.size}.yaml").train(
                **training_arguments(config, data_file, run), device=_device(config), plots=False
            )
        else:
            epochs = run / "results.csv"  # a line each, below a header
            num_done = len(read_text(epochs, MIB, errors="replace").splitlines()) - 1 if epochs.exists() else 0
            if num_done < config.epochs:
                check_torch_file(checkpoint)
                make_network(str(checkpoint)).train(resume=True)
        return best if best.exists() else checkpoint

    def load(self, weights: Path, config: YoloConfig) -> Detector:
        """See `Backend.load`."""
        check_torch_file(weights)
        detector = _UltralyticsDetector(_ultralytics().YOLO(str(weights)), config.image_size_px)
        detector.device = _device(config)
        return detector


class _UltralyticsDetector(_TorchDetector):
    device: str | None = None

    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        boxes = self._network.predict(image, device=self.device, verbose=False, **self._arguments)[0].boxes
        return boxes.xyxy.cpu(), boxes.conf.cpu()


BACKENDS: dict[str, type[Backend]] = {"libreyolo": LibreBackend, "ultralytics": UltralyticsBackend}


def is_here(device: str) -> bool:
    """Whether torch has a device: the GPU of a number; `auto` and `cpu` are everywhere."""
    if not device.isdigit():
        return True
    import torch

    return int(device) < torch.cuda.device_count()


def training_arguments(config: YoloConfig, data_file: Path, run: Path) -> dict[str, Any]:
    """The arguments that both libraries' training takes under the same names; everything is written to `run`."""
    return {
        "data": str(data_file.resolve()),  # libreyolo searches its own folder of data sets first otherwise
        "project": str(run.parent.resolve()),
        "name": run.name,
        "exist_ok": True,
        "pretrained": bool(config.weights),
        "epochs": config.epochs,
        "batch": config.batch,
        "imgsz": config.image_size_px,
        "seed": config.seed,
        "patience": 0,
        "workers": 0 if config.device == "cpu" else 4,
    }


def schedule(config: YoloConfig) -> dict[str, Any]:
    """Libreyolo's recipe for 300 epochs; for fewer epochs, with its parts in proportion.

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


def count_multiply_adds(network: Any, size_px: int) -> int:
    """Multiply-adds of a torch module for one image of 3 x size_px x size_px, in convolutions and matrix products."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    first = next(network.parameters())
    was_training = network.training
    network.eval()
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        network(torch.zeros(1, 3, size_px, size_px, dtype=first.dtype, device=first.device))
    network.train(was_training)
    return int(counter.get_total_flops()) // 2


def _read_checkpoint(checkpoint: Path) -> dict[str, Any]:
    """Number of the last epoch and the best score in libreyolo's checkpoint; a killed process may have left half."""
    try:
        content = read_torch_file(checkpoint)
        return {name: content[name] for name in ("epoch", "best_mAP50_95")}
    except (ValueError, LookupError, TypeError) as error:
        reason = first_line_of(error.__cause__ or error) or type(error).__name__
        raise ValueError(f"{checkpoint}: expected a checkpoint ({reason}); remove it to begin again") from error


def _ultralytics() -> ModuleType:
    """The library, prevented from using the network."""
    os.environ.setdefault("YOLO_OFFLINE", "true")
    return importlib.import_module("ultralytics")


def _device(config: YoloConfig) -> str | None:
    return None if config.device == "auto" else config.device
