"""Removing constant and nearly constant channels from a trained classifier, without any data.

A channel that is treated as constant is absorbed by the biases of the layer that reads it (`Layers.without`). Channels
are chosen in two steps:

1. *Proven.* Interval arithmetic bounds every channel over all crops in [0, 1], and the product of absolute weights
   along all paths bounds the effect of a unit deviation of a channel on the logit (its gain). Channels are removed in
   order of effect, as long as the sum of half range x gain stays below a tenth of the tolerance.
2. *Measured.* The influence of a channel is the first-order change of the score on generated crops (`probes.py`) when
   the channel is held at its mean. Channels are removed in order of influence per multiply-add saved, as many as keep
   every probe's score within the tolerance; this is checked with the folded network itself.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from foreglow.lab.learning.export import NUM_CONVOLUTIONS, POOLED, SIZE_PX, Layers


def render_probes(num_probes: int, size_px: int, seed: int) -> NDArray[np.float32]:
    """Crops like those of a night camera, and stranger ones: shape (N, 1, size_px, size_px), float32 in [0, 1].

    Each is a brightness gradient with up to six blobs of all sizes (soft, pointed or with a hard rim, some of them
    dark), often with an edge, noise, clipping at either end, and a gamma; stretched to [0, 1] in 256 levels as in
    `foreglow.classifier`.
    """
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:size_px, 0:size_px] / size_px
    crops = np.zeros((num_probes, 1, size_px, size_px), np.float32)
    for crop in crops[:, 0]:
        scene = random.uniform(0, 0.6) * _slope(random, rows, columns)
        for _ in range(random.integers(0, 7)):
            scene = scene + _blob(random, rows, columns)
        if random.random() < 0.4:
            scene = scene + random.uniform(-0.5, 0.5) * (_slope(random, rows, columns) > random.uniform(-0.4, 0.4))
        if random.random() < 0.8:
            scene = scene + 10 ** random.uniform(-3, -0.7) * random.normal(size=scene.shape)
        low = np.quantile(scene, random.uniform(0, 0.5)) if random.random() < 0.3 else scene.min()
        high = np.quantile(scene, random.uniform(0.7, 1)) if random.random() < 0.3 else scene.max()
        if high > low:
            stretched = (np.clip(scene, low, high) - low) / (high - low)
            crop[:] = np.round(255 * stretched ** random.uniform(0.5, 2)) / 255
    return crops


def _slope(random: np.random.Generator, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from a line through the centre, in crop sides."""
    angle = random.uniform(0, 2 * np.pi)
    return np.asarray((columns - 0.5) * np.cos(angle) + (rows - 0.5) * np.sin(angle))


