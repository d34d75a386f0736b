"""Numbers that callers give, checked: one, some of any shape, points, a share, a count; NumPy's as Python's own."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.wording import shortened


def checked_floats(field: str, values: object) -> NDArray[np.float64]:
    """A copy of `values`, a number or numbers of any shape, as float64.

    Raises:
        ValueError: If they are something else, such as truth values; the message begins with `field`.

    >>> checked_floats("Pose.position_m", {})
    Traceback (most recent call last):
    ValueError: Pose.position_m: expected numbers, got {}
    """
    with contextlib.suppress(ValueError):  # lists of several lengths
        array = np.array(values)
        if array.dtype.kind in "iuf" and not np.ma.is_masked(values):
            return array.astype(np.float64)
    raise ValueError(f"{field}: expected numbers, got {shortened(values)}")


def checked_points(field: str, values: object, num: int, *, is_finite: bool = False) -> NDArray[np.float64]:
    """`values` as float64 numbers of shape (..., num), finite ones if asked for; those that are stay the same array.

    Raises:
        ValueError: If they are no such numbers, or of another shape; the message begins with `field`.

    >>> checked_points("points_camera", [[1.0, 2.0]], 3)
    Traceback (most recent call last):
    ValueError: points_camera: expected numbers of shape (..., 3), got shape (1, 2)
    """
    is_fit = type(values) is np.ndarray and values.dtype == np.float64
    points: NDArray[np.float64] = values if is_fit else checked_floats(field, values)  # type: ignore[assignment]
    if points.shape[-1:] != (num,):
        raise ValueError(f"{field}: expected numbers of shape (..., {num}), got shape {points.shape}")
    if is_finite and not np.isfinite(points).all():
        raise ValueError(f"{field}: expected finite numbers, got {points[~np.isfinite(points)][0]}")
    return points


def checked_number(field: str, value: object) -> float:
    """`value`, perhaps NaN or infinite, as a plain number.

    Raises:
        ValueError: If it is no number, or one that a float cannot hold; the message begins with `field`.

    >>> checked_number("EgoMotion.speed_mps", "fast")
    Traceback (most recent call last):
    ValueError: EgoMotion.speed_mps: expected a number, got 'fast'
    """
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            return float(value)
    raise ValueError(f"{field}: expected a number, got {shortened(value)}")


def checked_share(field: str, value: object) -> float:
    """A number from 0 to 1, such as a threshold of scores, as a plain one.

    Raises:
        ValueError: If it is another one, or none; the message begins with `field`.

    >>> checked_share("threshold", 2)
    Traceback (most recent call last):
    ValueError: threshold: expected a number from 0 to 1, got 2
    """
    number = math.nan
    with contextlib.suppress(ValueError):
        number = checked_number(field, value)
    if not 0.0 <= number <= 1.0:
        raise ValueError(f"{field}: expected a number from 0 to 1, got {shortened(value)}")
    return number


def checked_whole(field: str, value: object, least: int = 0, most: int = 2**53 - 1) -> int:
    """A whole number, such as a count or a seed, as a plain one; True and 2.0 are none.

    Raises:
        ValueError: If it is another one, or none; the message begins with `field`.

    >>> checked_whole("seed", -1)
    Traceback (most recent call last):
    ValueError: seed: expected a whole number of at least 0, got -1
    """
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if is_whole and least <= value <= most:  # type: ignore[operator]
        return int(value)  # type: ignore[call-overload, no-any-return]
    limit = f"from {least} to {most}" if is_whole and value > most else f"of at least {least}"  # type: ignore[operator]
    raise ValueError(f"{field}: expected a whole number {limit}, got {shortened(value)}")


def plain(value: Any, *, as_tuples: bool = False) -> Any:
    """`value` with Python's own numbers and truth values for NumPy's, also inside dictionaries, lists and tuples.

    Args:
        value: Anything; what is of another class stays as it is.
        as_tuples: Whether lists and arrays become tuples.

    >>> plain({"seed": np.int64(5), "size_px": (np.int32(2), 3)})
    {'seed': 5, 'size_px': (2, 3)}
    >>> plain(np.array([[1, 2], [3, 4]]), as_tuples=True)
    ((1, 2), (3, 4))
    """
    if isinstance(value, np.generic):
        return value.item()
    if as_tuples and isinstance(value, np.ndarray) and value.ndim:
        value = value.tolist()
    if type(value) in (list, tuple):
        parts = [plain(part, as_tuples=as_tuples) for part in value]
        return parts if type(value) is list and not as_tuples else tuple(parts)
    if type(value) is dict:
        return {name: plain(part, as_tuples=as_tuples) for name, part in value.items()}
    return value
