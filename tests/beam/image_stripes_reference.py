"""How much the rows and columns of an image change in turn, in NumPy: the specification of the native measures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

NUM_BANDS, BAND_PX, LEAST_ACROSS = 16, 32, 128
LAGS_PX = (1, 2, 3, 4, 6, 8)
LEAST_CHANGE = 0.05


def reference_stripes(before: NDArray[Any], now: NDArray[Any], top: int) -> NDArray[np.float64]:
    """Shape (2, 7), of two images of one size and type with pixels up to `top`."""
    pairs = ((before, now), (before.T, now.T))
    return np.array([_alternation(_bands(was), _bands(is_now), top / 255.0) for was, is_now in pairs])


def _bands(image: NDArray[Any]) -> NDArray[np.int64]:
    """Shape (bands, rows, pixels)."""
    num_rows, num_columns = image.shape
    num_in_band = min(BAND_PX, num_rows)
    num_bands = min(NUM_BANDS, num_rows // num_in_band)
    step = max(1, num_columns // LEAST_ACROSS)
    starts = [band * (num_rows - num_in_band) // max(1, num_bands - 1) for band in range(num_bands)]
    return np.array([image[start : start + num_in_band, step // 2 :: step] for start in starts]).astype(np.int64)


def _alternation(before: NDArray[np.int64], now: NDArray[np.int64], unit: float) -> list[float]:
    changes = np.abs(now - before).mean(axis=2) / unit
    found = []
    for lag in LAGS_PX:
        one, other = changes[:, lag:], changes[:, :-lag]
        ratios = np.abs(one - other) / (one + other + LEAST_CHANGE)
        found.append(float(np.median(ratios)) if ratios.size else 0.0)
    near, far = (_difference(now, lag) / unit for lag in (1, 2))
    return [*found, near / (far + LEAST_CHANGE)]


def _difference(now: NDArray[np.int64], lag: int) -> float:
    return float(np.abs(now[:, lag:] - now[:, :-lag]).mean()) if now.shape[1] > lag else 0.0
