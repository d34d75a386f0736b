"""The native measures of stripes against their specification in NumPy, and what they say."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import foreglow._native as _native
from foreglow.beam.image_stripes import ImageStripes
from tests.beam.image_stripes_reference import reference_stripes
from tests.beam.test_image_change import SIZES, images


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535), (np.uint16, 4095), (np.uint16, 1000)])
@pytest.mark.parametrize("shape", [*SIZES, (33, 1300), (1300, 33), (520, 300)])
def test_equals_the_reference(shape: tuple[int, int], dtype: Any, top: int) -> None:
    stripes = ImageStripes()
    sequence = images(shape, dtype, 1)
    assert stripes.update(sequence[0], top) is None
    for before, now in itertools.pairwise(sequence):
        found = stripes.update(now, top)
        assert found is not None
        np.testing.assert_allclose(found, reference_stripes(before, now, top), rtol=1e-9, atol=1e-12)


def test_views_and_other_sizes() -> None:
    image = images((120, 160), np.uint8, 2)[0]
    stripes, plain = ImageStripes(), ImageStripes()
    for view in (image[::-1], image[:, ::2], image.T):
        assert stripes.update(view, 255) is None
        assert plain.update(np.ascontiguousarray(view), 255) is None
        turned = 255 - view
        np.testing.assert_array_equal(stripes.update(turned, 255), plain.update(np.ascontiguousarray(turned), 255))
    assert stripes.update(image.T.astype(np.uint16), 255) is None
    stripes.reset()
    assert stripes.update(image.T.astype(np.uint16), 255) is None


@pytest.mark.parametrize("width", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("axis", [0, 1])
def test_stripes_that_are_stuck(width: int, axis: int) -> None:
    rng = np.random.default_rng(3)
    one, other, third = rng.integers(0, 60, (3, 240, 320)).astype(np.uint8)
    stripes = ImageStripes()
    stripes.update(one, 255)
    intact = stripes.update(other, 255)
    assert intact is not None
    assert (intact[:, :6] < 0.1).all()
    np.testing.assert_allclose(intact[:, 6], 1.0, atol=0.02)
    is_stuck = np.arange(third.shape[axis]) // width % 2 == 0
    if axis == 0:
        third[is_stuck] = other[is_stuck]
    else:
        third[:, is_stuck] = other[:, is_stuck]
    striped = stripes.update(third, 255)
    assert striped is not None
    assert striped[axis].max() > 0.9
    assert (striped[1 - axis, :6] < 0.1).all()


def test_bad_arguments() -> None:
    stripes = _native.ImageStripes()
    with pytest.raises(ValueError, match="image: expected at least one pixel"):
        stripes.update(np.zeros((4, 0), np.uint8), 255)
    with pytest.raises(ValueError, match="top: expected at least 1"):
        stripes.update(np.zeros((4, 4), np.uint8), 0)
