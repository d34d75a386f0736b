from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy import ndimage

from foreglow.lab.simulation.labels.peaks import area_above_half_px, find_peaks

Field = NDArray[np.float32]


def flooded(field: Field, floor: float, saddle: float) -> set[tuple[int, int]]:
    """The same peaks by letting the water fall pixel by pixel."""
    pixels = [at for at in np.ndindex(field.shape) if field[at] > floor]
    pixels.sort(key=lambda at: (-field[at], at))
    island: dict[tuple[int, ...], tuple[int, ...]] = {}
    kept: set[tuple[int, ...]] = set()

    def summit(at: tuple[int, ...]) -> tuple[int, ...]:
        return at if island[at] == at else summit(island[at])

    for row, column in pixels:
        steps = itertools.product((-1, 0, 1), repeat=2)
        near = {summit(at) for down, right in steps if (at := (row + down, column + right)) in island}
        highest = min(near, key=lambda at: (-field[at], at), default=(row, column))
        island[(row, column)] = highest
        if not near:
            kept.add((row, column))
        for other in near - {highest}:
            island[other] = highest
            if field[row, column] >= np.float32(saddle) * field[other]:
                kept.discard(other)
    return {(row, column) for row, column in kept}


def places(field: Field, floor: float, saddle: float) -> set[tuple[int, int]]:
    peaks = find_peaks(field, floor, saddle)
    return set(zip(peaks.rows.tolist(), peaks.columns.tolist(), strict=True))


shapes = hnp.array_shapes(min_dims=2, max_dims=2, max_side=12)


# Powers of two, so that no product is rounded.
@given(
    hnp.arrays(np.float32, shapes, elements=st.sampled_from([0.0, 1.0, 2.0, 3.0, 4.0, 7.0, 8.0])),
    st.sampled_from([0.0, 1.0, 2.5]),
    st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]),
)
def test_equals_falling_water(field: Field, floor: float, saddle: float) -> None:
    assert places(field, floor, saddle) == flooded(field, floor, saddle)


@pytest.mark.parametrize("seed", range(3))
def test_equals_falling_water_on_smooth_fields(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(size=(60, 90)).astype(np.float32)
    field = ndimage.gaussian_filter(noise, 2.0) * np.float32(10) + np.float32(1)
    found = places(field, 0.3, 0.5)
    assert found == flooded(field, 0.3, 0.5)
    assert len(found) > 10


def hills(*summits: tuple[float, float, float]) -> Field:
    """Gaussian hills of 5 px, each from x, y and height."""
    y, x = np.mgrid[:60, :120]
    total = sum(height * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 50) for cx, cy, height in summits)
    return np.asarray(total, np.float32)


def test_a_deep_valley_separates_and_a_shallow_one_does_not() -> None:
    # Two equal hills d apart meet at 2 exp(-d^2 / 200): 0.80 of the summit for 13.5 px, 0.27 for 20 px.
    assert len(find_peaks(hills((40, 30, 10), (60, 30, 10)), 0.1, 0.5)) == 2
    assert len(find_peaks(hills((40, 30, 10), (53.5, 30, 10)), 0.1, 0.5)) == 1


def test_highest_first_and_the_ripple_belongs_to_the_higher_one() -> None:
    field = hills((30, 30, 5), (80, 20, 9), (95, 20, 6))
    assert find_peaks(field, 0.1, 1.0).columns.tolist() == [80, 95, 30]
    peaks = find_peaks(field, 0.1, 0.5)
    assert peaks.columns.tolist() == [80, 30]
    assert peaks.rows.tolist() == [20, 30]
    assert peaks.heights == pytest.approx([9, 5], rel=0.1)


@pytest.mark.parametrize("field", [np.zeros((3, 4), np.float32), np.zeros((0, 4), np.float32)])
def test_nothing_above_the_floor(field: Field) -> None:
    assert len(find_peaks(field, 0.0, 0.5)) == 0


def test_a_plateau_is_one_peak_at_its_first_pixel() -> None:
    assert places(np.full((5, 6), 3, np.float32), 1.0, 1.0) == {(0, 0)}


@pytest.mark.slow
@given(hnp.arrays(np.float32, shapes, elements=st.sampled_from([0.0, 1.0, 2.0, 3.0, 4.0, 8.0])), st.data())
def test_area_is_the_island_at_half_height(field: Field, data: st.DataObject) -> None:
    row, column = (data.draw(st.integers(0, size - 1)) for size in field.shape)
    labels, _ = ndimage.label(field >= field[row, column] / 2, np.ones((3, 3)))
    assert area_above_half_px(field, row, column) == np.count_nonzero(labels == labels[row, column])
