"""Where a hidden vehicle is expected: on its lane, beyond the light that is seen of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.beam.occurrence import MIN_LEAD_M, PLACES_M, Occurrence, occurrence
from foreglow.types import RoadAhead


def road(
    curvature_per_m: float = 0.0, half_width_m: float = 3.5, length_m: float = 420.0, turn_rad: float = 0.0
) -> RoadAhead:
    """An arc that begins 30 m behind us, to the left for a positive curvature, turned about us."""
    along_m = np.arange(-30.0, length_m, 6.0)
    angles = curvature_per_m * along_m
    x = along_m * np.sinc(angles / np.pi)
    y = 0.5 * curvature_per_m * along_m**2 * np.sinc(angles / (2 * np.pi)) ** 2
    points = np.stack([x, y], axis=1) @ np.array(
        [[math.cos(turn_rad), math.sin(turn_rad)], [-math.sin(turn_rad), math.cos(turn_rad)]]
    )
    return RoadAhead(np.column_stack([points, np.zeros(len(points))]), half_width_m)


def expected(road: RoadAhead, light_range_m: float) -> Occurrence:
    found = occurrence(road, light_range_m)
    assert found is not None
    return found


RANGES = st.floats(5, 250) | st.just(math.nan)
CURVATURES = st.floats(-1 / 200, 1 / 200)


@given(CURVATURES, RANGES)
def test_it_is_a_distribution(curvature: float, range_m: float) -> None:
    found = expected(road(curvature), range_m)
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.weights.min() >= 0.0
    shares = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
    quantiles = found.quantiles_rad(shares)
    assert list(quantiles) == sorted(quantiles)
    assert found.azimuths_rad.min() <= quantiles[0]
    assert quantiles[-1] <= found.azimuths_rad.max()
    assert found.azimuth_rad == quantiles[3]


@given(RANGES)
def test_on_a_straight_road_it_is_the_oncoming_lane(range_m: float) -> None:
    found = expected(road(), range_m)
    np.testing.assert_allclose(found.ranges_m * np.sin(found.azimuths_rad), 0.5 * 3.5, atol=1e-9)
    assert 0.0 < found.azimuth_rad < math.atan2(0.5 * 3.5, PLACES_M[0])


@given(CURVATURES, RANGES)
def test_a_mirrored_road_mirrors_it(curvature: float, range_m: float) -> None:
    """But for the lane, which stays on the left: so these roads have next to no width."""
    there, mirrored = expected(road(curvature, 1e-9), range_m), expected(road(-curvature, 1e-9), range_m)
    assert mirrored.azimuth_rad == pytest.approx(-there.azimuth_rad, abs=1e-9)
    np.testing.assert_allclose(mirrored.azimuths_rad, -there.azimuths_rad, atol=1e-9)
    np.testing.assert_allclose(mirrored.weights, there.weights)


@given(CURVATURES, RANGES, st.floats(-0.2, 0.2))
def test_a_turned_road_turns_it(curvature: float, range_m: float, turn_rad: float) -> None:
    there, turned = expected(road(curvature), range_m), expected(road(curvature, turn_rad=turn_rad), range_m)
    assert turned.azimuth_rad == pytest.approx(there.azimuth_rad + turn_rad, abs=1e-9)


def test_the_lane_is_on_the_left_of_the_road() -> None:
    for curvature in (-0.004, 0.0, 0.004):
        on_lane, on_line = expected(road(curvature), 60.0), expected(road(curvature, 1e-9), 60.0)
        assert (on_lane.azimuths_rad > on_line.azimuths_rad).all()
        assert on_lane.azimuth_rad > on_line.azimuth_rad


def test_sharper_curves_are_further_aside() -> None:
    medians = [expected(road(curvature), 60.0).azimuth_rad for curvature in (-0.004, -0.001, 0.0, 0.001, 0.004)]
    assert medians == sorted(medians)


def test_it_is_beyond_the_light_and_moves_away_with_it() -> None:
    means_m = []
    for range_m in (20.0, 60.0, 120.0, 200.0):
        found = expected(road(), range_m)
        assert found.ranges_m.min() >= range_m + MIN_LEAD_M
        means_m.append(found.weights @ found.ranges_m)
    assert means_m == sorted(means_m)


def test_light_of_unknown_range_may_be_anywhere() -> None:
    found = expected(road(), math.nan)
    assert found.ranges_m.min() < PLACES_M[0] + 1.0
    assert found.ranges_m.max() > PLACES_M[-1] - 1.0


@pytest.mark.parametrize(("length_m", "range_m"), [(60.0, 100.0), (420.0, PLACES_M[-1]), (3.0, math.nan)])
def test_no_place_is_left(length_m: float, range_m: float) -> None:
    assert occurrence(road(length_m=length_m), range_m) is None


def test_a_single_place() -> None:
    found = expected(road(length_m=62.0), 52.0)
    assert len(found.weights) == 1
    assert set(found.quantiles_rad((0.1, 0.5, 0.9))) == {found.azimuths_rad[0]}
