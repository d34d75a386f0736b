"""Folding removes what is constant, all of it at tolerance 0, and never more than the tolerance allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("torch")

from foreglow.lab.learning.export import Layers
from foreglow.lab.learning.folding import bound_effects, fold_constant_channels, render_probes
from tests.lab.learning.networks import random_layers, torch_logits

pytestmark = pytest.mark.torch

CHANNELS = (6, 7, 8, 7, 8, 6, 6, 5)


def sigmoid(logits: NDArray[Any]) -> NDArray[Any]:
    values: NDArray[Any] = 1 / (1 + np.exp(-logits.astype(np.float64)))
    return values


def with_constant_channels(layers: Layers) -> tuple[Layers, tuple[int, ...]]:
    """Every hidden layer's channel 1 made always zero, and channel 0 of the odd ones always 0.3; what is left."""
    weights, biases = [w.copy() for w in layers.weights], [b.copy() for b in layers.biases]
    for index in range(8):
        weights[index][1], biases[index][1] = -np.abs(weights[index][1]), -0.1
        if index % 2:
            weights[index][0], biases[index][0] = 0, 0.3
    left = tuple(count - 1 - index % 2 for index, count in enumerate(layers.num_channels))
    return Layers(tuple(weights), tuple(biases)), left


def test_tolerance_zero_removes_exactly_what_is_constant() -> None:
    layers, left = with_constant_channels(random_layers(CHANNELS))
    folded = fold_constant_channels(layers, 0)
    assert folded.num_channels == left
    crops = render_probes(8, 64, seed=5)
    np.testing.assert_allclose(torch_logits(folded, crops), torch_logits(layers, crops), rtol=1e-5, atol=1e-5)


def test_nothing_constant_nothing_removed() -> None:
    assert fold_constant_channels(random_layers(CHANNELS, seed=3), 0).num_channels == CHANNELS


def test_unread_channel_is_removed() -> None:
    layers = random_layers(CHANNELS)
    layers.weights[3][:, 2] = 0
    assert fold_constant_channels(layers, 0).num_channels == (6, 7, 7, 7, 8, 6, 6, 5)


def test_constant_network_keeps_a_channel_a_layer() -> None:
    layers = random_layers(CHANNELS)
    dead = Layers(tuple(weight * 0 for weight in layers.weights), layers.biases)
    folded = fold_constant_channels(dead, 1e-3, num_probes=4)
    assert folded.num_channels == (1,) * 8
    crops = render_probes(2, 64, seed=1)
    np.testing.assert_allclose(torch_logits(folded, crops), torch_logits(dead, crops), atol=1e-6)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-2, 0.1])
def test_scores_of_the_probes_stay_within_the_tolerance(tolerance: float) -> None:
    layers = random_layers(CHANNELS, seed=1)
    for weight in layers.weights[1:]:
        weight *= 10.0 ** -np.arange(weight.shape[1]).reshape(1, -1, *[1] * (weight.ndim - 2))
    folded = fold_constant_channels(layers, tolerance, num_probes=32, seed=9)
    assert sum(folded.num_channels) < sum(CHANNELS)
    crops = render_probes(32, 64, seed=9)
    change = np.abs(sigmoid(torch_logits(folded, crops)) - sigmoid(torch_logits(layers, crops)))
    assert change.max() <= tolerance + 1e-6


def test_more_tolerance_never_costs_more() -> None:
    layers = random_layers(CHANNELS, seed=2)
    costs = [fold_constant_channels(layers, t, num_probes=16).num_multiply_adds for t in (0, 1e-3, 1e-2, 0.1, 0.5)]
    assert costs == sorted(costs, reverse=True)


def test_bounds_hold_on_random_crops() -> None:
    """Holding any one channel at its middle moves no logit by more than is proven."""
    layers = random_layers((3, 3, 3, 3, 3, 3, 3, 3), seed=4)
    middles, effects = bound_effects(layers)
    crops = np.concatenate([render_probes(4, 64, 6), np.random.default_rng(0).random((2, 1, 64, 64), np.float32)])
    logits = torch_logits(layers, crops)
    for index in range(8):
        for channel in range(3):
            held = layers.without(index, np.arange(3) != channel, middles[index])
            change = np.abs(torch_logits(held, crops) - logits).max()
            assert change <= effects[index][channel] * (1 + 1e-5) + 1e-5


def test_same_seed_same_network() -> None:
    layers = random_layers(CHANNELS, seed=6)
    first, second = (fold_constant_channels(layers, 0.05, num_probes=8) for _ in range(2))
    for one, other in zip(first.weights + first.biases, second.weights + second.biases, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("tolerance", [-1e-9, 1.0, float("nan")])
def test_impossible_tolerance(tolerance: float) -> None:
    with pytest.raises(ValueError, match="fold: expected a tolerance"):
        fold_constant_channels(random_layers(CHANNELS), tolerance)


def test_probes_span_zero_to_one() -> None:
    crops = render_probes(20, 64, seed=0)
    assert crops.shape == (20, 1, 64, 64)
    assert crops.dtype == np.float32
    assert crops.min() == 0
    assert (crops.max(axis=(1, 2, 3)) == 1).all()
    np.testing.assert_array_equal(crops, render_probes(20, 64, seed=0))
