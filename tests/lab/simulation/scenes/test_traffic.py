"""Scenarios with traffic: collisions, sides of the road, the mirror image of a scene, drives without light."""

from __future__ import annotations

import itertools
from unittest.mock import patch

import numpy as np
import pytest

from foreglow.lab.simulation.scenes import planning
from foreglow.lab.simulation.scenes.assembly import without_collisions
from foreglow.lab.simulation.scenes.roadside import intensity_cd
from foreglow.lab.simulation.scenes.scenarios import MIXTURES, SCENARIOS, draw_scenes, mirrored, scenario
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.stream import Braking, slowed
from foreglow.lab.simulation.traffic.kinematics import vehicle_state
from foreglow.lab.simulation.world.bodies import BODIES
from foreglow.lab.simulation.world.road import Road, interpolated
from foreglow.photometry import street_lamp

TRAFFIC = [name for name in SCENARIOS if name not in MIXTURES["pvdn"]]
STRAIGHT = RoadSpec(length_m=400.0)


def drawn(name: str, seed: int) -> Scene:
    with patch.object(planning, "MAX_PLANS", 1):  # quick: as the first draw comes
        return scenario(name, seed)


def test_many_drives_have_places_in_the_distance_and_their_glow() -> None:
    scenes = [drawn("queue", seed) for seed in range(12)]
    num = sum(bool(scene.surroundings.settlements) for scene in scenes)
    assert 4 <= num < 12
    for scene in scenes:
        assert (scene.weather.glow_cd_m2 > 0) == bool(scene.surroundings.settlements)
        assert all(place.s_m + place.offset_m > 100.0 for place in scene.surroundings.settlements)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAFFIC)
def test_nobody_drives_through_anybody(name: str) -> None:
    for seed in range(3):
        scene = drawn(name, seed)
        road = Road(scene.road)
        for time_s in np.arange(0.0, scene.duration_s, 0.4):
            boxes = [footprint(vehicle, road, time_s) for vehicle in scene.vehicles]
            for first, other in itertools.combinations(boxes, 2):
                assert not do_overlap(first, other), (name, seed, time_s)


def footprint(vehicle: VehicleSpec, road: Road, time_s: float) -> np.ndarray:
    """Points over a vehicle's ground, in the world, shape (N, 2)."""
    body = BODIES[vehicle.kind]
    pose = vehicle_state(vehicle, road, (), body.wheelbase_m, time_s).pose
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9) * body.size_m[0], np.linspace(-0.5, 0.5, 3) * body.size_m[1])
    points = np.stack([x.ravel() + body.box_centre_m[0], y.ravel(), np.zeros(x.size)], -1)
    return np.asarray(pose.to_outer(points)[:, :2])


def do_overlap(first: np.ndarray, other: np.ndarray) -> bool:
    if np.linalg.norm(first[0] - other[0]) > 40.0:  # the longest has 16.5 m
        return False
    return bool((np.linalg.norm(first[:, None] - other, axis=-1) < 0.1).any())


@pytest.mark.parametrize("name", TRAFFIC)
def test_everybody_keeps_to_a_side_and_on_the_road(name: str) -> None:
    scene = drawn(name, 1)
    sign = 1 if name.startswith("left_") else -1
    road = Road(scene.road)
    for vehicle in scene.vehicles:
        if vehicle.lane in ("own", "oncoming"):
            _, t = road.places_m(footprint(vehicle, road, 0.5 * scene.duration_s))
            assert np.all(np.sign(t) == (sign if vehicle.lane == "own" else -sign))
            assert np.all(np.abs(t) < road.half_width_m + 0.3)


def test_who_would_touch_us_or_another_is_left_out() -> None:
    ego = EgoSpec(timetable=((0.0, 50.0), (10.0, 150.0)))
    ahead, slow = (VehicleSpec(lane="own", timetable=((0.0, s_m), (10.0, s_m + 100.0))) for s_m in (80.0, 83.0))
    stands = VehicleSpec(lane="own", timetable=((0.0, 120.0),))
    towards = VehicleSpec(lane="oncoming", timetable=((0.0, 300.0), (10.0, 100.0)))
    assert without_collisions((ahead, slow, stands, towards), ego, STRAIGHT, 10.0) == (ahead, towards)


