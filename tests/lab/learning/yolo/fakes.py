"""Stand-ins for the libraries that train YOLOs: they record what they are told, and write what those would."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("torch")

import torch
from torch import nn

BOXES = [[10.0, 20.0, 30.0, 40.0], [-4.0, 0.0, 64.0, 80.0]]
SCORES = [0.25, 0.75]


@dataclass
class Calls:
    """What a stand-in was asked for.

    Attributes:
        name: The library.
        made: Arguments of every network made.
        trained: Arguments of every training.
        predicted: Arguments of every prediction.
        interrupt: Called at the start of every training.
    """

    name: str
    made: list[tuple[Any, ...]] = field(default_factory=list)
    trained: list[dict[str, Any]] = field(default_factory=list)
    predicted: list[dict[str, Any]] = field(default_factory=list)
    interrupt: Callable[[], None] = lambda: None


class FakeBoxes:
    """Boxes as both libraries give them."""

    def __init__(self) -> None:
        self.xyxy, self.conf = torch.tensor(BOXES), torch.tensor(SCORES)


def small_network() -> nn.Module:
    """1x1 convolution from 3 to 2 channels: 8 parameters, 6 multiply-adds a pixel."""
    return nn.Conv2d(3, 2, 1)


def fake_libreyolo(calls: Calls, best: float = 0.5) -> ModuleType:
    """`libreyolo`, whose training writes `last.pt` after its last epoch and `best.pt` at once."""

    class Network:
        def __init__(self, path: Any, **arguments: Any) -> None:
            calls.made.append((path, arguments))
            self.model = small_network()

        def train(self, **arguments: Any) -> None:
            if arguments.get("resume") and arguments.get("pretrained") is False:  # as the library says since 1.6
                raise ValueError("pretrained=False cannot be combined with resume.")
            calls.trained.append(arguments)
            weights = Path(arguments["project"]) / arguments["name"] / "weights"
            weights.mkdir(parents=True, exist_ok=True)
            torch.save({"epoch": 0, "best_mAP50_95": best}, weights / "last.pt")
            calls.interrupt()
            torch.save({"epoch": arguments["epochs"] - 1, "best_mAP50_95": best}, weights / "last.pt")
            torch.save({"epoch": 0, "best_mAP50_95": best}, weights / "best.pt")

        def __call__(self, image: Any, **arguments: Any) -> Any:
            calls.predicted.append({"shape": image.shape, **arguments})
            return SimpleNamespace(boxes=FakeBoxes())

    module = ModuleType("libreyolo")
    module.__dict__.update(__version__="1.2.3", LibreYOLOX=Network, LibreYOLO=Network)
    return module


def fake_ultralytics(calls: Calls) -> ModuleType:
    """`ultralytics`, whose training writes a line of `results.csv` an epoch."""

    class Network:
        def __init__(self, path: str) -> None:
            calls.made.append((path,))
            self._path = path
            self.model = small_network()

        def train(self, **arguments: Any) -> None:
            calls.trained.append(arguments)
            if arguments.get("resume"):
                run, epochs = Path(self._path).parents[1], 3
            else:
                run, epochs = Path(arguments["project"]) / arguments["name"], arguments["epochs"]
            (run / "weights").mkdir(parents=True, exist_ok=True)
            (run / "weights" / "last.pt").write_bytes(b"last")
            (run / "results.csv").write_text("epoch,loss\n1,0.5\n")
            calls.interrupt()
            (run / "results.csv").write_text("epoch,loss\n" + "1,0.5\n" * epochs)
            (run / "weights" / "best.pt").write_bytes(b"best")

        def predict(self, image: Any, **arguments: Any) -> Any:
            if arguments["device"] == "cpu":  # as the library does
                os.environ["CUDA_VISIBLE_DEVICES"] = "-1"
            calls.predicted.append({"shape": image.shape, **arguments})
            return [SimpleNamespace(boxes=FakeBoxes())]

    module = ModuleType("ultralytics")
    module.__dict__.update(__version__="8.0.0", YOLO=Network)
    return module
