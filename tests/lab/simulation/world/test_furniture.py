"""Rails, walls, delineators and signs."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.scene import Branch, RoadSpec
from foreglow.lab.simulation.scenes.surroundings import Rail, Side, Sign, SignKind, SurroundingsSpec, Verge, Wall
from foreglow.lab.simulation.world.furniture import BURIED_M, build_furniture, clear_spans
from foreglow.lab.simulation.world.mesh import joined
from foreglow.lab.simulation.world.road import Road, branch_road
from foreglow.lab.simulation.world.signs import ASPECTS, build_signs, sign_mesh
from foreglow.lab.simulation.world.terrain import Terrain
from tests.lab.simulation.small_scenes import BEND, drawn_terrain, points_of

SIDES: tuple[tuple[Side, float], ...] = (("left", 1.0), ("right", -1.0))


def rng() -> np.random.Generator:
    return np.random.default_rng(8)


def terrain(spec: RoadSpec = BEND) -> Terrain:
    road = Road(spec)
    branches = tuple(branch_road(road, number) for number in range(len(spec.branches)))
    return drawn_terrain(road, Verge(bank_m=1.5), Verge(bank_m=-1), branches)


@pytest.mark.parametrize(("side", "sign"), SIDES)
def test_rail_follows_the_bend_at_its_offset_and_height(side: Side, sign: float) -> None:
    ground = terrain()
    spec = SurroundingsSpec(rails=(Rail(side=side, span_m=(10, 90), offset_m=0.9),), delineator_spacing_m=0)
    beam = points_of(joined(build_furniture(spec, ground, rng())), "rail")
    s, t = ground.road.places_m(beam)
    out = sign * t - ground.road.half_width_m
    assert out.min() == pytest.approx(0.9, abs=0.03)
    assert out.max() == pytest.approx(0.98, abs=0.03)
    middle = (s > 25) & (s < 75)
    above = beam[middle, 2] - ground.road.points(s[middle], sign * ground.road.half_width_m)[:, 2]
    assert above.max() == pytest.approx(0.75, abs=0.03)
    assert above.min() == pytest.approx(0.44, abs=0.03)
    assert s.min() == pytest.approx(10, abs=0.1)
    assert s.max() == pytest.approx(90, abs=0.1)


def test_rail_ends_in_the_ground() -> None:
    ground = terrain()
    spec = SurroundingsSpec(rails=(Rail(side="right", span_m=(10, 90)),), delineator_spacing_m=0)
    beam = points_of(joined(build_furniture(spec, ground, rng())), "rail")
    s, t = ground.road.places_m(beam)
    ends = (s < 10.2) | (s > 89.8)
    assert ends.sum() >= 20
    assert np.all(beam[ends, 2] < ground.ground_height_m(s[ends], t[ends]))


def test_rail_faces_the_road() -> None:
    ground = terrain(RoadSpec(length_m=60))
    for side, sign in SIDES:
        spec = SurroundingsSpec(rails=(Rail(side=side, span_m=(0, 60)),), delineator_spacing_m=0)
        beam = points_of(joined(build_furniture(spec, ground, rng())), "rail")
        middle = beam[np.abs(beam[:, 0] - 30) < 0.3]
        crest = middle[np.argmax(sign * middle[:, 1])]
        # Both bulges stand before the groove between them.
        assert 0.55 < crest[2] - ground.road.points(30.0, sign * 3.5)[2] < 0.65


@pytest.mark.parametrize("spacing_m", [2.0, 4.0])
def test_posts_reach_from_the_ground_to_the_beam(spacing_m: float) -> None:
    ground = terrain()
    rail = Rail(side="right", span_m=(0, 100), post_spacing_m=spacing_m)
    mesh = joined(build_furniture(SurroundingsSpec(rails=(rail,), delineator_spacing_m=0), ground, rng()))
    posts = points_of(mesh, "metal_post")
    s, t = ground.road.places_m(posts)
    above = posts[:, 2] - ground.ground_height_m(s, t)
    feet = above < 0
    assert feet.mean() == pytest.approx(0.5)
    assert np.allclose(above[feet], -BURIED_M, atol=0.06)
    tops = posts[~feet, 2] - ground.road.points(s[~feet], -3.5)[:, 2]
    assert np.all(tops < 0.75)
    starts = np.unique((s / spacing_m).round(1))
    assert 0.8 * 100 / spacing_m < len(np.unique(np.floor(starts))) <= 100 / spacing_m


def test_rails_and_walls_leave_the_mouth_of_a_side_road_open() -> None:
    ground = terrain(RoadSpec(length_m=100, branches=(Branch(s_m=50, angle_deg=90),)))
    spans = clear_spans(ground, (0, 100), 4.3)
    assert len(spans) == 2
    assert spans[0][1] < 50 - 3.5 < 50 + 3.5 < spans[1][0]
    assert clear_spans(ground, (0, 100), -4.3) == [(0, 100)]
    spec = SurroundingsSpec(
        rails=(Rail(side="left", span_m=(0, 100)),), walls=(Wall(side="left", span_m=(0, 100), offset_m=3),)
    )
    _, across = ground.branches[0].places_m(joined(build_furniture(spec, ground, rng())).vertices_m)
    assert np.abs(across).min() > ground.branches[0].half_width_m


def test_what_lies_beyond_the_road_is_left_out() -> None:
    assert clear_spans(terrain(), (150, 200), 4.3) == []
    assert clear_spans(terrain(), (-50, 200), 4.3) == [(0, 100)]


@pytest.mark.parametrize("material", ["concrete", "brick", "plaster", "rock"])
def test_walls_stand_on_the_ground_at_their_height_and_offset(material: str) -> None:
    ground = terrain()
    wall = Wall(side="left", span_m=(20, 80), offset_m=3.0, height_m=1.5, material=material)  # type: ignore[arg-type]
    mesh = joined(build_furniture(SurroundingsSpec(walls=(wall,), delineator_spacing_m=0), ground, rng()))
    points = points_of(mesh, material)
    s, t = ground.road.places_m(points)
    roughness = 0.6 if material == "rock" else 0.02
    assert (t - 3.5).min() == pytest.approx(3.0, abs=roughness)
    front = (t - 3.5 < 3.0 + roughness) & (s > 30) & (s < 70)
    above = points[front, 2] - ground.ground_height_m(s[front], np.full(front.sum(), 6.5))
    assert above.min() < -0.2
    assert np.median(above[above > 0.9]) == pytest.approx(1.5, abs=0.4)


def test_delineators_stand_on_both_sides_at_their_spacing() -> None:
    ground = terrain(RoadSpec(length_m=100))
    spec = SurroundingsSpec(delineator_spacing_m=25)
    points = points_of(joined(build_furniture(spec, ground, rng())), "post", "reflector", "sign_black")
    s, t = ground.road.places_m(points)
    for sign in (1, -1):
        own = sign * t > 0
        assert np.allclose(np.abs(t[own]), 4.0, atol=0.15)
        posts = np.unique((s[own] / 25).round(1))
        assert len(posts) == 4
    above = points[:, 2] - ground.road.points(s, np.sign(t) * 3.5)[:, 2]
    assert above.max() == pytest.approx(1.0, abs=0.1)
    assert np.all(points[:, 2].min() < ground.ground_height_m(s, t))


def test_a_driver_sees_one_reflector_on_the_right_and_two_on_the_left() -> None:
    ground = terrain(RoadSpec(length_m=60))
    spec = SurroundingsSpec(delineator_spacing_m=40)
    mesh = joined(build_furniture(spec, ground, np.random.default_rng(0)))
    plates = points_of(mesh, "reflector")
    black = points_of(mesh, "sign_black")
    for sign, num in ((1, 2), (-1, 1)):
        own = plates[sign * plates[:, 1] > 0]
        post = black[sign * black[:, 1] > 0]
        facing_us = own[own[:, 0] < np.median(post[:, 0])]
        gaps = np.diff(np.sort(facing_us[:, 2])) > 0.02
        heights = np.ptp(facing_us[:, 2])
        assert heights == pytest.approx(0.16 if num == 2 else 0.18, abs=0.02)
        assert gaps.sum() == (3 if num == 2 else 1)


def test_delineators_stand_behind_a_rail() -> None:
    ground = terrain(RoadSpec(length_m=100))
    spec = SurroundingsSpec(delineator_spacing_m=20, rails=(Rail(side="right", span_m=(0, 100), offset_m=0.8),))
    _, t = ground.road.places_m(points_of(joined(build_furniture(spec, ground, rng())), "reflector"))
    assert np.all(-t[t < 0] - 3.5 > 0.9)
    assert np.all(t[t > 0] - 3.5 < 0.7)


@pytest.mark.parametrize("kind", get_args(SignKind))
def test_sign_has_its_size_faces_its_reader_and_shows_its_back(kind: str) -> None:
    sign = Sign(side="right", s_m=10, kind=kind, size_m=0.8, height_m=1.5)  # type: ignore[arg-type]
    mesh = sign_mesh(sign)
    face = points_of(mesh, "sign_white", "sign_colour", "sign_dark", "sign_black")
    back = points_of(mesh, "sign_back")
    assert face[:, 0].min() > back[:, 0].max()
    assert np.ptp(face[:, 1]) == pytest.approx(0.8, abs=1e-4)
    assert np.ptp(face[:, 2]) == pytest.approx(0.8 * ASPECTS[sign.kind], abs=1e-3)
    assert face[:, 2].min() == pytest.approx(1.5, abs=1e-4)
    assert mesh.vertices_m[:, 2].min() == pytest.approx(-BURIED_M)


def test_chevrons_point_where_their_names_say() -> None:
    for kind, side in (("chevron_left", -1), ("chevron_right", 1)):
        arrow = points_of(sign_mesh(Sign(side="left", s_m=0, kind=kind)), "sign_dark")  # type: ignore[arg-type]
        tip = arrow[np.abs(arrow[:, 2] - arrow[:, 2].mean()) < 0.01]
        ends = arrow[arrow[:, 2] > arrow[:, 2].max() - 0.01]
        # The reader's right is the sign's y.
        assert np.sign(tip[:, 1].mean() - ends[:, 1].mean()) == side


@pytest.mark.parametrize("faces_oncoming", [False, True])
def test_signs_stand_beside_the_road_and_face_traffic(faces_oncoming: bool) -> None:
    ground = terrain()
    sign = Sign(side="right", s_m=60, kind="rectangle", faces_oncoming=faces_oncoming)
    (mesh,) = build_signs((sign,), ground, rng())
    face, back = points_of(mesh, "sign_white").mean(0), points_of(mesh, "sign_back").mean(0)
    heading = ground.road.heading_rad(60.0)
    towards = np.dot((face - back)[:2], [np.cos(heading), np.sin(heading)])
    assert np.sign(towards) == (1 if faces_oncoming else -1)
    s, t = ground.road.places_m(mesh.vertices_m)
    assert np.all(-t - 3.5 > 1.1)
    assert np.allclose(s, 60, atol=0.4)
    low = mesh.vertices_m[:, 2].argmin()
    assert mesh.vertices_m[low, 2] < ground.ground_height_m(s[low], t[low])


def test_spans_that_go_back_are_refused() -> None:
    with pytest.raises(ValueError, match="span_m"):
        Rail(side="left", span_m=(50, 20))
