from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.street_data import road_ahead
from foreglow.maps import CentreLine
from tests.maps.roads import arc, pose, straight


def test_a_straight_road() -> None:
    road = straight(300.0).ahead(pose(20.0, -1.75), length_m=100.0, error_bound_m=2.0)
    assert road is not None
    assert (len(road), road.half_width_m, road.error_bound_m) == (101, 3.5, 2.0)
    np.testing.assert_allclose(road.points_m, np.stack([np.arange(101.0), [1.75] * 101, [0.0] * 101], -1), atol=1e-9)


def test_it_ends_where_the_map_ends() -> None:
    road = straight(300.0).ahead(pose(280.5, -1.75))
    assert road is not None
    assert road.points_m[-1].tolist() == pytest.approx([19.0, 1.75, 0.0])
    assert straight(300.0).ahead(pose(299.5, -1.75)) is None
    assert straight(300.0).ahead(pose(310.0, -1.75)) is None


def test_it_begins_where_the_map_begins() -> None:
    road = straight(300.0).ahead(pose(-10.0, 0.0), length_m=50.0)
    assert road is not None
    assert road.points_m[0].tolist() == [10.0, 0.0, 0.0]


def test_the_other_direction() -> None:
    line = CentreLine(straight().points_m, 3.5, np.linspace(0.01, 0.04, 31))
    road = line.ahead(pose(200.0, 1.75, yaw_deg=180.0), length_m=50.0)
    assert road is not None
    np.testing.assert_allclose(road.points_m[:3], [[0, 1.75, 0], [1, 1.75, 0], [2, 1.75, 0]], atol=1e-9)
    # What rises to the left of the line falls to the left of who drives against it.
    assert road.cross_slopes[0] == pytest.approx(-0.03)
    assert road.cross_slopes[50] == pytest.approx(-0.025)


@pytest.mark.parametrize("where", [pose(100.0, 25.0), pose(100.0, 0.0, yaw_deg=90.0), pose(100.0, 0.0, z=8.0)])
def test_a_road_that_is_not_ours(where: Pose) -> None:
    """Too far away; across our way; above us."""
    assert straight().ahead(where) is None


def test_heights_are_not_compared_where_nobody_knows_them() -> None:
    assert straight().ahead(pose(100.0, 0.0, z=300.0), is_on_road=True) is not None


def test_a_pose_put_onto_the_road() -> None:
    """A road that rises by 6 % and falls to the right by 4 %: seen from a car on it, it is the plane z = 0."""
    line = CentreLine(straight(slope=0.06).points_m, 3.5, np.full(31, 0.04))
    road = line.ahead(pose(100.0, -1.75, z=77.0, yaw_deg=3.0), length_m=80.0, is_on_road=True)
    assert road is not None
    assert np.abs(road.points_m[:, 2]).max() < 1e-9
    assert np.linalg.norm(road.points_m[0]) == pytest.approx(1.75, abs=0.01)
    assert np.arctan2(*np.diff(road.points_m, axis=0)[0, 1::-1]) == pytest.approx(np.radians(-3.0), abs=1e-3)


def test_of_two_places_the_one_with_our_heading() -> None:
    """A hairpin whose two sides are 10 m apart."""
    turns = np.linspace(-np.pi / 2, np.pi / 2, 40)
    bend = np.stack([100 + 5 * np.cos(turns), 5 + 5 * np.sin(turns), 0 * turns], -1)
    line = CentreLine(np.concatenate([[[0.0, 0, 0]], bend, [[0.0, 10, 0]]]), 3.0)
    road = line.ahead(pose(50.0, 4.0, yaw_deg=0.0), length_m=200.0)
    assert road is not None
    assert road.points_m[0, 1] == pytest.approx(-4.0)
    assert len(road) == pytest.approx(1 + 50 + np.pi * 5 + 100, abs=1.5)


def test_the_road_of_a_simulated_drive() -> None:
    """The same road, once as a map and once as the simulator knows it."""
    spec = RoadSpec(
        length_m=500.0,
        curvature_per_m=((0.0, 0.0), (200.0, 0.004), (400.0, -0.003)),
        elevation_m=((0.0, 0.0), (200.0, 4.0), (400.0, 0.0)),
    )
    road = Road(spec)
    line = CentreLine(road.points(np.arange(0.0, 500.5)), road.half_width_m)
    where = road.pose(120.0, -1.7, 1, 2.8)
    found = line.ahead(where, length_m=300.0)
    assert found is not None
    np.testing.assert_allclose(found.points_m, road_ahead(road, 120.0, where, 300.0), atol=0.05)


@settings(derandomize=True, max_examples=60)
@given(st.floats(1.0, 290.0), st.floats(-4.0, 4.0), st.floats(-20.0, 20.0), st.booleans())
def test_the_road_is_where_it_was(way_m: float, left_m: float, turn_deg: float, is_against: bool) -> None:
    """On a circle: all points lie on it, the first is beside us, and the way leads on."""
    line = CentreLine(arc(), 3.5)
    turned = way_m / 200.0
    side = np.array([-np.sin(turned), np.cos(turned), 0.0])
    position_m = np.array([200 * np.sin(turned), 200 * (1 - np.cos(turned)), 0.0]) + left_m * side
    yaw_rad = turned + np.radians(turn_deg) + np.pi * is_against
    where = Pose(position_m, rotation(yaw_rad))
    road = line.ahead(where, length_m=500.0)
    left = way_m if is_against else 300.0 - way_m
    if road is None:
        assert left < 1.1
        return
    assert len(road) == pytest.approx(1 + left, abs=1.1)
    back = where.to_outer(road.points_m)
    np.testing.assert_allclose(np.hypot(back[:, 0], back[:, 1] - 200.0), 200.0, atol=0.01)
    assert np.linalg.norm(road.points_m[0]) == pytest.approx(abs(left_m), abs=0.05)
    assert road.points_m[1, 0] > road.points_m[0, 0]


@pytest.mark.parametrize(
    ("points", "half_width_m", "cross_slopes", "message"),
    [
        ([[0, 0, 0]], 3.0, [], r"points_m: expected shape \(N, 3\)"),
        ([[0, 0, 0], [1, np.nan, 0]], 3.0, [], "points_m: expected finite"),
        ([[0, 0, 0], [0, 0, 1]], 3.0, [], "points_m: expected neighbours that differ horizontally"),
        ([[0, 0, 0], [1, 0, 0]], 0.0, [], "half_width_m: expected a positive number, got 0"),
        ([[0, 0, 0], [1, 0, 0]], 3.0, [0.0], "cross_slopes: expected 2 finite numbers"),
    ],
)
def test_errors(points: list[list[float]], half_width_m: float, cross_slopes: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CentreLine(np.array(points), half_width_m, np.array(cross_slopes))
