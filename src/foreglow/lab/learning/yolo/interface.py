"""What a library that trains a YOLO has to do for us."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.config import FrozenModel

MIN_SCORE = 0.01
"""Boxes below this score are not kept; low, so that any threshold can be tried afterwards."""

MAX_OVERLAP = 0.45
"""Of two boxes that share more than this, intersection over union, the worse one goes (libreyolo's default)."""

MAX_BOXES = 300
"""Boxes of one image that are kept. Both libraries' default."""

BackendName: TypeAlias = Literal["libreyolo", "ultralytics"]
YoloSize: TypeAlias = Literal["n", "t", "s", "m", "l", "x"]


class YoloConfig(FrozenModel):
    """How a YOLO is trained; whatever is not here is as the library has it.

    Attributes:
        backend: The library.
        size: Nano, tiny, small, medium, large or extra large; the paper's are `s` and `x`.
        image_size_px: Side of the square images that it reads, a multiple of 32; the paper's is 960.
        epochs: Passes over the training split.
        batch: Images a step.
        seed: Of the initial weights, the order and the augmentation.
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
        """Boxes, shape (N, 4), xyxy in pixels of `image`, and their scores, shape (N,), after suppression.

        Args:
            image: A grey square; the network scales it to its own size.
        """
        ...


class Backend(Protocol):
    """A library that trains and runs YOLOs.

    Attributes:
        package: Its name on the package index.
        licence: Its licence, as stated there.
    """

    package: str
    licence: str

    def version(self) -> str:
        """The version that is installed.

        Raises:
            ModuleNotFoundError: If none is.
        """
        ...

    def train(self, data_file: Path, folder: Path, config: YoloConfig) -> Path:
        """Trains from random weights, goes on with what lies in `folder`, and returns the path of the best weights.

        Args:
            data_file: `data.yaml` of an exported data set.
            folder: For everything that the library writes.
            config: How.

        Raises:
            ModuleNotFoundError: If the library is not installed.
            ValueError: If it does not know the size, or a checkpoint in `folder` is broken.
        """
        ...

    def load(self, weights: Path, config: YoloConfig) -> Detector:
        """The network in `weights`.

        Raises:
            ModuleNotFoundError: If the library is not installed.
        """
        ...


def count_parameters(network: Any) -> int:
    """Weights and biases of a torch module."""
    return sum(parameter.numel() for parameter in network.parameters())


def count_multiply_adds(network: Any, size_px: int) -> int:
    """Multiply-adds of a torch module for one image of 3 x size_px x size_px; convolutions and matrices count."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    first = next(network.parameters())
    was_training = network.training
    network.eval()
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        network(torch.zeros(1, 3, size_px, size_px, dtype=first.dtype, device=first.device))
    network.train(was_training)
    return int(counter.get_total_flops()) // 2


def colour(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A grey image, shape (H, W), as the three equal channels that the libraries read."""
    return np.repeat(image[:, :, None], 3, axis=2)
