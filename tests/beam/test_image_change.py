"""The native comparer of images against its specification in NumPy, and what its measures say."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import foreglow._native as _native
from foreglow.beam.image_change import ImageComparer
from tests.beam.image_change_reference import reference_change, reference_parts

SIZES = [
    (1, 1),
    (1, 40),
    (40, 1),
    (7, 9),
    (8, 8),
    (9, 17),
    (16, 16),
    (17, 33),
    (64, 48),
    (97, 131),
    (250, 300),
    (50, 700),
]


def images(shape: tuple[int, int], dtype: Any, seed: int) -> list[Any]:
    """Noise, noise with one square that is brighter, rows that repeat, a flat corner, black, and white."""
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    noise = rng.integers(0, top // 8, shape).astype(dtype)
    square = noise.copy()
    square[16:32, 16:48] += top // 10
    repeated = np.repeat(noise[::2], 2, axis=0)[: shape[0]]
    corner = noise.copy()
    corner[: shape[0] // 2, : shape[1] // 2] = top
    return [noise, square, repeated, corner, square, np.zeros(shape, dtype), np.full(shape, top, dtype), noise]


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535), (np.uint16, 4095), (np.uint16, 1000)])
@pytest.mark.parametrize("shape", SIZES)
def test_equals_the_reference(shape: tuple[int, int], dtype: Any, top: int) -> None:
    comparer = _native.ImageComparer()
    sequence = [image // (np.iinfo(dtype).max // top) for image in images(shape, dtype, seed=3)]
    assert comparer.compare(sequence[0], top) is None
    for before, now in itertools.pairwise(sequence):
        change = comparer.compare(now, top)
        assert change is not None
        for name, expected in reference_change(before, now, top).items():
            np.testing.assert_allclose(getattr(change, name), expected, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535), (np.uint16, 4095), (np.uint16, 1000)])
@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("with_references", [False, True])
def test_parts_equal_the_reference(shape: tuple[int, int], dtype: Any, top: int, with_references: bool) -> None:
    rng = np.random.default_rng(6)
    sequence = [
        rng.integers(0, 4, shape).astype(dtype) * (top // 9) + rng.integers(0, 3, shape).astype(dtype) for _ in range(8)
    ]
    filled = np.arange(shape[1]) % 24 < 8
    for number, image in enumerate(sequence):
        image[shape[0] // 2 :] += dtype(top // 4)
        if number >= 5:
            image[:, filled] = top // 2
    comparer = _native.ImageComparer()
    for number, image in enumerate(sequence):
        change = comparer.compare(image, top)
        if change is not None:
            reference = sequence[number - 3] if with_references and number >= 3 else None
            expected = reference_parts(sequence[max(0, number - 2) : number + 1], reference, top)
            for name, value in expected.items():
                np.testing.assert_allclose(getattr(change, name), value, rtol=1e-12, atol=1e-12, err_msg=name)
        if with_references:
            comparer.keep()


def test_the_share_that_is_stuck_does_not_depend_on_the_noise_nor_on_images_that_come_twice() -> None:
    rng = np.random.default_rng(7)
    is_stuck = np.arange(1280) % 80 < 16
    scene = rng.uniform(40, 80, (960, 1280))
    for noise in (0.8, 1.5, 5.0):
        comparer = ImageComparer()
        first = rng.normal(scene, noise).round().astype(np.uint8)
        for number in range(4):
            image = rng.normal(scene, noise).round().astype(np.uint8)
            image[:, is_stuck] = first[:, is_stuck]
            changes = [comparer.compare(image, 255) for _ in range(2)]
            if number >= 2:
                assert changes[0] is not None
                assert changes[0].share_stuck == pytest.approx(0.2, abs=0.04)


def test_samples_that_have_not_changed_for_long_of_those_with_a_texture() -> None:
    rng = np.random.default_rng(8)
    comparer, shares = ImageComparer(), []
    first = rng.integers(40, 80, (240, 320), np.uint8)
    for _ in range(42):
        image = rng.integers(40, 80, (240, 320), np.uint8)
        image[:, :96] = first[:, :96]
        image[:, 96:192] = 7  # no texture, and no change
        changes = [comparer.compare(image, 255) for _ in range(2)]  # an image that comes twice does not count
        shares += [change.share_same_long for change in changes[:1] if change is not None]
    assert not any(shares[:35])
    np.testing.assert_allclose(shares[36:], 96 / (320 - 96), atol=0.03)
    assert changes[0] is not None
    assert changes[0].share_textured == pytest.approx((320 - 96) / 320, abs=0.05)


def test_any_strides_and_neither_size_nor_type_compared_with_another() -> None:
    first, second = images((97, 131), np.uint16, 5)[:2]
    strided = [np.asfortranarray(first), second[:, ::-1].copy()[:, ::-1], second[::-1].copy()[::-1]]
    comparer, plain = ImageComparer(), ImageComparer()
    for image in strided:
        found, expected = comparer.compare(image, 65535), plain.compare(np.ascontiguousarray(image), 65535)
        assert (found is None) == (expected is None)
        if found is not None and expected is not None:
            np.testing.assert_equal(found.tile_shares, expected.tile_shares)
            np.testing.assert_equal(found.pair_ratios, expected.pair_ratios)
            assert found.share_new_edges == expected.share_new_edges
    assert comparer.compare(first[:96], 65535) is None
    assert comparer.compare(first[:96].astype(np.uint8), 255) is None
    assert comparer.compare(first[:96].astype(np.uint8), 255) is not None
    comparer.reset()
    assert comparer.compare(first[:96].astype(np.uint8), 255) is None


def test_one_square_of_the_grid_is_four_sides_of_edges() -> None:
    rng = np.random.default_rng(0)
    before = rng.integers(0, 40, (160, 160), np.uint8)
    now = before.copy()
    now[32:48, 64:80] += 30
    comparer = ImageComparer()
    comparer.compare(before, 255)
    change = comparer.compare(now, 255)
    assert change is not None
    assert change.share_new_edges == 4 / 100
    assert change.edge_deviations == 2.0
    assert np.argwhere(change.tile_shares).tolist() == [[1, 3], [2, 3]]  # of 20 blocks, rows 4 and 5, columns 8 and 9