def _blob(random: np.random.Generator, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """One ellipse of 1 % to 50 % of the crop's side, half of them round, one in seven dark."""
    column, row = random.uniform(-0.1, 1.1, 2)
    long, short = 10 ** random.uniform(-2, -0.3, 2)
    if random.random() < 0.5:
        short = long
    angle = random.uniform(0, np.pi)
    along = (columns - column) * np.cos(angle) + (rows - row) * np.sin(angle)
    across = (rows - row) * np.cos(angle) - (columns - column) * np.sin(angle)
    squared = (along / long) ** 2 + (across / short) ** 2
    shapes = (np.exp(-squared / 2), 1 / (1 + squared), (squared < 1).astype(np.float64))
    amplitude = 10 ** random.uniform(-1.2, 0.3) * (1 if random.random() < 0.85 else -1)
    return np.asarray(amplitude * shapes[random.integers(0, 3)])


_NUM_HIDDEN = 8
# The sigmoid's slope is at most 1/4, so the logit may change four times as much as the score.
_MAX_SIGMOID_SLOPE = 0.25
_PROVEN_SHARE = 0.1
# Number of probes in a batch; limits the memory to about 100 MB.
_BATCH = 32


def fold_constant_channels(layers: Layers, tolerance: float, num_probes: int = 256, seed: int = 0) -> Layers:
    """The network with fewer channels and nearly the same scores.

    Args:
        layers: The network.
        tolerance: The largest change of a score (a probability, 0 to 1) over the `num_probes` generated crops. Crops
            unlike all of them may change more: only the proven step's share, a tenth, is guaranteed for every crop in
            [0, 1]. (The published weights at 1e-3, on 300 crops of another seed: 99 % within 5e-4, the largest change
            1.8e-3.) With 0, only channels that are exactly constant or unused are removed, and scores change by no more
            than rounding.
        num_probes: Number of generated crops.
        seed: Seed of the generated crops.

    Raises:
        ValueError: If the tolerance is negative, NaN or at least 1.
    """
    if not 0 <= tolerance < 1:
        raise ValueError(f"fold: expected a tolerance of at least 0 and below 1, got {tolerance}")
    proven = _fold_proven(layers, _PROVEN_SHARE * tolerance / _MAX_SIGMOID_SLOPE)
    if tolerance == 0:
        return proven
    return _fold_measured(proven, (1 - _PROVEN_SHARE) * tolerance, render_probes(num_probes, SIZE_PX, seed))


def bound_effects(layers: Layers) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Range and effect of each hidden channel over all crops in [0, 1].

    Returns:
        Eight arrays (channels,) with the middle of each channel's bounds, its constant if it is removed; and eight with
        the largest change of the logit when the channel is held there.
    """
    low, high = np.zeros(1), np.ones(1)
    middles, half_ranges = [], []
    for weight, bias in zip(layers.weights[:-1], layers.biases[:-1], strict=True):
        flat = weight.reshape(*weight.shape[:2], -1)
        positive, negative = np.maximum(flat, 0).sum(axis=2), np.minimum(flat, 0).sum(axis=2)
        low, high = (
            np.maximum(positive @ low + negative @ high + bias, 0),
            np.maximum(positive @ high + negative @ low + bias, 0),
        )
        middles.append((low + high) / 2)
        half_ranges.append((high - low) / 2)
    gains = np.ones(1)
    effects = []
    for weight, half_range in zip(layers.weights[:0:-1], half_ranges[::-1], strict=True):
        # ReLU and pooling do not amplify; a channel that is constant passes nothing on.
        gains = np.abs(weight).reshape(*weight.shape[:2], -1).sum(axis=2).T @ gains
        effects.append(gains * half_range)
        gains = np.where(half_range > 0, gains, 0)
    return middles, effects[::-1]


def _fold_proven(layers: Layers, budget: float) -> Layers:
    """Step 1; `budget` is the largest permitted change of the logit of any crop."""
    middles, effects = bound_effects(layers)
    num_removed = int(np.searchsorted(np.cumsum(np.sort(np.concatenate(effects))), budget, side="right"))
    return _removed(layers, [rank >= num_removed for rank in _ranks(effects)], middles, effects)


def _fold_measured(layers: Layers, tolerance: float, probes: NDArray[np.float32]) -> Layers:
    """Step 2: removes as many channels, by influence per multiply-add, as the scores permit; found by bisection."""
    crops = torch.from_numpy(probes)
    expected = _scores(layers, crops)
    means, influences = _influences(layers, crops)
    savings = [_saved_multiply_adds(layers, index) for index in range(_NUM_HIDDEN)]
    ranks = _ranks([influence / saved for influence, saved in zip(influences, savings, strict=True)])
    best, fewest, most = layers, 0, sum(layers.num_channels)
    while fewest < most:
        num_removed = (fewest + most + 1) // 2
        candidate = _removed(layers, [rank >= num_removed for rank in ranks], means, influences)
        if float((_scores(candidate, crops) - expected).abs().max()) <= tolerance:
            best, fewest = candidate, num_removed
        else:
            most = num_removed - 1
    return best


def _ranks(values_by_layer: list[NDArray[np.float64]]) -> list[NDArray[np.int64]]:
    """Rank of each value, from 0, in the ascending order of all values."""
    values = np.concatenate(values_by_layer)
    ranks = np.empty(len(values), np.int64)
    ranks[np.argsort(values, kind="stable")] = np.arange(len(values))
    return np.split(ranks, np.cumsum([len(values) for values in values_by_layer])[:-1])


def _removed(
    layers: Layers,
    is_kept_by_layer: list[NDArray[np.bool_]],
    constants_by_layer: list[NDArray[np.float64]],
    influences: list[NDArray[np.float64]],
) -> Layers:
    """`layers` without the channels that are not kept; each layer keeps at least its most influential channel."""
    for index, (is_kept, constants) in enumerate(zip(is_kept_by_layer, constants_by_layer, strict=True)):
        if not is_kept.any():
            is_kept = np.arange(len(is_kept)) == np.argmax(influences[index])
        layers = layers.without(index, is_kept, constants)
    return layers


def _saved_multiply_adds(layers: Layers, index: int) -> int:
    """Multiply-adds saved by removing one channel of hidden layer `index`."""
    is_kept = np.arange(layers.num_channels[index]) > 0
    return layers.num_multiply_adds - layers.without(index, is_kept, np.zeros(len(is_kept))).num_multiply_adds


def _scores(layers: Layers, crops: Tensor) -> Tensor:
    with torch.no_grad():
        parameters = _parameters(layers)
        return torch.cat([torch.sigmoid(_forward(parameters, batch)[-1]) for batch in _batches(crops)])


def _batches(crops: Tensor) -> list[Tensor]:
    return [crops[start : start + _BATCH] for start in range(0, len(crops), _BATCH)]


def _influences(layers: Layers, crops: Tensor) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Each hidden channel's mean over the crops, and the largest first-order change of a score when held there."""
    parameters = _parameters(layers)
    sums: list[list[tuple[Tensor, Tensor, Tensor]]] = [[] for _ in range(_NUM_HIDDEN)]
    for batch in _batches(crops):
        *hidden, logits = _forward(parameters, batch.clone().requires_grad_())
        slopes = torch.autograd.grad(torch.sigmoid(logits).sum(), hidden)
        for index, (values, slope) in enumerate(zip(hidden, slopes, strict=True)):
            values, slope = (x.detach().reshape(*x.shape[:2], -1) for x in (values, slope))
            sums[index].append((values.mean(2), (values * slope).sum(2), slope.sum(2)))
    means, influences = [], []
    for batches in sums:
        averages, products, slope_sums = (torch.cat(parts).double().numpy() for parts in zip(*batches, strict=True))
        means.append(averages.mean(axis=0))
        influences.append(np.abs(products - means[-1] * slope_sums).max(axis=0))
    return means, influences


def _parameters(layers: Layers) -> list[tuple[Tensor, Tensor]]:
    pairs = zip(layers.weights, layers.biases, strict=True)
    return [(torch.from_numpy(weight).float(), torch.from_numpy(bias).float()) for weight, bias in pairs]


def _forward(parameters: list[tuple[Tensor, Tensor]], crops: Tensor) -> list[Tensor]:
    """The eight hidden layers after ReLU and pooling, and the logits (N,)."""
    results, x = [], crops
    for index, (weight, bias) in enumerate(parameters):
        x = functional.conv2d(x, weight, bias) if index < NUM_CONVOLUTIONS else functional.linear(x, weight, bias)
        if index in POOLED:
            x = functional.max_pool2d(x, 2)
        if index < _NUM_HIDDEN:
            x = torch.relu(x)
        if index == NUM_CONVOLUTIONS - 1:
            x = x.mean((2, 3))
        results.append(x)
    results[-1] = results[-1][:, 0]
    return results
