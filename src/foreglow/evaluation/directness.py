"""Direct or indirect: how well lamps themselves are told from their light on something."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def balanced_accuracy(is_true: NDArray[np.bool_], is_called: NDArray[np.bool_]) -> float:
    """The mean of the shares of both classes that are called what they are; NaN where one has no member.

    >>> balanced_accuracy(np.array([True, True, False]), np.array([True, False, False]))
    0.75
    """
    if is_true.all() or not is_true.any():
        return math.nan
    return float(is_called[is_true].mean() + (~is_called[~is_true]).mean()) / 2
