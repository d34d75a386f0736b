"""What all plots share: size, colours, and the way to a PNG."""

from __future__ import annotations

import importlib
from io import BytesIO
from typing import Any

INK, AMBER, BLUE, GREY, PALE = "#222222", "#d9822b", "#3b6fb6", "#888888", "#d5d9e0"
DPI = 130


def require_matplotlib() -> None:
    """Fails now rather than after an hour's work.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    importlib.import_module("matplotlib")


def subplots(num: int, width_in: float = 5.0, height_in: float = 3.4) -> tuple[Any, Any]:
    """A matplotlib figure and its `num` axes side by side, each `width_in` by `height_in` inches.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in * num, height_in), layout="constrained")
    axes = figure.subplots(1, num, squeeze=False)[0]
    for one in axes:
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def png(figure: Any) -> bytes:
    """The figure as PNG; the same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()
