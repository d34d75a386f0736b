"""Types of the values' arrays, and read-only views of them."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, shape (height, width), uint8 or uint16, linear index (row, column)."""

Boxes: TypeAlias = NDArray[np.int32]
"""Boxes, shape (N, 4), int32, columns x1, y1, x2, y2 in full-frame pixels, half-open."""


def frozen_view(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of `array`; the owner's own flag stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view
