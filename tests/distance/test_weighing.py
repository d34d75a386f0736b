from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.distance.hypotheses import (
    FEATURES,
    BoxEvidence,
    Cells,
    Hypotheses,
    Kind,
    Parameters,
    cells_along,
    parameters_of,
    read_hypotheses,
)
from foreglow.distance.ribbon import PLACES_M, Alignment, ribbon
from foreglow.distance.weighing import Weigher, weighed_ranges, weighted_quantiles
from tests.distance.roads import line, road

CAMERA_M = np.array([2.0, 0.0, 1.25])
SHIPPED = parameters_of(read_hypotheses())


def some_boxes(count: int, seed: int, stretch: float = 1.0) -> BoxEvidence:
    """Anything that may be seen, half of it with a partner; `stretch` times as far from the ordinary."""
    random = np.random.default_rng(seed)
    pairs = random.normal(4.0, stretch, count)
    pairs[random.random(count) < 0.5] = np.nan
    return BoxEvidence(
        directions_rad=random.normal(0.0, [0.2 * stretch, 0.03 * stretch], (count, 2)),
        sizes_rad=np.exp(random.normal(-4.5, 0.8 * stretch, (count, 2))),
        features=random.normal(0.0, stretch, (count, len(FEATURES))),
        pair_log_ranges=pairs,
    )


def some_cells(num_kinds: int, seed: int) -> Cells:
    """Places in no order, with errors that are nearly of one direction, and some out of reach."""
    random = np.random.default_rng(seed)
    num = len(PLACES_M) * num_kinds
    across, up = np.exp(random.normal(-10.0, 2.0, (2, num)))
    return Cells(
        azimuths_rad=random.normal(0.0, 0.2, num),
        elevations_rad=random.normal(0.0, 0.03, num),
        variances_across=across,
        covariances=random.uniform(-0.999, 0.999, num) * np.sqrt(across * up),
        variances_up=up,
        log_ranges=random.uniform(0.5, 6.0, num).round(1),  # many of them equal
        log_priors=np.where(random.random(num) < 0.2, -1e6, random.normal(0.0, 2.0, num)),
    )


def assert_as_specified(parameters: Parameters, cells: Cells, boxes: BoxEvidence) -> None:
    found = Weigher(parameters).ranges(cells, boxes)
    assert found.shape == (3, len(boxes.sizes_rad))
    np.testing.assert_allclose(found, weighed_ranges(parameters, cells, boxes), rtol=1e-6)


@pytest.mark.parametrize("place_m", [*PLACES_M[:2].tolist(), 0.5 * PLACES_M[:2].sum()])
@pytest.mark.parametrize("has_road", [False, True])
def test_a_camera_right_above_a_place(place_m: float, *, has_road: bool) -> None:
    """4.5 m before the rear axle, where the first one is: every range was NaN."""
    ahead = ribbon(road(line(np.zeros(300)), 0.0), Alignment(0.0, 0.0, 0.0, 0.003, 0.2, 10.0)) if has_road else None
    camera_m, boxes = np.array([place_m, 0.0, 1.25]), some_boxes(9, 3)
    cells = cells_along(SHIPPED, ahead, camera_m, 0.002)
    assert np.isfinite(np.array(cells)).all()
    assert_as_specified(SHIPPED, cells, boxes)
    native = Weigher(SHIPPED).cells_along(ahead, camera_m, 0.002)
    np.testing.assert_allclose(native, cells, rtol=1e-9, atol=1e-12)
    assert np.isfinite(Weigher(SHIPPED).ranges(native, boxes)).all()


@pytest.mark.slow
@settings(derandomize=True, max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 30), st.sampled_from([0.1, 1.0, 3.0]))
def test_random_boxes_along_a_road(seed: int, count: int, stretch: float) -> None:
    random = np.random.default_rng(seed)
    bend, cross_slope = np.full(300, random.uniform(-1 / 60, 1 / 60)), random.choice([0.0, 0.04])
    yaw_rad, left_m, shift_m = random.normal(0.0, [0.02, 0.5, 5.0])
    alignment = Alignment(yaw_rad, left_m, shift_m, 0.003, 0.2, 10.0)
    ahead = ribbon(road(line(bend, random.normal(0.0, 1.0, 301).cumsum() * 0.02), cross_slope), alignment)
    known = None if seed % 4 == 0 else ahead
    cells = cells_along(SHIPPED, known, CAMERA_M, 0.002)
    assert_as_specified(SHIPPED, cells, some_boxes(count, seed, stretch))
    for name, found, wanted in zip(
        Cells._fields, Weigher(SHIPPED).cells_along(known, CAMERA_M, 0.002), cells, strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12, err_msg=name)


