from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.distance.ribbon import PLACES_M, Alignment, mapped_course, mapped_curvatures, ribbon
from foreglow.types import RoadAhead
from tests.distance.roads import HALF_WIDTH_M, line, road, straight

BELIEVED = Alignment(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_straight_road_lies_straight_ahead() -> None:
    ahead = ribbon(straight(), BELIEVED)
    np.testing.assert_allclose(ahead.x_m[:, 0], PLACES_M, atol=1e-9)
    np.testing.assert_allclose(ahead.y_m, HALF_WIDTH_M / 2, atol=1e-9)
    np.testing.assert_allclose(ahead.z_m, 0.0, atol=1e-9)
    assert ahead.is_known.all()
    assert ahead.curvature_per_m == pytest.approx(0.0, abs=1e-12)


def test_a_map_that_ends_is_not_known_beyond() -> None:
    ahead = ribbon(straight(100), BELIEVED)
    np.testing.assert_array_equal(ahead.is_known[:, 0], PLACES_M <= 100.0)


def test_on_a_circle_every_place_looks_alike() -> None:
    circle = road(line(np.full(500, 1 / 300.0)))
    here, further = ribbon(circle, BELIEVED), ribbon(circle, BELIEVED._replace(shift_m=20.0))
    is_known = PLACES_M < 450.0
    np.testing.assert_allclose(further.x_m[is_known], here.x_m[is_known], atol=0.01)
    np.testing.assert_allclose(further.y_m[is_known], here.y_m[is_known], atol=0.02)
    assert here.curvature_per_m == pytest.approx(1 / 300.0, rel=0.1)


def test_a_shift_brings_the_bend_nearer() -> None:
    bend = road(line(np.r_[np.zeros(80), np.full(400, -1 / 150.0)]))
    nearer = road(line(np.r_[np.zeros(65), np.full(415, -1 / 150.0)]))
    shifted, expected = ribbon(bend, BELIEVED._replace(shift_m=15.0)), ribbon(nearer, BELIEVED)
    np.testing.assert_allclose(shifted.y_m[:-4], expected.y_m[:-4], atol=1e-6)
    np.testing.assert_allclose(shifted.cos[:-4], expected.cos[:-4], atol=1e-9)


def test_a_shift_back_looks_behind_the_maps_beginning() -> None:
    back = ribbon(straight(), BELIEVED._replace(shift_m=-30.0))
    np.testing.assert_allclose(back.x_m[:, 0], PLACES_M, atol=1e-9)


def test_a_shift_on_a_slope_that_changes_pitches_us() -> None:
    x = np.arange(451.0)
    hill = road(line(np.zeros(450), np.where(x > 50, 0.04 * (x - 50), 0.0)))
    up = ribbon(hill, BELIEVED._replace(shift_m=100.0))
    np.testing.assert_allclose(up.z_m[PLACES_M < 340], 0.0, atol=0.03)  # the hill is a plane once we are on it


def test_yaw_and_offset_move_the_road() -> None:
    ahead = ribbon(straight(), BELIEVED._replace(yaw_rad=0.02, left_m=0.5))
    x, y = PLACES_M, HALF_WIDTH_M / 2 - 0.5
    np.testing.assert_allclose(ahead.x_m[:, 0], math.cos(0.02) * x + math.sin(0.02) * y, atol=1e-9)
    np.testing.assert_allclose(ahead.y_m[:, 0], math.cos(0.02) * y - math.sin(0.02) * x, atol=1e-9)
    np.testing.assert_allclose(np.arctan2(ahead.sin, ahead.cos), -0.02, atol=1e-9)


def test_where_the_map_has_no_cross_slopes_they_are_those_of_usual_roads() -> None:
    plain = ribbon(RoadAhead(line(np.zeros(450)), HALF_WIDTH_M), BELIEVED)
    np.testing.assert_allclose(plain.crown, 0.02)
    assert plain.lean == pytest.approx(0.02)  # our lane, the right one, rises to the left
    assert plain.rise_m == pytest.approx(-0.02 * HALF_WIDTH_M / 2)
    bend = ribbon(RoadAhead(line(np.full(450, 1 / 100.0)), HALF_WIDTH_M), BELIEVED)
    np.testing.assert_allclose(bend.banking[5:], 0.04, rtol=2e-3)
    np.testing.assert_allclose(bend.crown[5:], 0.0, atol=1e-9)
    assert bend.lean == pytest.approx(-0.04, rel=0.01)


def test_courses_and_curvatures_of_a_circle() -> None:
    circle = road(line(np.full(300, 1 / 200.0), np.arange(301) * 0.01))
    np.testing.assert_allclose(mapped_curvatures(circle, np.array([0.0, 50.0])), 1 / 200.0, rtol=0.02)
    away, up = mapped_course(circle, np.array([20.0]))
    assert away[0] == pytest.approx(200.0 * (1 - math.cos(20 / 200.0)), abs=0.06)
    assert up[0] == pytest.approx(0.2, abs=1e-3)
