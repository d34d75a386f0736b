"""Images of which rows or columns are stuck or black in turn, also behind an encoder, which mixes them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.image_faults import NUM_GOOD, Coding, as_coded, faults_of
from foreglow.beam.faults import GuardFault
from foreglow.types import Image
from tests.beam.watched import road_ahead, with_noise

pytestmark = pytest.mark.slow

CODINGS = [None, Coding("mjpeg", 1.0), Coding("mjpeg", 2.0)]
"""Raw, and motion JPEG of two rates."""


@pytest.fixture(scope="module")
def drive() -> list[Image]:
    return road_ahead()[: NUM_GOOD + 8]


def striped(drive: list[Image], width: int, axis: int, *, are_black: bool) -> list[Image]:
    images = [image.copy() for image in drive]
    is_wrong = np.arange(images[0].shape[axis]) // width % 2 == 0
    for image in images[NUM_GOOD:]:
        wrong = image.swapaxes(0, axis)
        wrong[is_wrong] = 0 if are_black else images[NUM_GOOD - 1].swapaxes(0, axis)[is_wrong]
    return images


@pytest.mark.parametrize("are_black", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("width", [1, 3, 8])
@pytest.mark.parametrize("coding", CODINGS)
def test_stripes(drive: list[Image], coding: Coding | None, width: int, axis: int, are_black: bool) -> None:
    """As where a field of an interlaced camera, or a channel of a sensor, comes no more."""
    faults = faults_of(as_coded(striped(with_noise(drive), width, axis, are_black=are_black), coding))
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("coding", CODINGS)
def test_interlaced_images_are_usual(drive: list[Image], coding: Coding | None) -> None:
    """Each image has the rows of two moments."""
    woven = [image.copy() for image in drive]
    for image, before in zip(woven[1:], drive, strict=False):
        image[1::2] = before[1::2]
    assert not any(faults_of(as_coded(woven, coding)))
