"""`foreglow.propose`: one call from an array to boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import foreglow
from tests.stand_ins import night_image

GREY = night_image(0, 480, 640)
"""Half the presets' width, so that their sizes hold as they are, without reduction."""


def test_every_kind_of_array_gives_the_same_boxes() -> None:
    expected = foreglow.propose(GREY)
    assert expected.shape == (len(expected), 4)
    assert expected.dtype == np.int32
    assert len(expected) > 0
    kinds: list[Any] = [
        np.dstack([GREY] * 3),
        np.dstack([GREY] * 4),
        GREY.astype(np.uint16) * 257,
        GREY / 255.0,
        (GREY / 255.0).astype(np.float32),
        np.asfortranarray(GREY),
    ]
    for array in kinds:
        assert (foreglow.propose(array) == expected).all()


def test_presets_join_across_different_gaps() -> None:
    image = np.zeros((480, 640), np.uint8)
    image[200:212, 300:312] = image[200:212, 320:332] = 200
    assert len(foreglow.propose(image)) == 2
    assert len(foreglow.propose(image, preset="baseline")) == 1


@pytest.mark.parametrize(
    ("image", "complaint"),
    [
        (np.full((80, 80), np.nan), "NaN"),
        (np.full((80, 80), 1.5), "1.5"),
        (np.zeros((80, 80, 5), np.uint8), "shape"),
        (np.zeros((0, 80), np.uint8), "pixel"),
        (np.zeros((80, 80), np.int64), "int64"),
    ],
)
def test_unfit_arrays_are_refused(image: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        foreglow.propose(image)


def test_unknown_preset_is_refused() -> None:
    with pytest.raises(ValueError, match="expected one of paper, baseline"):
        foreglow.propose(GREY, preset="best")
