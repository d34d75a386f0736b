"""Generated crops to test a network with when no data may be used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
