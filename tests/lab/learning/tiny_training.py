"""A learning problem that takes seconds: is there a bright blob in the crop?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from torch import Tensor, nn

from foreglow.classifier.inputs import InputSpec
from foreglow.lab.learning.recipes import Augmentation, Recipe
from foreglow.lab.learning.samples import Samples

SIZE_PX = 16

RECIPE = Recipe(
    network="tiny",
    inputs=InputSpec(size_px=SIZE_PX, support=2, lag_s=None, num_features=0),
    epochs=4,
    batch_size=32,
    optimiser="adamw",
    learning_rate=0.01,
    weight_decay=0.01,
    schedule="cosine",
    warmup_epochs=0.5,
    ema_decay=0.9,
    augmentation=Augmentation(flip=0.5, rotation_deg=10.0, min_area=0.8, max_ratio=1.2, gamma=0.2, noise=0.02),
    seed=3,
)


class TinyNetwork(nn.Module):
    """Reads crops and features; has dropout and batch normalisation, whose states a checkpoint must keep."""

    def __init__(self, num_channels: int = 1, num_features: int = 0, num_outputs: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(num_channels, 8, 3, stride=2)
        self.norm = nn.BatchNorm2d(8)
        self.dropout = nn.Dropout(0.1)
        self.out = nn.Linear(8 + num_features, num_outputs)

    def forward(self, crops: Tensor, features: Tensor) -> Tensor:
        x = torch.relu(self.norm(self.conv(crops))).amax(dim=(2, 3))
        logits: Tensor = self.out(torch.cat([self.dropout(x), features], dim=1))
        return logits


def make_tiny(recipe: Recipe) -> nn.Module:
    num_channels = 1 if recipe.inputs.lag_s is None else 2
    return TinyNetwork(num_channels, recipe.inputs.num_features, recipe.num_outputs)


def make_samples(num_samples: int, seed: int, **changed: Any) -> Samples:
    """A third of the crops has a blob; every tenth is not labelled and shows the opposite of what it seems."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:SIZE_PX, 0:SIZE_PX]
    labels = (random.random(num_samples) < 1 / 3).astype(np.int8)
    crops = random.uniform(0, 60, (num_samples, 1, SIZE_PX, SIZE_PX))
    for crop, label in zip(crops, labels, strict=True):
        x, y = random.uniform(5, SIZE_PX - 5, 2)
        crop += (190 if label else 30) * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 6)
    labels[::10] = -1
    arrays: dict[str, Any] = {
        "crops": np.clip(crops, 0, 255).astype(np.uint8),
        "features": np.zeros((num_samples, 0), np.float32),
        "labels": labels,
        "kinds": np.zeros((num_samples, 5), np.float32),
        "groups": np.where(labels == 1, random.integers(0, 3, num_samples), -1).astype(np.int8),
        "boxes_xyxy_px": np.tile(np.array([0, 0, 4, 4], np.int32), (num_samples, 1)),
        "image_ids": np.arange(num_samples, dtype=np.int64),
        "sequence_ids": np.zeros(num_samples, np.int64),
        "sets": np.arange(num_samples, dtype=np.int32),
    }
    return Samples(**arrays | changed)
