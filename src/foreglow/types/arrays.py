"""Types of the values' arrays, and read-only views of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from foreglow.wording import shortened

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, shape (height, width), uint8 or uint16, linear index (row, column)."""

Boxes: TypeAlias = NDArray[np.int32]
"""Boxes, shape (N, 4), int32, columns x1, y1, x2, y2 in full-frame pixels, half-open."""


def with_adjacent_columns(image: Image) -> Image:
    """`image` where the pixels of a row lie side by side, as the C++ core reads them; else a copy in which they do."""
    adjacent: Image = image if image.strides[1] == image.itemsize else image.copy(order="C")
    return adjacent


class Value:
    """A dataclass whose copies, also those from pickle, are made by its constructor: as frozen and checked as it.

    Those with arrays are equal to themselves alone, and not to their copies.
    """

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        fields = dataclasses.fields(cast("Any", self))
        return _made, (type(self), {each.name: _plain(getattr(self, each.name)) for each in fields if each.init})


def _made(kind: Callable[..., Any], values: dict[str, Any]) -> Any:
    return kind(**values)


def _plain(value: Any) -> Any:
    """A view of a dictionary cannot be pickled."""
    return dict(value) if isinstance(value, MappingProxyType) else value


def frozen_view(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of `array`, a plain one also of a masked array; the owner's own flag stays."""
    view = array.view(np.ndarray)
    view.flags.writeable = False
    return view


def check_unmasked(field: str, array: NDArray[Any]) -> None:
    """Passes an array in which nothing is masked: what is, would count like the rest.

    Raises:
        ValueError: If something is; the message begins with `field`.

    >>> check_unmasked("image", np.ma.masked_equal([1, 2, 2], 2))
    Traceback (most recent call last):
    ValueError: image: expected no masked values, got 2: fill them first, with array.filled(value)
    """
    if isinstance(array, np.ma.MaskedArray) and np.ma.is_masked(array):
        num = int(np.count_nonzero(np.ma.getmaskarray(array)))
        raise ValueError(f"{field}: expected no masked values, got {num}: fill them first, with array.filled(value)")


def checked_array(field: str, array: object, dtype: np.dtype[Any], shape: tuple[int | None, ...]) -> NDArray[Any]:
    """A read-only view of `array`.

    Args:
        field: Its name, for the message.
        array: Anything, such as what a plug-in made.
        dtype: What it has to be of.
        shape: Its shape; None for an axis of any length.

    Raises:
        ValueError: If it is no array of that shape and type.

    >>> checked_array("Tracks.ids", [1, 2], np.dtype(np.int64), (None,))
    Traceback (most recent call last):
    ValueError: Tracks.ids: expected int64 of shape (N,), got list, no NumPy array
    """
    if isinstance(array, np.ndarray) and array.dtype == dtype:
        check_unmasked(field, array)
        is_fit = array.shape == shape
        if is_fit or (None in shape and len(shape) == array.ndim and _fits(array.shape, shape)):
            return frozen_view(array)
    raise ValueError(f"{field}: expected {dtype.name} of shape {_shape_words(shape)}, got {_array_words(array)}")


def check_numbers(field: str, array: object, shape: tuple[int | None, ...]) -> None:
    """As `checked_array`, for finite numbers of any type.

    Raises:
        ValueError: If it is no array of numbers of that shape, or one of them is NaN or infinite.

    >>> check_numbers("boxes", [[1, 2, 3, 4]], (None, 4))
    Traceback (most recent call last):
    ValueError: boxes: expected numbers of shape (N, 4), got list, no NumPy array
    """
    is_of_numbers = isinstance(array, np.ndarray) and array.dtype.kind in "iuf"
    if isinstance(array, np.ndarray) and is_of_numbers and len(shape) == array.ndim and _fits(array.shape, shape):
        check_unmasked(field, array)
        is_finite = np.isfinite(array)
        if not is_finite.all():
            raise ValueError(f"{field}: expected finite numbers, got {array[~is_finite][0]}")
        return
    raise ValueError(f"{field}: expected numbers of shape {_shape_words(shape)}, got {_array_words(array)}")


def check_image(field: str, image: object) -> None:
    """Checks that `image` is a grey one: shape (height, width), uint8 or uint16, of at least a pixel.

    Raises:
        ValueError: If it is not; the message begins with `field`.
    """
    is_grey = isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype in (np.uint8, np.uint16)
    if not is_grey or not np.size(cast("Any", image)):
        raise ValueError(f"{field}: expected uint8 or uint16 of shape (height, width), got {_array_words(image)}")


def check_kind(field: str, value: object, kind: type) -> None:
    """Checks that `value` is of the class `kind`.

    Raises:
        ValueError: If it is not; the message begins with `field`.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{field}: expected {kind.__name__}, got {type(value).__name__}")


def check_optional(field: str, value: object, kind: type) -> None:
    """As `check_kind`, for a value that may be None.

    Raises:
        ValueError: If it is neither; the message begins with `field`.

    >>> check_optional("camera", None, int)
    """
    if value is not None:
        check_kind(field, value, kind)


def check_members(field: str, value: object, expected: str, *names: str) -> None:
    """Checks that `value`, an object of anybody's class, has what is called so.

    Args:
        field: Its name, for the message.
        value: Anything, such as what a user plugs in.
        expected: What it is, in words.
        names: Its attributes and methods.

    Raises:
        ValueError: If it lacks one, or is a class; the message begins with `field`.

    >>> check_members("outputs", None, "connections to the lamps", "send", "close")
    Traceback (most recent call last):
    ValueError: outputs: expected connections to the lamps, got NoneType, which lacks send, close
    """
    lacking = [name for name in names if not hasattr(value, name)]
    if isinstance(value, type):
        raise ValueError(f"{field}: expected {expected}, got the class {value.__name__}, no object of it")
    if lacking:
        raise ValueError(f"{field}: expected {expected}, got {type(value).__name__}, which lacks {', '.join(lacking)}")


def check_each(field: str, values: object, expected: str, *names: str) -> None:
    """As `check_members`, for each of a sequence.

    Raises:
        ValueError: If there is no sequence, or one lacks something; the message begins with `field`.
    """
    check_kind(field, values, Sequence)
    for value in cast("Sequence[object]", values):
        check_members(field, value, expected, *names)


def check_callables(**functions: object) -> None:
    """Checks that each of the `functions`, which are given by their names, can be called.

    Raises:
        ValueError: If one cannot; the message begins with its name.
    """
    for name, value in functions.items():
        if not callable(value):
            raise ValueError(f"{name}: expected a function, got {shortened(value)}")


def check_names(field: str, names: object) -> None:
    """Checks that `names` is a sequence of texts, and no text, each of whose letters would be one.

    Raises:
        ValueError: If it is not; the message begins with `field`.

    >>> check_names("faults", "low_voltage")
    Traceback (most recent call last):
    ValueError: faults: expected a sequence of names, got 'low_voltage'
    """
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{field}: expected a sequence of names, got {shortened(names)}")


def checked_time_ns(field: str, time_ns: object) -> int:
    """A time in nanoseconds as a plain number.

    Raises:
        ValueError: If it is no whole number of 64 bits; the message begins with `field`.

    >>> checked_time_ns("Frame.timestamp_ns", 1.5)
    Traceback (most recent call last):
    ValueError: Frame.timestamp_ns: expected nanoseconds as a whole number of 64 bits, got 1.5
    """
    if not isinstance(time_ns, int | np.integer) or isinstance(time_ns, bool) or not -(2**63) <= time_ns < 2**63:
        raise ValueError(f"{field}: expected nanoseconds as a whole number of 64 bits, got {shortened(time_ns)}")
    return int(time_ns)


def _array_words(array: object) -> str:
    return (
        f"{array.dtype} of shape {array.shape}"
        if isinstance(array, np.ndarray)
        else f"{type(array).__name__}, no NumPy array"
    )


def _shape_words(shape: tuple[int | None, ...]) -> str:
    return str(tuple(shape)).replace("None", "N")


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return all(axis is None or axis == length for length, axis in zip(shape, wanted, strict=True))
