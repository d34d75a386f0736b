"""The interface of a library that trains and runs a YOLO, and what both libraries share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.config import FrozenModel

MIN_SCORE = 0.01
"""Boxes below this score are dropped; low, so that any threshold can be tried afterwards."""

MAX_OVERLAP = 0.45
"""Non-maximum suppression: largest intersection over union of two boxes (libreyolo's default)."""

MAX_BOXES = 300
"""Largest number of boxes per image. Both libraries' default."""

BackendName: TypeAlias = Literal["libreyolo", "ultralytics"]
YoloSize: TypeAlias = Literal["n", "t", "s", "m", "l", "x"]


class YoloConfig(FrozenModel):
    """How a YOLO is trained; everything else is the library's default.

    Attributes:
        backend: The library.
        size: Nano, tiny, small, medium, large or extra large; the paper uses `s` and `x`.
        image_size_px: Side of the network's square images, a multiple of 32; the paper uses 960.
        epochs: Passes over the training split.
        batch: Images in one step.
        seed: Seed of the initial weights, the order and the augmentation.
        device: `auto`, `cpu`, or the number of a GPU such as `0`.
    """

    backend: BackendName = "libreyolo"
    size: YoloSize = "s"
    image_size_px: Annotated[int, Field(ge=32, le=4096, multiple_of=32)] = 320
    epochs: Annotated[int, Field(ge=1, le=100_000)] = 3
    batch: Annotated[int, Field(ge=1, le=4096)] = 16
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    device: Annotated[str, Field(pattern=r"^(auto|cpu|\d+)$")] = "auto"


class Detector(Protocol):
    """A trained network.

    Attributes:
        num_parameters: Weights and biases.
        num_multiply_adds: Multiply-adds for one image.
    """

    num_parameters: int
    num_multiply_adds: int

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes, shape (N, 4), xyxy in pixels of `image`, and scores, shape (N,), after non-maximum suppression.

        Args:
            image: A grey square; the network scales it to its own size.
        """
        ...


class Backend(Protocol):
    """A library that trains and runs YOLOs.

    Attributes:
        package: Its name on the package index.
        licence: Its licence according to the package index.
    """

    package: str
    licence: str

    def version(self) -> str:
        """The installed version.

        Raises:
            ModuleNotFoundError: If it is not installed.
        """
        ...

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """Trains from random weights, or continues a training in `folder`; returns the path of the best weights.

        Args:
            data_file: `data.yaml` of an exported data set.
            folder: Folder for everything that the library writes.
            config: How to train.

        Raises:
            ModuleNotFoundError: If the library is not installed.
            ValueError: If it does not have this size, or a checkpoint in `folder` is broken.
        """
        ...

    def load(self, weights: Path, config: YoloConfig) -> Detector:
        """The network in `weights`.

        Raises:
            ModuleNotFoundError: If the library is not installed.
        """
        ...


class TorchDetector(ABC):
    """What the detectors of both libraries share."""

    def __init__(self, network: Any, size_px: int) -> None:
        """Takes the library's network, whose torch module is `network.model`."""
        self._network = network
        self.num_parameters = sum(parameter.numel() for parameter in network.model.parameters())
        self.num_multiply_adds = count_multiply_adds(network.model, size_px)
        self._arguments = {"imgsz": size_px, "conf": MIN_SCORE, "iou": MAX_OVERLAP, "max_det": MAX_BOXES}

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Detector.detect`."""
        boxes, scores = self._found(np.repeat(image[:, :, None], 3, axis=2))
        return np.asarray(boxes, np.float64).reshape(-1, 4), np.asarray(scores, np.float64).reshape(-1)

    @abstractmethod
    def _found(self, image: NDArray[np.uint8]) -> tuple[Any, Any]:
        """Boxes and scores on the CPU as the library returns them, for an image of shape (H, W, 3)."""


def training_arguments(config: YoloConfig, data_file: Path, run: Path) -> dict[str, Any]:
    """The arguments that both libraries' training takes under the same names; everything is written to `run`."""
    return {
        "data": str(data_file.resolve()),  # libreyolo searches its own folder of data sets first otherwise
        "project": str(run.parent.resolve()),
        "name": run.name,
        "exist_ok": True,
        "pretrained": False,
        "epochs": config.epochs,
        "batch": config.batch,
        "imgsz": config.image_size_px,
        "seed": config.seed,
        "patience": 0,
        "workers": 0 if config.device == "cpu" else 4,
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
