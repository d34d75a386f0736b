"""Medians, lanes' markings, screens and traffic lights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene
from foreglow.lab.simulation.scenes.surroundings import (
    Bridge,
    Gantry,
    House,
    Panel,
    Settlement,
    Side,
    Sign,
    Signal,
    StreetLamp,
)
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.road import has_several_lanes, lane_lines
from foreglow.lab.simulation.world.world import World, build_world
from tests.lab.simulation.small_scenes import is_of, points_of, small_scene

MOTORWAY = RoadSpec(length_m=100, num_lanes=2, median="barrier", median_m=2.0, shoulders_m=(0.8, 2.0))
STRAIGHT = RoadSpec(length_m=100)


def world_of(road: RoadSpec = STRAIGHT, **surroundings: Any) -> World:
    return build_world(small_scene(road, **surroundings))


def test_a_two_lane_road_has_its_old_measures() -> None:
    road = RoadSpec(lane_width_m=3.1)
    assert (road.half_width_m, road.lane_m()) == (3.1, 1.55)
    assert not has_several_lanes(road)


def test_lanes_lie_between_their_lines() -> None:
    offsets = [line.offset_m for line in lane_lines(MOTORWAY)]
    assert len(offsets) == 3
    assert offsets[0] < MOTORWAY.lane_m(0) < offsets[1] < MOTORWAY.lane_m(1) < offsets[2] < MOTORWAY.half_width_m
    assert np.mean([MOTORWAY.lane_m(0), MOTORWAY.lane_m(1)]) == pytest.approx(offsets[1])


def test_edge_lines_are_drawn_only_where_there_are_any() -> None:
    bare = MOTORWAY.model_copy(update={"has_edge_marking": False})
    assert len(lane_lines(bare)) == 2


def test_a_barrier_stands_on_the_middle_of_the_road() -> None:
    world = world_of(MOTORWAY)
    s, t = world.road.places_m(points_of(world.mesh, "concrete"))
    heights = points_of(world.mesh, "concrete")[:, 2] - world.road.elevation_m(s)
    assert np.abs(t).max() < 0.35
    assert heights.max() == pytest.approx(0.9, abs=0.03)
    assert s.min() < 1.0
    assert s.max() > 99.0


def test_a_barrier_is_as_high_as_it_says() -> None:
    world = world_of(MOTORWAY.model_copy(update={"barrier_m": 1.15}))
    points = points_of(world.mesh, "concrete")
    s, _ = world.road.places_m(points)
    assert (points[:, 2] - world.road.elevation_m(s)).max() == pytest.approx(1.15, abs=0.03)


def test_edge_lines_have_their_width() -> None:
    narrow = lane_lines(MOTORWAY.model_copy(update={"edge_line_m": 0.15}))
    assert [line.width_m for line in narrow] == [0.15, 0.15, 0.15]
    assert lane_lines(MOTORWAY)[0].width_m == 0.3


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_gantry_spans_its_side_and_faces_its_traffic(side: Side) -> None:
    gantry = Gantry(side=side, s_m=50.0, height_m=5.5, signs_m=(2.0, 2.5))
    world = world_of(MOTORWAY, gantries=(gantry,))
    faces = is_of(world.mesh, "sign_colour")
    points = points_of(world.mesh, "sign_colour")
    s, t = world.road.places_m(points)
    outwards = 1.0 if side == "left" else -1.0
    assert (outwards * t > 0.3).all()
    assert (outwards * t < world.road.half_width_m).all()
    assert np.abs(s - 50.0).max() < 0.1
    assert points[:, 2].min() - float(world.road.elevation_m(50.0)) == pytest.approx(5.5, abs=0.01)
    normals = world.mesh.normals[world.mesh.faces[faces].ravel()]
    assert (normals[:, 0] * (1.0 if side == "left" else -1.0) > 0.9).all()
    assert is_of(world.mesh, "sign_white").sum() > 20  # words


def test_a_bridge_leaves_the_road_free() -> None:
    world = world_of(MOTORWAY.model_copy(update={"median": "none"}), bridges=(Bridge(s_m=60.0, width_m=8.0),))
    points = points_of(world.mesh, "concrete")
    s, t = world.road.places_m(points)
    heights = points[:, 2] - world.road.elevation_m(s)
    is_low = heights < 5.0
    assert np.abs(s - 60.0).max() < 4.2
    assert (np.abs(t[is_low]) > world.road.half_width_m).sum() > 0
    inside = is_low & (np.abs(t) < world.road.half_width_m)
    assert np.abs(t[inside]).max(initial=0.0) < 0.5  # columns in the median


def test_guide_signs_have_words_of_different_lengths() -> None:
    world = world_of(MOTORWAY, signs=(Sign(side="right", s_m=50.0, kind="guide", size_m=3.0),))
    assert is_of(world.mesh, "sign_white").sum() > 20
    assert is_of(world.mesh, "sign_colour").any()


def test_rails_in_the_middle_face_both_ways_on_grass() -> None:
    road = MOTORWAY.model_copy(update={"median": "rails", "median_m": 3.0})
    world = world_of(road)
    _, t = world.road.places_m(points_of(world.mesh, "rail"))
    assert t.min() == pytest.approx(-t.max(), abs=0.05)
    assert np.abs(t).max() < road.median_m / 2
    grass = points_of(world.mesh, "grass_ground")
    _, t = world.road.places_m(grass[np.abs(grass[:, 1]) < 10])
    assert (np.abs(t) < 1.5).any()
    assert not is_of(world_of(MOTORWAY).mesh, "concrete").all()


def test_a_screen_is_as_bright_as_it_says_and_lights_what_is_before_it() -> None:
    panel = Panel(side="right", s_m=50, size_m=(3.0, 2.0), screen_cd_m2=200, offset_m=2.0, height_m=2.5)
    world = world_of(panels=[panel])
    is_screen = world.mesh.materials == material_number("screen")
    vertices = np.unique(world.mesh.faces[is_screen])
    assert np.all(world.mesh.coordinates_m[vertices, 0] == 200)
    _, t = world.road.places_m(world.mesh.vertices_m[vertices])
    assert t.max() < -world.road.half_width_m - 1.9  # not over the road
    (light,) = world.lights
    assert light.kind == "screen"
    assert light.intensity_cd == pytest.approx(200 * 3.0 * 2.0)
    assert light.pose.rotation[0, 0] == pytest.approx(-1)  # at us, who drive along x


def test_a_dark_panel_is_no_light() -> None:
    world = world_of(panels=[Panel(side="left", s_m=50, screen_cd_m2=0)])
    assert not world.lights
    assert not is_of(world.mesh, "screen").any()


@pytest.mark.parametrize("faces_oncoming", [False, True])
def test_a_traffic_light_shows_its_lens_to_its_readers_above_the_lane(faces_oncoming: bool) -> None:
    signal = Signal(side="right", s_m=50, arm_m=3.0, height_m=4.8, lit="red", faces_oncoming=faces_oncoming)
    world = world_of(signals=[signal])
    (light,) = world.lights
    assert light.intensity_cd == 200
    assert light.pose.rotation[0, 0] == pytest.approx(1 if faces_oncoming else -1)
    x, y, z = light.pose.position_m
    assert y == pytest.approx(-3.5 - 0.8 + 3.0, abs=0.01)
    assert x == pytest.approx(50, abs=0.3)
    assert 5.3 < z < 5.8
    green = world_of(signals=[signal.model_copy(update={"lit": "green"})]).lights[0]
    assert green.pose.position_m[2] < z


def test_shops_shine_out_of_the_ground_floor() -> None:
    house = House(side="left", s_m=50, size_m=(12, 8, 6), num_lit_windows=0, shop_cd_m2=150)
    world = world_of(houses=[house])
    shops = points_of(world.mesh, "screen")
    assert len(world.lights) == 2
    ground_m = float(world.ground_height_m(50.0, 11.0))
    assert 0.2 < shops[:, 2].min() - ground_m < shops[:, 2].max() - ground_m < 3.0


def test_lit_panes_replace_points_of_light() -> None:
    house = House(side="left", s_m=50, num_lit_windows=3)
    assert len(world_of(houses=[house]).lights) == 3
    detailed = world_of(houses=[house.model_copy(update={"has_panes": True})])
    assert not detailed.lights
    assert is_of(detailed.mesh, "screen").sum() == 6


def test_high_lamps_reach_further() -> None:
    lamps = [StreetLamp(side="right", s_m=s_m, height_m=height) for s_m, height in ((30, 6.0), (60, 12.0))]
    assert [light.reach_m for light in world_of(street_lamps=lamps).lights] == [120.0, 180.0]


def test_the_world_of_a_scene_without_any_of_these_has_none() -> None:
    assert not is_of(build_world(Scene(duration_s=1, road=STRAIGHT)).mesh, "screen", "concrete").any()


def test_a_settlement_is_lamps_in_the_distance_and_nothing_else() -> None:
    place = Settlement(side="left", s_m=900.0, offset_m=100.0, size_m=(200.0, 120.0), height_m=30.0, num_lamps=40)
    road = RoadSpec(length_m=100, curvature_per_m=((0, 0.0), (50, 0.01), (100, 0.01)))
    world = world_of(road, settlements=[place])
    assert len(world.lights) == 40
    assert len(world.mesh.faces) == len(world_of(road).mesh.faces)
    heading = float(world.road.heading_rad(road.length_m))
    away = np.array([light.pose.position_m for light in world.lights]) - world.road.points(road.length_m)
    ahead = away[:, 0] * np.cos(heading) + away[:, 1] * np.sin(heading)
    to_left = away[:, 1] * np.cos(heading) - away[:, 0] * np.sin(heading)
    assert 700.0 < ahead.min() < ahead.max() < 900.0
    assert 40.0 < to_left.min() < to_left.max() < 170.0
    assert 4.0 < away[:, 2].min() < away[:, 2].max() < 40.0
    assert {light.kind for light in world.lights} == {"far_lamp"}
