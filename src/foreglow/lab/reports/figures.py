"""What all plots share: size, colours, box plots, legends, and the way to a PNG."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats

INK, AMBER, BLUE, GREY, PALE, GREEN = "#222222", "#d9822b", "#3b6fb6", "#888888", "#d5d9e0", "#2c9c4b"
DPI = 130
MOST_IN_A_ROW = 8
"""Entries of a legend."""


def require_matplotlib() -> None:
    """Fails now rather than after an hour's work; figures look the same whatever a `matplotlibrc` says.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    importlib.import_module("matplotlib").rcdefaults()


def subplots(num: int, width_in: float = 5.0, height_in: float = 3.4) -> tuple[Any, Any]:
    """A matplotlib figure and its `num` axes side by side, each `width_in` by `height_in` inches.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in * num, height_in), layout="constrained")
    panels = figure.subplots(1, num, squeeze=False)[0]
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def box_plot(
    axes: Any,
    columns: Sequence[Floats],
    colours: Iterable[str],
    *,
    alpha: float,
    linewidth: float = 1.0,
    **options: Any,
) -> list[Any]:
    """Draws a filled box for each column of values, with a dark median and without outliers, and returns the boxes.

    Args:
        axes: Where to draw.
        columns: The values of each box, without NaN.
        colours: Of the boxes.
        alpha: How opaque they are.
        linewidth: Of their borders.
        options: Passed on to matplotlib's `boxplot`, such as `whis` and `positions`.
    """
    settings = {"showfliers": False, "medianprops": {"color": INK}} | options
    boxes: list[Any] = axes.boxplot(columns, patch_artist=True, **settings)["boxes"]
    for box, colour in zip(boxes, colours, strict=True):
        box.set(facecolor=colour, alpha=alpha, linewidth=linewidth)
    return boxes


def show_image(axes: Any, image: NDArray[Any], title: str, **how: Any) -> None:
    """Shows a picture with its title, and without axes; `how` is passed on to matplotlib's `imshow`."""
    axes.imshow(image, cmap="gray", interpolation="antialiased", **how)
    axes.set_title(title, fontsize=10)
    axes.set_axis_off()


def legend_above(figure: Any, axes: Any, **options: Any) -> None:
    """Puts the legend of `axes` above all axes, in rows of up to `MOST_IN_A_ROW` that are no wider than the figure."""
    handles, labels = axes.get_legend_handles_labels()
    num_rows = max(math.ceil(len(labels) / MOST_IN_A_ROW), 1)
    most = options.pop("ncols", max(math.ceil(len(labels) / num_rows), 1))
    for num_columns in range(most, 0, -1):
        settings = {"frameon": False, "ncols": num_columns} | options
        legend = figure.legend(handles, labels, loc="outside upper center", **settings)
        if num_columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def png(figure: Any) -> bytes:
    """The figure as PNG; the same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def jpeg(picture: NDArray[np.uint8], max_width_px: int, quality: int) -> bytes:
    """The picture, shape (H, W, 3), blue, green and red, as JPEG; reduced to `max_width_px` where it is wider."""
    height_px, width_px = picture.shape[:2]
    if width_px > max_width_px:
        size = (max_width_px, round(height_px * max_width_px / width_px))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