def test_a_braking_vehicle_loses_speed_while_its_lamps_are_on() -> None:
    timetable = slowed(0.0, 20.0, 10.0, Braking(2.0, 5.0, 3.0))
    _, speeds = interpolated(timetable, [1.0, 6.0])
    assert speeds[0] == pytest.approx(20.0, abs=0.1)
    assert speeds[1] == pytest.approx(11.0, abs=0.2)


def test_brakes_come_on_in_the_scenes_that_say_so() -> None:
    braking = [vehicle for seed in range(6) for vehicle in drawn("following", seed).vehicles if vehicle.brakes_s]
    assert braking
    for vehicle in braking:
        begin, end = vehicle.brakes_s[0]
        _, speeds = interpolated(vehicle.timetable, [max(begin, 0.0) + 0.6, end - 0.1])
        assert speeds[1] < speeds[0]


@pytest.mark.parametrize("name", ["queue", "motorway", "town", "junction"])
def test_the_mirror_image_of_a_mirror_image_is_the_scene(name: str) -> None:
    scene = drawn(name, 2)
    assert mirrored(scene) != scene
    assert mirrored(mirrored(scene)) == scene


def test_left_hand_traffic_is_where_a_mirror_shows_it() -> None:
    scene, other = drawn("motorway", 3), drawn("left_motorway", 3)
    roads = Road(scene.road), Road(other.road)
    for before, after in zip(scene.vehicles, other.vehicles, strict=True):
        poses = [
            vehicle_state(vehicle, road, (), 2.7, 2.0).pose for vehicle, road in ((before, roads[0]), (after, roads[1]))
        ]
        np.testing.assert_allclose(poses[1].position_m, poses[0].position_m * [1, -1, 1], atol=1e-6)
        np.testing.assert_allclose(poses[1].rotation[:, 0], poses[0].rotation[:, 0] * [1, -1, 1], atol=1e-6)


@pytest.mark.slow
def test_half_of_the_standard_minutes_are_without_vehicles_light() -> None:
    with patch.object(planning, "MAX_PLANS", 1):
        scenes = draw_scenes(24, 3, "train", "standard")
    dark = [all(vehicle.beam == "off" for vehicle in scene.vehicles) for scene in scenes]
    assert sum(dark[1::2]) == 12
    assert sum(dark[::2]) < 4


def test_mixtures_are_of_known_scenarios_and_whole() -> None:
    for shares in MIXTURES.values():
        assert set(shares) <= set(SCENARIOS)
        assert sum(shares.values()) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="mixture: expected one of pvdn, standard, r48, got 'mine'"):
        draw_scenes(1, 1, "train", "mine")


def test_a_street_lamp_has_its_flux() -> None:
    table = street_lamp()
    assert intensity_cd(8000.0) * table.flux_lm == pytest.approx(8000.0, rel=1e-3)


def test_lanes_are_checked() -> None:
    with pytest.raises(ValueError, match=r"ego.lane_number: expected a lane below 2, got 2"):
        Scene(road=RoadSpec(num_lanes=2), ego=EgoSpec(lane_number=2))
    with pytest.raises(ValueError, match="median_m: expected at least 1 m"):
        RoadSpec(median="barrier")


def test_the_road_of_un_r48_shows_both_vehicles_at_the_ranges_that_it_asks_for() -> None:
    scene = scenario("r48", 4)
    road = Road(scene.road)
    assert scene.road.curvature_per_m == scene.road.elevation_m == ((0.0, 0.0),)
    ranges_m: dict[str, list[float]] = {"oncoming": [], "own": []}
    for time_s in np.arange(0.0, scene.duration_s, 0.5):
        ego_m, _ = interpolated(scene.ego.timetable, [time_s])
        for vehicle in scene.vehicles:
            s_m, _ = interpolated(vehicle.timetable, [time_s])
            assert 0.0 < s_m[0] < road.length_m
            ranges_m[vehicle.lane].append(float(s_m[0] - ego_m[0]))
    for oncoming_m, ahead_m in zip(ranges_m["oncoming"], ranges_m["own"], strict=True):
        if oncoming_m > 100.0:  # a lamp of the one that comes is seen past the side of a lorry ahead
            assert ahead_m / oncoming_m * (scene.road.lane_width_m + 0.5) > 1.3
    for lane, required_m in (("oncoming", 400.0), ("own", 100.0)):
        assert min(ranges_m[lane]) < 0.5 * required_m < 1.4 * required_m < max(ranges_m[lane])
