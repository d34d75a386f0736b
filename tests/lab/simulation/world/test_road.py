"""The course of a road: profiles, their inverse, side roads and time tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.lab.simulation.scenes.scene import Branch, RoadSpec
from foreglow.lab.simulation.world.road import CROWN, MAX_SUPERELEVATION, Road, branch_road, interpolated

STRAIGHT = Road(RoadSpec(length_m=100))
WINDING = Road(
    RoadSpec(
        length_m=200,
        curvature_per_m=((20, 0), (50, 0.015), (90, 0.015), (130, -0.02), (170, -0.02)),
        elevation_m=((0, 1), (80, 5), (200, -2)),
    )
)


@pytest.mark.parametrize("curvature", [0.05, 0.01, -0.02])
def test_constant_curvature_is_a_circle(curvature: float) -> None:
    road = Road(RoadSpec(length_m=100, curvature_per_m=((0, curvature),)))
    centre = np.array([0, 1 / curvature])
    distances = np.linalg.norm(road.points(np.linspace(0, 100, 50))[:, :2] - centre, axis=1)
    assert np.allclose(distances, 1 / abs(curvature), atol=2e-3)
    assert np.sign(road.points(10.0)[1]) == np.sign(curvature)  # positive is to the left


def test_arc_length_is_horizontal_length() -> None:
    points = WINDING.points(np.linspace(0, 200, 4001))[:, :2]
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(200, abs=0.01)


def test_curvature_is_the_profile_and_nothing_beyond_the_ends() -> None:
    assert np.allclose(WINDING.curvature_per_m([35, 60, 110, 150]), [0.0075, 0.015, -0.0025, -0.02], atol=1e-4)
    bend = Road(RoadSpec(length_m=60, curvature_per_m=((0, 0.02),)))
    assert bend.curvature_per_m([-25.0, -10.0, 85.0]).tolist() == [0, 0.01, 0]
    beyond = bend.points(np.array([85.0, 90.0, 500.0]))[:, :2]
    assert np.allclose(np.cross(np.append(beyond[1] - beyond[0], 0), np.append(beyond[2] - beyond[0], 0)), 0, atol=1e-3)


def test_elevation_meets_its_points_and_never_exceeds_them() -> None:
    assert np.allclose(WINDING.elevation_m([0, 80, 200]), [1, 5, -2])
    assert WINDING.elevation_m(np.linspace(0, 200, 400)).max() <= 5 + 1e-9
    assert WINDING.slope(40.0) > 0 > WINDING.slope(140.0)
    assert WINDING.slope(250.0) == pytest.approx(-7 / 120)


def test_carriageway_has_a_crown_or_leans_into_its_bend() -> None:
    assert np.allclose(STRAIGHT.cross_height_m(0, [-3, 0, 3]), [-3 * CROWN, 0, -3 * CROWN])
    left, right = WINDING.cross_height_m(70, 3), WINDING.cross_height_m(70, -3)
    assert left < 0 < right  # a bend to the left
    assert abs(WINDING.cross_height_m(70, 3)) <= 3 * MAX_SUPERELEVATION + 1e-9
    assert STRAIGHT.cross_height_m(0, 9) == STRAIGHT.cross_height_m(0, STRAIGHT.half_width_m)


@settings(max_examples=25)
@given(st.floats(0, 200), st.floats(-30, 30))
def test_places_undo_points(s: float, t: float) -> None:
    found_s, found_t = WINDING.places_m(WINDING.points(s, t))
    assert float(found_s) == pytest.approx(s, abs=1e-3)
    assert float(found_t) == pytest.approx(t, abs=1e-3)


def test_distance_from_the_centre_line() -> None:
    points = WINDING.points(np.linspace(10, 190, 30), 8.0)
    assert np.allclose(WINDING.distances_m(points), 8.0, atol=0.2)


def test_vehicles_pose_follows_slope_bank_and_direction() -> None:
    ahead, back = WINDING.pose(40, -1.75, 1, 2.7), WINDING.pose(40, 1.75, -1, 2.7)
    assert ahead.rotation[2, 0] > 0 > back.rotation[2, 0]  # uphill, downhill
    assert np.dot(ahead.rotation[:2, 0], back.rotation[:2, 0]) < -0.99
    assert np.allclose(ahead.position_m, WINDING.points(40, -1.75))
    front = ahead.to_outer([2.7, 0, 0])
    s, t = WINDING.places_m(front)
    assert t == pytest.approx(-1.75, abs=0.02)
    assert front[2] == pytest.approx(WINDING.points(s, t)[2], abs=0.02)


@pytest.mark.parametrize(("angle_deg", "side"), [(90, 1), (-90, -1), (60, 1), (-120, -1)])
def test_side_road_leaves_in_the_plane_of_the_main_road(angle_deg: float, side: int) -> None:
    spec = RoadSpec(length_m=200, elevation_m=((0, 0), (200, 10)), branches=(Branch(s_m=80, angle_deg=angle_deg),))
    main = Road(spec)
    branch = branch_road(main, 0)
    s, t = main.places_m(branch.points(60.0))
    assert np.sign(t) == side
    mouth = branch.points(main.half_width_m / abs(np.sin(np.radians(angle_deg))))
    s, t = main.places_m(mouth)
    assert abs(t) == pytest.approx(main.half_width_m, abs=0.01)
    assert mouth[2] == pytest.approx(main.points(s, t)[2], abs=0.01)
    assert abs(branch.slope(100.0)) < 1e-9
    assert branch.length_m == spec.branches[0].length_m


def test_time_table_is_met_and_goes_on_at_constant_speed() -> None:
    positions, speeds = interpolated(((0, 10), (2, 30), (4, 70)), np.array([-1.0, 0, 2, 4, 5]))
    assert np.allclose(positions[1:4], [10, 30, 70])
    assert positions[4] - positions[3] == pytest.approx(speeds[3])
    assert positions[1] - positions[0] == pytest.approx(speeds[1])
    standing, still = interpolated(((0, 25),), np.array([0.0, 7.0]))
    assert standing.tolist() == [25, 25]
    assert still.tolist() == [0, 0]


def test_too_tight_or_disordered_roads_are_refused() -> None:
    with pytest.raises(ValueError, match=r"radii of at least 20 m, got 10\.0 m"):
        RoadSpec(curvature_per_m=((0, 0.1),))
    with pytest.raises(ValueError, match="elevation_m: expected growing positions"):
        RoadSpec(elevation_m=((10, 0), (10, 1)))
