"""The paper's classifier for inference: nine plain layers, without batch normalisation and dropout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIZE_PX = 64
"""Side of the crops that the network reads."""

NUM_CONVOLUTIONS = 6
"""The first six layers are convolutions, the last three are fully connected."""

POOLED = (1, 3)
"""Indices of the convolutions that are followed by max pooling over 2x2 (paper: conv2 and conv4)."""

# Side of each convolution's output, to count operations: 64 -> 60 -> 58 | 29 -> 25 -> 23 | 11 -> 7 -> 5.
_OUTPUT_SIZES_PX = (60, 58, 25, 23, 7, 5)

_NAMES = (*(f"conv{i}" for i in range(1, 7)), *(f"int_out.afc{i}" for i in range(1, 4)))

# torch's default, which the published code uses.
_BATCH_NORM_EPS = 1e-5

# Far below the resolution of float32 sums (1e-7 of a value around 1), and its square is still a normal float32.
_DUST = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Weights and biases of the nine layers; ReLU follows all but the last, a mean over 5x5 follows the sixth.

    Attributes:
        weights: Six of shape (outputs, inputs, side, side), three of shape (outputs, inputs), float64.
        biases: Nine of shape (outputs,), float64.
    """

    weights: tuple[NDArray[np.float64], ...]
    biases: tuple[NDArray[np.float64], ...]

    @property
    def num_channels(self) -> tuple[int, ...]:
        """Channels of the eight hidden layers."""
        return tuple(len(bias) for bias in self.biases[:-1])

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(weight.size for weight in self.weights) + sum(bias.size for bias in self.biases)

    @property
    def num_multiply_adds(self) -> int:
        """Multiplications with a weight for one crop."""
        areas = [*(side**2 for side in _OUTPUT_SIZES_PX), 1, 1, 1]
        return sum(weight.size * area for weight, area in zip(self.weights, areas, strict=True))

    def without(self, index: int, is_kept: NDArray[np.bool_], constants: NDArray[np.float64]) -> Layers:
        """The network with some channels of hidden layer `index` replaced by constants.

        No convolution is padded, so a constant channel adds the same to every output of the next layer: the sum of the
        weights that read it, times its value.

        Args:
            index: The hidden layer, 0 to 7.
            is_kept: Shape (channels,).
            constants: Shape (channels,): value of each channel after ReLU and pooling, for those that are not kept.
        """
        reader = self.weights[index + 1]
        weights, biases = list(self.weights), list(self.biases)
        weights[index], biases[index] = weights[index][is_kept], biases[index][is_kept]
        weights[index + 1] = reader[:, is_kept]
        biases[index + 1] = biases[index + 1] + _summed(reader)[:, ~is_kept] @ constants[~is_kept]
        return replace(self, weights=tuple(weights), biases=tuple(biases))


def layers_from_state(state: Mapping[str, NDArray[Any]]) -> Layers:
    """The layers of a state dict of `networks.ArtifactNetwork` in evaluation mode.

    Each batch normalisation, a scale and a shift of every channel, is folded into the layer that reads it. This is
    exact, since no convolution is padded.
    """
    values = {name: np.asarray(value, np.float64) for name, value in state.items()}
    weights = [values[f"{name}.weight"] for name in _NAMES]
    biases = [values.get(f"{name}.bias", np.zeros(len(values[f"{name}.weight"]))) for name in _NAMES]
    for number in (2, 4, 6):
        norm = f"batch{number}"
        scales = values[f"{norm}.weight"] / np.sqrt(values[f"{norm}.running_var"] + _BATCH_NORM_EPS)
        shifts = values[f"{norm}.bias"] - scales * values[f"{norm}.running_mean"]
        # The layer after conv2 is conv3, whose index is 2.
        biases[number] = biases[number] + _summed(weights[number]) @ shifts
        weights[number] = weights[number] * scales.reshape(1, -1, *[1] * (weights[number].ndim - 2))
    return Layers(tuple(_without_dust(weight) for weight in weights), tuple(_without_dust(bias) for bias in biases))


def _without_dust(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """`values` with zeros instead of numbers so small that they only make subnormal products.

    Weight decay leaves such numbers in dead channels, and subnormal numbers make the network 10 times slower.
    """
    return np.where(np.abs(values) < _DUST, 0.0, values)


def _summed(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shape (outputs, inputs): the sum over each filter."""
    return np.asarray(weight.sum(axis=tuple(range(2, weight.ndim))))
