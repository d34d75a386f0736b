"""Whose light it is: the kinds that a classifier tells apart.

A classifier says two things about a box: the score, which is its probability of light of a vehicle, and how likely each
of four kinds is if it is such light. Both together are the probabilities of all of `KINDS`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.types.arrays import checked_array

KINDS = ("front_lamp", "rear_lamp", "front_light", "rear_light", "none")
"""A front lamp in sight, a rear lamp in sight, light of a front lamp on something, light of a rear lamp on something,
and none of these; of other vehicles. Arrays of kinds are in this order."""

LIGHT_KINDS = KINDS[:4]
"""The kinds that are light of a vehicle."""

KIND_WORDS = MappingProxyType(
    {
        "front_lamp": "front lamp",
        "rear_lamp": "rear lamp",
        "front_light": "light of a front lamp",
        "rear_light": "light of a rear lamp",
    }
)
"""What people read."""

_REAR = slice(1, None, 2)
_TOLERANCE = 1e-3


def kinds_of_direct(direct_probabilities: NDArray[np.floating]) -> NDArray[Any]:
    """The kinds where only lamps are told from their light: all of it counts as that of front lamps.

    Args:
        direct_probabilities: Shape (N,), of a lamp in sight; NaN where unknown.

    Returns:
        Shape (N, 4), of the same dtype, in the order of `LIGHT_KINDS`; NaN where unknown.

    >>> kinds_of_direct(np.array([0.75, np.nan])).tolist()
    [[0.75, 0.0, 0.25, 0.0], [nan, nan, nan, nan]]
    """
    none = 0 * direct_probabilities
    return np.stack([direct_probabilities, none, 1 - direct_probabilities, none], axis=1)


def direct_of_kinds(light_kinds: NDArray[np.floating]) -> NDArray[Any]:
    """Probability of a lamp in sight, shape (N,), of kinds of shape (N, 4); NaN where unknown.

    >>> direct_of_kinds(np.array([[0.5, 0.25, 0.125, 0.125]])).tolist()
    [0.75]
    """
    return np.asarray(np.minimum(light_kinds[:, 0] + light_kinds[:, 1], 1))


def tells_rear(light_kinds: NDArray[np.floating]) -> bool:
    """Whether kinds of shape (N, 4) tell light of rear lamps from that of front lamps, in any row."""
    return bool((light_kinds[:, _REAR] > 0).any())


def names_of_kinds(light_kinds: NDArray[np.floating]) -> tuple[str | None, ...]:
    """The most probable of `LIGHT_KINDS` in each row of shape (4,); None where it is unknown.

    >>> names_of_kinds(np.array([[0.1, 0.6, 0.2, 0.1], [np.nan] * 4]))
    ('rear_lamp', None)
    """
    is_unknown = np.isnan(light_kinds[:, 0]).tolist()
    greatest = light_kinds.argmax(axis=1).tolist()
    return tuple(None if gone else LIGHT_KINDS[index] for gone, index in zip(is_unknown, greatest, strict=True))


def told_kinds(light_kinds: NDArray[np.floating]) -> tuple[str | None, ...]:
    """As `names_of_kinds`, but None throughout if the model does not tell front from rear: what is shown to people.

    >>> told_kinds(np.array([[0.75, 0.0, 0.25, 0.0]])), told_kinds(np.array([[0.75, 0.1, 0.1, 0.05]]))
    ((None,), ('front_lamp',))
    """
    return names_of_kinds(light_kinds) if tells_rear(light_kinds) else (None,) * len(light_kinds)


def checked_kinds(field: str, light_kinds: NDArray[Any], count: int, dtype: type[np.floating]) -> NDArray[Any]:
    """A read-only view of `light_kinds`, or NaNs if it is empty.

    Raises:
        ValueError: If it is not of shape (count, 4) and `dtype`, or a row is neither NaN nor probabilities with the sum
            1; the message names the `field`.
    """
    if not np.size(light_kinds):
        light_kinds = np.full((count, len(LIGHT_KINDS)), np.nan, dtype)
    light_kinds = checked_array(field, light_kinds, np.dtype(dtype), (count, len(LIGHT_KINDS)))
    is_fit = (light_kinds.min(axis=1) >= 0) & (np.abs(light_kinds.sum(axis=1) - 1) <= _TOLERANCE)
    if not is_fit.all():
        is_fit |= np.isnan(light_kinds).all(axis=1)
    if not is_fit.all():
        row = light_kinds[~is_fit][0].tolist()
        raise ValueError(f"{field}: expected NaN or probabilities with the sum 1 in each row, got {row}")
    return light_kinds
