"""What a newcomer hands to the Python API: errors say what to call, results can be drawn."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import foreglow
from foreglow.types import Frame
from tests.stand_ins import REFERENCE, night_image, result_of, tracks_of


def step(frame: Any) -> object:
    return foreglow.Pipeline(REFERENCE).step(frame)


@pytest.mark.parametrize(
    ("call", "value", "remedy"),
    [
        (foreglow.propose, "night.png", "foreglow.read_image(path)"),
        (foreglow.propose, Path("night.png"), "foreglow.read_image(path)"),
        (step, "night.png", "foreglow.open_source(path)"),
        (step, Path("night.mp4"), "foreglow.open_source(path)"),
        (step, np.zeros((96, 128, 3), np.uint8), "foreglow.to_grey(image)"),
        (step, np.zeros((96, 128)), "foreglow.to_grey(image)"),
        (lambda image: Frame(image, 0), "night.png", "foreglow.open_source(path)"),
    ],
)
def test_errors_name_what_to_call(call: Callable[[object], object], value: object, remedy: str) -> None:
    with pytest.raises(ValueError, match=re.escape(remedy)):
        call(value)
    assert hasattr(foreglow, remedy.split("(")[0].removeprefix("foreglow."))


def test_a_result_can_be_drawn() -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    image = night_image()
    result = result_of(Frame(image, 0, frame=7), [[10, 20, 30, 50], [40, 20, 50, 30]], [0.8, 0.2])
    axes = result.plot(image)
    assert len(axes.images) == 1
    drawn: list[Any] = list(axes.patches)
    assert [(patch.get_x(), patch.get_width(), patch.get_height()) for patch in drawn] == [
        (9.5, 20, 30), (39.5, 10, 10),
    ]  # fmt: skip
    assert [text.get_text() for text in axes.texts] == ["0.80", "0.20"]
    assert axes.patches[0].get_edgecolor() != axes.patches[1].get_edgecolor()
    tracks = tracks_of([[10, 20, 30, 50]], ids=[4], ranges_m=[81.6])
    followed = foreglow.FrameResult(7, 0, result.proposals, None, tracks=tracks)
    assert followed.plot(axes=axes) is axes
    assert axes.texts[-1].get_text() == "#4 82 m"
    pyplot.close("all")


def test_labels_lie_over_no_other_label() -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    boxes = [[10 + 2 * k, 20 + k % 3, 20 + 2 * k, 30 + k % 3] for k in range(12)]
    scores = np.linspace(0.05, 0.95, 12).tolist()
    result = result_of(Frame(night_image(), 0), boxes, scores)
    axes = result.plot(night_image())
    tracks = tracks_of(boxes[:4], ids=[1, 2, 3, 4], ranges_m=[81.6] * 4)
    foreglow.FrameResult(0, 0, result.proposals, None, tracks=tracks).plot(axes=axes)
    axes.figure.canvas.draw()
    extents = [text.get_window_extent() for text in axes.texts]
    assert len(extents) == 16
    apart = [extent.padded(-1) for extent in extents]
    assert not [(k, n) for k in range(16) for n in range(k) if apart[k].overlaps(apart[n])]
    pyplot.close("all")


def test_without_an_image_rows_still_go_down() -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    axes = result_of(Frame(night_image(), 0), [[10, 20, 30, 50]]).plot()
    top, bottom = axes.get_ylim()[::-1]
    assert top <= 19.5 < 49.5 <= bottom
    pyplot.close("all")
