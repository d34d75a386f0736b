"""Types of the values' arrays, and read-only views of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import MappingProxyType
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, shape (height, width), uint8 or uint16, linear index (row, column)."""

Boxes: TypeAlias = NDArray[np.int32]
"""Boxes, shape (N, 4), int32, columns x1, y1, x2, y2 in full-frame pixels, half-open."""


class Value:
    """A dataclass whose copies, also those from pickle, are made by its constructor: as frozen and checked as it."""

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
    """A read-only view of `array`; the owner's own flag stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view
