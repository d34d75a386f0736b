from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.scene import Branch, EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.simulation.traffic.kinematics import (
    BodyMotion,
    driving_direction,
    ego_state,
    lateral_m,
    vehicle_state,
)
from foreglow.lab.simulation.world.road import Road, branch_road, interpolated

STRAIGHT = Road(RoadSpec())
SMOOTH = BodyMotion(0, 0.0)


def test_ego_drives_on_the_right_at_the_speed_of_its_timetable() -> None:
    state = ego_state(EgoSpec(timetable=((0.0, 20.0), (10.0, 220.0))), STRAIGHT, SMOOTH, 2.0)
    assert np.allclose(state.pose.position_m[:2], [60.0, -1.75])
    assert state.speed_mps == pytest.approx(20.0)
    assert state.yaw_rate_radps == pytest.approx(0.0)


@pytest.mark.parametrize("curvature", [-0.01, 0.01])
def test_yaw_rate_is_speed_times_curvature(curvature: float) -> None:
    road = Road(RoadSpec(curvature_per_m=((0.0, curvature),)))
    state = ego_state(EgoSpec(timetable=((0.0, 50.0), (10.0, 250.0))), road, SMOOTH, 1.0)
    assert state.yaw_rate_radps == pytest.approx(20.0 * curvature, rel=1e-3)


def test_a_driver_who_strays_points_where_the_car_goes() -> None:
    ego = EgoSpec(timetable=((0.0, 0.0), (10.0, 200.0)), stray_m=0.5)
    states = [ego_state(ego, STRAIGHT, SMOOTH, time_s) for time_s in np.arange(1.0, 9.0, 0.05)]
    positions_m = np.array([state.pose.position_m for state in states])
    aside_m = positions_m[:, 1] + 1.75
    assert (aside_m.min(), aside_m.max()) == pytest.approx((-0.5, 0.5), abs=0.01)
    ahead = np.array([state.pose.rotation[:2, 0] for state in states])
    steps = np.gradient(positions_m[:, :2], axis=0)
    headings, courses = (np.arctan2(vectors[:, 1], vectors[:, 0]) for vectors in (ahead, steps))
    np.testing.assert_allclose(headings[1:-1], courses[1:-1], atol=1e-4)
    turned = np.gradient(headings, 0.05)
    np.testing.assert_allclose([state.yaw_rate_radps for state in states[1:-1]], turned[1:-1], atol=2e-4)


def test_oncoming_cars_face_us_on_their_lane() -> None:
    car = VehicleSpec(timetable=((0.0, 300.0), (10.0, 100.0)))
    state = vehicle_state(car, STRAIGHT, (), 2.7, 5.0)
    assert np.allclose(state.pose.position_m[:2], [200.0, 1.75])
    assert np.allclose(state.pose.rotation[:2, 0], [-1.0, 0.0], atol=1e-9)
    assert state.speed_mps == pytest.approx(20.0)


def test_lanes_and_directions() -> None:
    assert driving_direction(VehicleSpec(lane="own")) == 1
    assert driving_direction(VehicleSpec()) == -1
    assert driving_direction(VehicleSpec(lane="parked_left", is_towards=True)) == -1
    assert driving_direction(VehicleSpec(lane="parked_left", is_towards=False)) == 1


def test_a_parked_car_stands() -> None:
    car = VehicleSpec(lane="parked_right", timetable=((0.0, 80.0),))
    states = [vehicle_state(car, STRAIGHT, (), 2.7, time) for time in (0.0, 9.0)]
    assert np.allclose(states[0].pose.position_m, states[1].pose.position_m)
    assert states[0].speed_mps == 0.0


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("road", [RoadSpec(lane_width_m=2.8), RoadSpec(), RoadSpec(shoulders_m=(0.0, 2.2))])
def test_nobody_drives_through_a_parked_vehicle(road: RoadSpec, side: Literal["left", "right"]) -> None:
    parked = lateral_m(VehicleSpec(lane="parked_left" if side == "left" else "parked_right"), road)
    passing = lateral_m(VehicleSpec(lane="oncoming" if side == "left" else "own"), road)
    assert abs(parked) - abs(passing) >= 1.25 + 0.95
    assert np.sign(parked) == np.sign(passing)


def test_a_car_on_a_side_road_comes_to_ours() -> None:
    road = Road(RoadSpec(branches=(Branch(s_m=100.0, angle_deg=90.0),)))
    side = branch_road(road, 0)
    car = VehicleSpec(lane="branch", timetable=((0.0, 80.0), (4.0, 20.0)))
    state = vehicle_state(car, road, (side,), 2.7, 0.0)
    assert state.pose.position_m[1] == pytest.approx(80.0)
    assert np.allclose(state.pose.rotation[:2, 0], [0.0, -1.0], atol=1e-9)


def test_lateral_offset_overrides_the_lane() -> None:
    state = vehicle_state(VehicleSpec(lateral_m=0.5), STRAIGHT, (), 2.7, 0.0)
    assert state.pose.position_m[1] == pytest.approx(0.5)


def test_body_motion_is_a_small_smooth_function_of_time() -> None:
    body = BodyMotion(4, 1.0)
    pitches = np.array([np.degrees(np.arcsin(body.at(time).rotation[2, 0])) for time in np.arange(0, 60, 0.05)])
    assert 0.06 < pitches.std() < 0.25
    assert np.allclose(body.at(1.3).rotation, BodyMotion(4, 1.0).at(1.3).rotation)
    assert not np.allclose(body.at(1.3).rotation, BodyMotion(5, 1.0).at(1.3).rotation)
    assert np.allclose(SMOOTH.at(2.0).rotation, np.eye(3))


def test_timetable_goes_on_beyond_its_ends() -> None:
    positions, speeds = interpolated(((1.0, 10.0), (2.0, 30.0)), [0.0, 1.5, 3.0])
    assert np.allclose(positions, [-10.0, 20.0, 50.0])
    assert np.allclose(speeds, 20.0)