@settings(derandomize=True, max_examples=60)
@given(st.integers(0, 2**31), st.sampled_from([0.1, 1.0, 3.0]))
def test_random_cells(seed: int, stretch: float) -> None:
    assert_as_specified(SHIPPED, some_cells(len(SHIPPED.side), seed), some_boxes(5, seed, stretch))


@pytest.mark.parametrize("num_kinds", range(1, 10))
def test_any_number_of_kinds(num_kinds: int) -> None:
    kinds = tuple(
        Kind(name=str(k), offset_sigma_m=0.5, height_sigma_m=0.1, is_lamp=k % 2 == 0, log_share=k, pair_logit=k - 3)
        for k in range(num_kinds)
    )
    assert_as_specified(parameters_of(Hypotheses(kinds=kinds)), some_cells(num_kinds, num_kinds), some_boxes(9, 1))


def test_no_box_and_boxes_without_partners() -> None:
    cells, boxes = some_cells(len(SHIPPED.side), 1), some_boxes(6, 2)
    assert Weigher(SHIPPED).ranges(cells, BoxEvidence(*(column[:0] for column in boxes))).shape == (3, 0)
    assert_as_specified(SHIPPED, cells, boxes._replace(pair_log_ranges=np.full(6, np.nan)))


def test_one_cell_is_every_quantile() -> None:
    single = parameters_of(Hypotheses(kinds=(Kind(name="lamp", offset_sigma_m=0.5, height_sigma_m=0.1),)))
    cells = Cells(*(np.array([value]) for value in (0.1, 0.0, 1e-5, 0.0, 1e-5, 3.0, -1.0)))
    np.testing.assert_allclose(Weigher(single).ranges(cells, some_boxes(4, 3)), np.exp(3.0))


def test_a_box_that_nothing_explains_still_has_a_range() -> None:
    boxes = some_boxes(3, 4)
    far_off = boxes._replace(directions_rad=np.array([[3.0, 1.5], [-3.0, -1.5], [0.0, 1.5]]))
    cells = cells_along(SHIPPED, None, CAMERA_M, 0.0)
    assert_as_specified(SHIPPED, cells, far_off)
    assert_as_specified(SHIPPED, cells, boxes._replace(sizes_rad=np.full((3, 2), 1e-9)))
    assert_as_specified(SHIPPED, cells, boxes._replace(pair_log_ranges=np.array([-9.0, 18.0, np.nan])))


def test_an_earlier_frame_leaves_no_trace() -> None:
    weigher, boxes = Weigher(SHIPPED), some_boxes(5, 5)
    cells = some_cells(len(SHIPPED.side), 6)
    first = weigher.ranges(cells, boxes)
    fewer = Cells(*(column[: 11 * len(SHIPPED.side)] for column in cells))
    np.testing.assert_array_equal(weigher.ranges(fewer, boxes), Weigher(SHIPPED).ranges(fewer, boxes))
    np.testing.assert_array_equal(weigher.ranges(cells, boxes), first)


def test_arrays_that_do_not_fit_are_refused() -> None:
    weigher, cells, boxes = Weigher(SHIPPED), some_cells(len(SHIPPED.side), 1), some_boxes(2, 1)
    with pytest.raises(ValueError, match="cells: expected arrays of one length"):
        weigher.ranges(cells._replace(log_priors=cells.log_priors[:-1]), boxes)
    with pytest.raises(ValueError, match="cells: expected whole places of all kinds"):
        weigher.ranges(Cells(*(column[:-1] for column in cells)), boxes)
    with pytest.raises(ValueError, match="boxes: expected arrays of one length"):
        weigher.ranges(cells, boxes._replace(sizes_rad=boxes.sizes_rad[:1]))
    ahead = ribbon(road(line(np.zeros(300))), Alignment(0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="road: expected an entry for each place"):
        weigher.cells_along(dataclasses.replace(ahead, sin=ahead.sin[1:]), CAMERA_M, 0.0)


@settings(derandomize=True, max_examples=100)
@given(st.lists(st.floats(-5, 5), min_size=2, max_size=20, unique=True), st.integers(0, 1000))
def test_quantiles_rise_and_stay_within_the_values(values: list[float], seed: int) -> None:
    weights = np.random.default_rng(seed).normal(size=(3, len(values)))
    found = weighted_quantiles(np.array(values), weights, [0.1, 0.5, 0.9])
    assert (np.diff(found, axis=0) >= -1e-12).all()
    assert found.min() >= min(values) - 1e-12
    assert found.max() <= max(values) + 1e-12
    # A value with all the weight is every quantile.
    sure = np.where(np.arange(len(values)) == seed % len(values), 0.0, -1e6)[None]
    middle = weighted_quantiles(np.array(values), sure, [0.5])[0, 0]
    assert middle == pytest.approx(values[seed % len(values)], abs=1e-9)
