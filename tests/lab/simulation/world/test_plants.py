"""Woods, bushes and grass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.scene import Branch, RoadSpec
from foreglow.lab.simulation.scenes.surroundings import SurroundingsSpec, Verge, Woods
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.plants import (
    BUSH_DETAILS,
    MAX_BLADES,
    MAX_TREE_FACES,
    TREE_DETAILS,
    build_plants,
    bush,
    tree,
)
from foreglow.lab.simulation.world.road import Road, branch_road
from foreglow.lab.simulation.world.terrain import Terrain
from tests.lab.simulation.small_scenes import BARE, drawn_terrain, is_of, points_of

ROAD = RoadSpec(length_m=80, curvature_per_m=((20, 0), (30, 0.02)), branches=(Branch(s_m=40, angle_deg=-90),))


def ground() -> Terrain:
    road = Road(ROAD)
    return drawn_terrain(road, Verge(bank_m=2), Verge(bank_m=-2), (branch_road(road, 0),))


def grown(seed: int = 4, **surroundings: Any) -> Mesh:
    spec = SurroundingsSpec(**{"left": BARE, "right": BARE, **surroundings})
    return joined(build_plants(spec, ground(), np.random.default_rng(seed), (0, 80), (0, 80)))


def wood(**fields: Any) -> Woods:
    return Woods(**{"side": "right", "span_m": (0, 80), "depth_m": 8, "has_undergrowth": False, **fields})


def num_plants(mesh: Mesh) -> int:
    """Plants apart: places with bark below the ground."""
    terrain = ground()
    points = points_of(mesh, "bark")
    s, t = terrain.road.places_m(points)
    roots = points[points[:, 2] < terrain.ground_height_m(s, t) - 0.3]
    return len(np.unique((roots[:, :2] / 0.8).round(), axis=0))


def test_no_plants_where_none_are_asked_for() -> None:
    assert len(grown().faces) == 0


def test_same_seed_same_plants_and_another_seed_others() -> None:
    first, again, other = (grown(seed, woods=(wood(),)) for seed in (1, 1, 2))
    assert np.array_equal(first.vertices_m, again.vertices_m)
    assert first.vertices_m.shape != other.vertices_m.shape or not np.array_equal(first.vertices_m, other.vertices_m)


def test_denser_woods_have_more_trees() -> None:
    sparse, dense = (num_plants(grown(woods=(wood(spacing_m=spacing),))) for spacing in (8.0, 4.0))
    assert 5 < sparse < dense


def test_leaves_grow_with_their_share_and_bare_trees_have_none() -> None:
    counts = [is_of(grown(woods=(wood(leaves=share),)), "leaf").sum() for share in (0.0, 0.3, 1.0)]
    assert counts[0] == 0
    assert 0 < 2 * counts[1] < counts[2]


def test_rows_of_trees_stand_at_their_offset() -> None:
    mesh = grown(woods=(wood(side="left", depth_m=0, spacing_m=10, offset_m=4, leaves=0),))
    terrain, points = ground(), points_of(mesh, "bark")
    s, t = terrain.road.places_m(points)
    roots = points[:, 2] < terrain.ground_height_m(s, t) - 0.3
    assert roots.sum() > 30
    assert np.all(np.abs(t[roots] - (3.5 + 4)) < 2)
    assert 5 <= len(np.unique((s[roots] / 10).round())) <= 9


@pytest.mark.slow
def test_plants_keep_off_every_carriageway_and_touch_the_ground() -> None:
    terrain = ground()
    mesh = grown(woods=(wood(has_undergrowth=True, offset_m=1.5, span_m=(20, 60)),), num_bushes=15)
    points = points_of(mesh, "bark")
    s, t = terrain.road.places_m(points)
    above = points[:, 2] - terrain.ground_height_m(s, t)
    feet = np.abs(above) < 0.3
    assert np.abs(t[feet]).min() > 3.5
    along, across = terrain.branches[0].places_m(points[feet])
    assert np.abs(across[(along > 8) & (along < 60)]).min() > 3.5
    assert above.min() > -2.5


def test_grass_grows_with_its_density_and_height() -> None:
    def blades(**verge: Any) -> Mesh:
        return grown(left=Verge(**verge))

    few, many = blades(grass_per_m2=5), blades(grass_per_m2=20)
    assert len(many.faces) == pytest.approx(4 * len(few.faces), rel=0.1)
    assert set(np.unique(many.materials)) == {np.unique(few.materials)[0]}
    low, high = (np.ptp(blades(grass_height_m=height).vertices_m[:300], axis=0)[2] for height in (0.05, 0.5))
    assert low < high
    assert len(blades(grass_height_m=0).faces) == len(blades(grass_per_m2=0).faces) == 0
    assert len(blades(snow=1.0).faces) < 0.3 * len(blades().faces)


def test_grass_stands_on_the_verge_near_the_road() -> None:
    terrain = ground()
    mesh = grown(right=Verge(bank_m=-2, grass_per_m2=30))
    feet = mesh.vertices_m.reshape(-1, 5, 3)[:, :2].mean(1).astype(np.float64)
    s, t = terrain.road.places_m(feet)
    assert np.all(t < -3.5)
    assert np.median(-t - 3.5) < 4
    assert np.allclose(feet[:, 2], terrain.ground_height_m(s, t) - 0.02, atol=0.02)


@pytest.mark.slow
def test_budgets_hold_and_the_nearest_trees_are_the_finest() -> None:
    mesh = grown(
        woods=(wood(spacing_m=1.7, depth_m=30, leaves=1.0),), left=Verge(grass_per_m2=5000, grass_height_m=0.1)
    )
    is_grass = is_of(mesh, "grass_blade")
    assert 0.3 * MAX_TREE_FACES < np.sum(~is_grass) <= MAX_TREE_FACES
    assert 0.6 * 1.5 * MAX_BLADES < is_grass.sum() <= 1.5 * MAX_BLADES
    corners = mesh.vertices_m[mesh.faces[is_of(mesh, "leaf")]].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    away = ground().road.distances_m(corners.mean(1))
    assert np.median(areas[away < 12]) < np.median(areas[away > 24])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_prototypes_have_their_height_and_unit_normals(level: int) -> None:
    rng = np.random.default_rng(0)
    plant, shrub = tree(rng, 12.0, 1.0, TREE_DETAILS[level]), bush(rng, 1.5, 1.0, BUSH_DETAILS[level])
    assert 10 < plant.vertices_m[:, 2].max() < 18
    assert 0.9 < shrub.vertices_m[:, 2].max() < 3.2
    for mesh in (plant, shrub):
        assert mesh.vertices_m[:, 2].min() < -0.05
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
    if level:
        assert len(plant.faces) < 0.5 * len(tree(rng, 12.0, 1.0, TREE_DETAILS[level - 1]).faces)
