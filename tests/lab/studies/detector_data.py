"""A data set, models and a stand-in for training, for the table of detectors: small and quick."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.lab.learning.export import Layers
from tests.lab.learning.networks import random_layers
from tests.lab.learning.yolo.night_data import make_night_data

if importlib.util.find_spec("onnx") is None:  # it is imported only where a model is made
    pytest.skip("models are made with onnx, of the extra train", allow_module_level=True)


def make_data(folder: Path, splits: Sequence[str] = ("train", "val", "test")) -> Path:
    """Two drives of three images in each split, the last image of each without a vehicle."""
    return make_night_data(folder, splits, num_images=3)


def make_model(path: Path, bias: float = 1.0) -> Path:
    """A classifier that knows nothing: every score is 1 / (1 + exp(-bias))."""
    from foreglow.lab.learning.export import write_onnx

    layers = random_layers((2,) * 8)
    weights = (*layers.weights[:-1], np.zeros_like(layers.weights[-1]))
    write_onnx(Layers(weights, (*layers.biases[:-1], np.array([bias]))), path, {})
    return path


@dataclass
class Trainings:
    """Stands in for `train_model`: writes the files of a training, and remembers what was asked for."""

    asked: list[dict[str, Any]] = field(default_factory=list)

    def train_model(self, data: Path, recipe: Any, config: PipelineConfig, folder: Path, **options: Any) -> None:
        self.asked.append({"data": data, "recipe": recipe, "config": config, "folder": folder} | options)
        folder.mkdir(parents=True)
        make_model(folder / "model.onnx")
        used = config.classifier.model_copy(update={"model": folder / "model.onnx"})
        (folder / "config.toml").write_text(config_to_toml(config.model_copy(update={"classifier": used})))
        summary = {"recipe": {"epochs": recipe.epochs, "network": recipe.network}, "num_epochs": 2, "seed": recipe.seed}
        (folder / "summary.json").write_text(json.dumps(summary | {"best_epoch": {"number": 1}}))


def boxes_around(points: Sequence[Sequence[float]], half_px: float = 5.0) -> NDArray[np.float64]:
    """A square box around each point, shape (N, 4)."""
    centres = np.array(points, np.float64).reshape(-1, 2)
    return np.concatenate([centres - half_px, centres + half_px], axis=1)
