"""A data set and models for the table of detectors, small and quick."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.learning.layers import Layers
from tests.learning.networks import random_layers
from tests.learning.yolo.night_data import make_night_data


def make_data(folder: Path) -> Path:
    """Two drives of three images in each split, the last image of each without a vehicle."""
    return make_night_data(folder, num_images=3)


def make_model(path: Path, seed: int = 0) -> Path:
    """A tiny classifier of random weights; its scores lie on both sides of a half."""
    from foreglow.learning.export import write_onnx

    layers = random_layers((2, 2, 2, 2, 2, 2, 2, 2), seed)
    biases = (*layers.biases[:-1], np.zeros(1))
    write_onnx(Layers(layers.weights, biases), path, {})
    return path
