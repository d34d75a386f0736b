"""The ground: heights, covers, tight bends and junctions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.scene import Branch, RoadSpec
from foreglow.lab.simulation.scenes.surroundings import Verge
from foreglow.lab.simulation.world.road import Road, branch_road
from foreglow.lab.simulation.world.terrain import BRANCH_T_M
from tests.lab.simulation.small_scenes import BARE, BEND, drawn_terrain, face_normals, is_of, points_of

CROSSING = RoadSpec(
    length_m=100, elevation_m=((0, 0), (100, 5)), branches=(Branch(s_m=50, angle_deg=80), Branch(s_m=40, angle_deg=-90))
)


@pytest.mark.parametrize("curvature", [0.0, 0.045, -0.045])
def test_ground_never_folds_over(curvature: float) -> None:
    road = Road(RoadSpec(length_m=80, curvature_per_m=((5, 0), (15, curvature), (65, curvature), (75, 0))))
    mesh = drawn_terrain(road, Verge(bank_m=2), Verge(bank_m=-2)).mesh()
    assert np.all(face_normals(mesh)[:, 2] > 0)


def test_ground_of_a_hairpin_stays_on_its_own_side() -> None:
    # After half a turn of 25 m radius the two straights are 50 m apart, less than the ground is wide.
    road = Road(RoadSpec(length_m=170, curvature_per_m=((45, 0), (46, 0.04), (124, 0.04), (125, 0))))
    terrain = drawn_terrain(road)
    mesh = terrain.mesh()
    points, own = mesh.vertices_m.astype(np.float64), np.abs(mesh.coordinates_m[:, 1])
    assert np.all(road.distances_m(points) > own - 1.5)
    assert own.max() > 60  # outside the bend there is room
    assert not terrain.is_clear(20.0, 48.0)  # there the road comes back
    assert terrain.is_clear(20.0, 12.0)


def test_mesh_has_the_stated_height_and_coordinates() -> None:
    terrain = drawn_terrain(Road(BEND), Verge(bank_m=1.5), BARE)
    mesh = terrain.mesh()
    s, t = mesh.coordinates_m.T.astype(np.float64)
    assert np.allclose(terrain.road.points(s, t)[:, :2], mesh.vertices_m[:, :2], atol=0.02)
    near = np.abs(t) < 12  # further out, cells that are cut follow the triangles, not the formula
    assert np.allclose(terrain.ground_height_m(s, t)[near], mesh.vertices_m[near, 2], atol=0.06)


def test_carriageway_is_the_roads() -> None:
    terrain = drawn_terrain(Road(BEND), Verge(bank_m=4, ditch_m=1), Verge(bank_m=-5))
    s, t = np.meshgrid(np.linspace(0, 100, 40), np.linspace(-3.5, 3.5, 15))
    assert np.allclose(terrain.ground_height_m(s, t), terrain.road.points(s, t)[..., 2], atol=1e-9)


def test_banks_rise_and_fall_and_ditches_are_deep() -> None:
    road = Road(RoadSpec(length_m=100))
    terrain = drawn_terrain(road, Verge(bank_m=3, ditch_m=0.6), Verge(bank_m=-2, ditch_m=0))
    s = np.linspace(0, 100, 60)
    edge = float(road.points(0.0, 3.5)[2])
    assert np.mean(terrain.ground_height_m(s, 3.5 + 8)) - edge == pytest.approx(3, abs=0.5)
    assert np.mean(terrain.ground_height_m(s, -3.5 - 8)) - edge == pytest.approx(-2, abs=0.5)
    assert np.mean(terrain.ground_height_m(s, 3.5 + 1.25)) - edge == pytest.approx(-0.6, abs=0.15)


def test_pavement_has_a_kerb() -> None:
    terrain = drawn_terrain(Road(RoadSpec(length_m=60)), Verge(ground="pavement", bank_m=0, grass_height_m=0))
    rise = terrain.ground_height_m(30.0, 3.5 + 0.2) - terrain.ground_height_m(30.0, 3.5)
    assert 0.08 < rise < 0.16
    mesh = terrain.mesh()
    t = mesh.coordinates_m[mesh.faces[is_of(mesh, "pavement")]][..., 1]
    assert t.min() > 3.5
    assert t.max() < 3.5 + 3


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_snow_covers_its_share_of_the_verge(share: float) -> None:
    road = Road(RoadSpec(length_m=100))
    mesh = drawn_terrain(road, Verge(snow=share), BARE).mesh()
    middles = mesh.coordinates_m[mesh.faces].mean(1)
    near = (middles[:, 1] > 3.6) & (middles[:, 1] < 18) & (middles[:, 0] > 0) & (middles[:, 0] < 100)
    areas = np.linalg.norm(face_normals(mesh), axis=1)[near]
    assert np.sum(areas * is_of(mesh, "snow")[near]) / areas.sum() == pytest.approx(share, abs=0.06)
    assert not np.any(is_of(mesh, "snow") & (middles[:, 1] < 3.5))


def test_side_roads_join_without_a_step_or_a_bank() -> None:
    road = Road(CROSSING)
    branches = tuple(branch_road(road, number) for number in range(2))
    terrain = drawn_terrain(road, Verge(bank_m=3), Verge(bank_m=3), branches)
    for branch in branches:
        along = np.linspace(2.0, 60.0, 60)
        for across in (-2.5, 0.0, 2.5):
            heights = terrain.ground_height_m(*road.places_m(branch.points(along, across)))
            assert np.abs(np.diff(heights)).max() < 0.12
        far = branch.points(np.linspace(14, 50, 20), 1.75)
        assert np.allclose(terrain.ground_height_m(*road.places_m(far)), far[:, 2], atol=0.01)


def test_side_roads_surface_covers_the_ground_and_keeps_markings_off() -> None:
    road = Road(CROSSING)
    branch = branch_road(road, 0)
    mesh = drawn_terrain(road, Verge(bank_m=3), Verge(bank_m=3), (branch,)).mesh()
    is_own = mesh.coordinates_m[:, 1] > BRANCH_T_M / 2
    assert np.all(np.abs(mesh.coordinates_m[is_own, 1] - BRANCH_T_M) < 40)
    s, t = mesh.coordinates_m.T
    near = (t > 3.5) & (t < 60) & (s > 20) & (s < 80)
    below, above = mesh.vertices_m[near], mesh.vertices_m[is_own]
    along, across = branch.places_m(below)
    inside = (along > 8) & (along < 60) & (np.abs(across) < branch.half_width_m - 0.5)
    surface = branch.points(along[inside], across[inside])[:, 2]
    assert np.all(below[inside, 2] < surface)
    along, across = branch.places_m(above)
    inside = (along > 14) & (along < 45) & (np.abs(across) < branch.half_width_m - 0.2)
    assert np.allclose(above[inside, 2], branch.points(along[inside], across[inside])[:, 2], atol=0.06)


def test_nothing_may_stand_on_a_carriageway() -> None:
    road = Road(CROSSING)
    branch = branch_road(road, 0)
    terrain = drawn_terrain(road, branches=(branch,))
    assert not terrain.is_clear(30.0, 2.0)
    assert not terrain.is_clear(30.0, 3.8, margin_m=0.5)
    assert terrain.is_clear(30.0, 5.0)
    on_side_road = road.places_m(branch.points(20.0, 2.0))
    assert not terrain.is_clear(*on_side_road)
    assert terrain.is_clear(*road.places_m(branch.points(30.0, 6.0)))


def test_rows_reach_beyond_both_ends() -> None:
    points = points_of(drawn_terrain(Road(RoadSpec(length_m=60))).mesh(), "road")
    rows = np.unique(points[:, 0].round(3))
    assert rows[0] <= -50
    assert rows[-1] >= 110
    assert max(after - before for before, after in pairwise(rows)) <= 2.01
