"""Whose light makes the contrast of a box: exact, since every source has a layer of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated.shares import NUM_VEHICLE_SOURCES, SOURCES

RIM_SHARE = 0.25
"""Width of the rim around a box, as a share of its shorter side."""

MIN_RIM_PX = 2
TOP_SHARE = 0.25
"""Share of a box's pixels that count as its light: the brightest ones."""


def box_shares(light: NDArray[np.float32], boxes_xyxy_px: NDArray[np.int32]) -> NDArray[np.float32]:
    """Shares of each box's contrast by source, shape (N, 6), which sum to one.

    The contrast is the mean light of the box's brightest quarter less that of the rim around it. It is linear in the
    light, so that each source has its own, with the same pixels. What is brighter on the rim makes none of it: vehicles
    all together, our own light, fixed light; then the share of vehicles is divided likewise. Where nothing makes any
    contrast, the shares are those of the light itself.

    Args:
        light: Shape (6, H, W), cd/m² on the pixels by source, in the order of `SOURCES`.
        boxes_xyxy_px: Shape (N, 4), half-open boxes within the image.
    """
    total = light.sum(0)
    shares = np.zeros((len(boxes_xyxy_px), len(SOURCES)), np.float32)
    for row, box in zip(shares, boxes_xyxy_px, strict=True):
        contrasts = _positive(_contrasts(light, total, box))
        if contrasts.sum() <= 0.0:
            x1, y1, x2, y2 = box
            contrasts = np.maximum(light[:, y1:y2, x1:x2].mean((1, 2), dtype=np.float64), 1e-12)
        row[:] = contrasts / contrasts.sum()
    return shares


def _positive(contrasts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Contrasts of at least 0, shape (6,), with that of all vehicles as it was if that was positive."""
    positive = np.maximum(contrasts, 0.0)
    vehicles = slice(NUM_VEHICLE_SOURCES)
    together = max(float(contrasts[vehicles].sum()), 0.0)
    positive[vehicles] *= together / max(float(positive[vehicles].sum()), 1e-30)
    return positive


def _contrasts(light: NDArray[np.float32], total: NDArray[np.float32], box: NDArray[np.int32]) -> NDArray[np.float64]:
    """The contrast of a box by source, cd/m²."""
    x1, y1, x2, y2 = (int(edge) for edge in box)
    height, width = total.shape
    rim = max(MIN_RIM_PX, round(RIM_SHARE * min(x2 - x1, y2 - y1)))
    left, top = max(0, x1 - rim), max(0, y1 - rim)
    around = light[:, top : min(height, y2 + rim), left : min(width, x2 + rim)].reshape(len(light), -1)
    is_rim = np.ones((min(height, y2 + rim) - top, min(width, x2 + rim) - left), bool)
    is_rim[y1 - top : y2 - top, x1 - left : x2 - left] = False
    inside = total[y1:y2, x1:x2].ravel()
    num_top = max(1, round(TOP_SHARE * inside.size))
    brightest = np.argpartition(inside, inside.size - num_top)[inside.size - num_top :]
    lit = light[:, y1:y2, x1:x2].reshape(len(light), -1)[:, brightest].mean(1, dtype=np.float64)
    if not is_rim.any():  # the box is the image
        return np.asarray(lit)
    return np.asarray(lit - around[:, is_rim.ravel()].mean(1, dtype=np.float64))
