"""Where a hidden vehicle is expected: on its lane, where it comes into view, beyond the light that is seen of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.beam.occurrence import (
    AHEAD_S,
    EYE_M,
    FAR_M,
    LAMP_M,
    MIN_LEAD_M,
    OPEN_M,
    OTHER_MPS,
    PLACES_M,
    Occurrence,
    occurrence,
)
from foreglow.types import RoadAhead
from foreglow.types.frame import MAX_SPEED_MPS


def road(
    curvature_per_m: float = 0.0,
    half_width_m: float = 3.5,
    length_m: float = 420.0,
    turn_rad: float = 0.0,
    step_m: float = 6.0,
) -> RoadAhead:
    """An arc that begins 30 m behind us, to the left for a positive curvature, turned about us."""
    along_m = np.arange(-30.0, length_m, step_m)
    angles = curvature_per_m * along_m
    x = along_m * np.sinc(angles / np.pi)
    y = 0.5 * curvature_per_m * along_m**2 * np.sinc(angles / (2 * np.pi)) ** 2
    points = np.stack([x, y], axis=1) @ np.array(
        [[math.cos(turn_rad), math.sin(turn_rad)], [-math.sin(turn_rad), math.cos(turn_rad)]]
    )
    return RoadAhead(np.column_stack([points, np.zeros(len(points))]), half_width_m)


def expected(road: RoadAhead, light_range_m: float, speed_mps: float = 0.0) -> Occurrence:
    found = occurrence(road, light_range_m, speed_mps)
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


@pytest.mark.parametrize("speed_mps", [1e3, 1e6, 1e9])
def test_a_speed_that_no_car_has_counts_as_the_greatest(speed_mps: float) -> None:
    found, greatest = occurrence(road(), 80.0, speed_mps), occurrence(road(), 80.0, MAX_SPEED_MPS)
    assert found is not None
    assert greatest is not None
    assert found.azimuth_rad == greatest.azimuth_rad


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


@pytest.mark.parametrize("radius_m", [40.0, 80.0, 150.0, -40.0, -80.0, -150.0])
def test_in_a_bend_it_comes_into_view_where_the_line_of_sight_touches_what_is_inside(radius_m: float) -> None:
    """The tangents from us, on the centre line, and from its lane to the circle of what stands beside the road."""
    half_width_m = 3.5
    inside_m = abs(radius_m) - half_width_m - OPEN_M
    lane_m = abs(radius_m - 0.5 * half_width_m)
    angle = math.acos(inside_m / abs(radius_m)) + math.acos(inside_m / lane_m)
    found = expected(road(1.0 / radius_m, half_width_m), math.nan)
    forward_m, aside_m = lane_m * math.sin(angle), abs(radius_m) - lane_m * math.cos(angle)
    azimuth_rad = math.copysign(math.atan2(aside_m, forward_m), radius_m)
    one_place_rad = 0.5 * (PLACES_M[1] - PLACES_M[0]) / abs(radius_m)
    assert found.azimuth_rad == pytest.approx(azimuth_rad, abs=0.6 * one_place_rad)
    assert found.nearest_m(0.5) == pytest.approx(math.hypot(forward_m, aside_m), abs=10.0)


@pytest.mark.parametrize("radius_m", [600.0, 2000.0, 4000.0])
def test_behind_a_crest_it_comes_into_view_where_the_line_of_sight_touches_the_road(radius_m: float) -> None:
    """On a crest of the radius R, something h high is seen from the road's surface within sqrt(2 R h)."""
    flat = road()
    hill_m = -(flat.points_m[:, 0] ** 2) / (2.0 * radius_m)
    found = expected(RoadAhead(flat.points_m + np.outer(hill_m, [0.0, 0.0, 1.0]), flat.half_width_m), math.nan)
    seen_m = math.sqrt(2.0 * radius_m * EYE_M) + math.sqrt(2.0 * radius_m * LAMP_M)
    assert found.nearest_m(0.5) == pytest.approx(seen_m, abs=10.0)


def test_on_an_open_road_it_comes_into_view_far_away() -> None:
    assert expected(road(), math.nan).nearest_m(0.5) == pytest.approx(FAR_M, abs=10.0)


@given(CURVATURES, st.floats(0, 40))
def test_in_a_steady_bend_it_stays_where_it_is_seen(curvature: float, speed_mps: float) -> None:
    """We drive on, and turn as the road does: it looks the same from further along."""
    there, on = (expected(road(curvature, length_m=600.0, step_m=1.0), math.nan, speed) for speed in (0.0, speed_mps))
    np.testing.assert_allclose(on.azimuths_rad, there.azimuths_rad, atol=6e-3)
    assert on.azimuth_rad == pytest.approx(there.azimuth_rad, abs=6e-3)


def test_sharper_curves_are_further_aside() -> None:
    medians = [expected(road(curvature), 60.0).azimuth_rad for curvature in (-0.004, -0.001, 0.0, 0.001, 0.004)]
    assert medians == sorted(medians)


@pytest.mark.parametrize("speed_mps", [0.0, 30.0])
def test_it_is_beyond_the_light_and_moves_away_with_it(speed_mps: float) -> None:
    means_m = []
    for range_m in (20.0, 60.0, 120.0, 200.0, 300.0):
        found = expected(road(), range_m, speed_mps)
        assert found.ranges_m.min() >= range_m + MIN_LEAD_M - (speed_mps + OTHER_MPS) * AHEAD_S
        means_m.append(found.weights @ found.ranges_m)
    assert means_m == sorted(means_m)


def test_light_of_unknown_range_may_be_anywhere() -> None:
    found = expected(road(), math.nan)
    assert found.ranges_m.min() < PLACES_M[0] + 1.0
    assert found.ranges_m.max() > PLACES_M[-1] - 1.0


@pytest.mark.parametrize(("length_m", "range_m"), [(60.0, 100.0), (420.0, PLACES_M[-1] + OTHER_MPS), (3.0, math.nan)])
def test_no_place_is_left(length_m: float, range_m: float) -> None:
    assert occurrence(road(length_m=length_m), range_m) is None


def test_a_single_place() -> None:
    found = expected(road(length_m=62.0), 64.0)
    assert len(found.weights) == 1
    assert set(found.quantiles_rad((0.1, 0.5, 0.9))) == {found.azimuths_rad[0]}
