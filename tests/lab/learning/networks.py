"""Small made-up classifiers for the tests of `foreglow.lab.learning`."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.learning.export import Layers


def random_network(seed: int = 0) -> Any:
    """The paper's network with random weights and random batch statistics, in evaluation mode."""
    import torch

    from foreglow.lab.learning.networks import ArtifactNetwork

    torch.manual_seed(seed)
    network = ArtifactNetwork().eval()
    with torch.no_grad():
        for name, values in network.state_dict().items():
            if name.endswith(("running_mean", "running_var")) or (name.startswith("batch") and "num" not in name):
                values.uniform_(0.2, 1.5)
    return network


def random_layers(channels: tuple[int, ...], seed: int = 0) -> Layers:
    """Layers with `channels` hidden channels and positive and negative weights that keep the scale of values."""
    random = np.random.default_rng(seed)
    sides, inputs = (5, 3, 5, 3, 5, 3), 1
    weights: list[NDArray[np.float64]] = []
    biases: list[NDArray[np.float64]] = []
    for index, outputs in enumerate((*channels, 1)):
        shape = (outputs, inputs, *[sides[index]] * 2) if index < len(sides) else (outputs, inputs)
        weights.append(random.normal(0, np.sqrt(2 * outputs / np.prod(shape)), shape))
        biases.append(random.normal(0, 0.1, outputs))
        inputs = outputs
    return Layers(tuple(weights), tuple(biases))


def torch_logits(layers: Layers, crops: NDArray[np.float32]) -> NDArray[np.float32]:
    """What the layers compute, straight from their definition."""
    import torch
    from torch.nn import functional

    x = torch.from_numpy(crops)
    for index, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        parameters = torch.from_numpy(weight).float(), torch.from_numpy(bias).float()
        x = functional.conv2d(x, *parameters) if index < 6 else functional.linear(x, *parameters)
        x = torch.relu(x) if index < 8 else x
        x = functional.max_pool2d(x, 2) if index in (1, 3) else x
        x = x.mean((2, 3)) if index == 5 else x
    logits: NDArray[np.float32] = x[:, 0].numpy()
    return logits


def onnx_logits(model: bytes, crops: NDArray[np.float32]) -> NDArray[np.float32]:
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime as ort

    session = ort.InferenceSession(model, providers=["CPUExecutionProvider"])
    logits: NDArray[np.float32] = session.run(["logits"], {"crops": crops})[0]
    assert logits.shape == (len(crops), 1)
    return logits[:, 0]
