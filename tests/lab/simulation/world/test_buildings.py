"""Houses with their windows, and street lamps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.lab.simulation.scenes.surroundings import House, Side, StreetLamp, Verge
from foreglow.lab.simulation.world.buildings import (
    FOUNDATION_M,
    WINDOW_SIZE_M,
    build_houses,
    build_street_lamps,
)
from foreglow.lab.simulation.world.furniture import FixedLight
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.world.terrain import Terrain
from tests.lab.simulation.small_scenes import BEND, drawn_terrain, points_of

SIDES: tuple[tuple[Side, float], ...] = (("left", 1.0), ("right", -1.0))


def ground() -> Terrain:
    return drawn_terrain(Road(BEND), Verge(bank_m=1), Verge(bank_m=-1))


def built(**fields: Any) -> tuple[Mesh, list[FixedLight]]:
    meshes, lights = build_houses((House(**{"side": "left", "s_m": 50, **fields}),), ground(), np.random.default_rng(2))
    return joined(meshes), lights


@pytest.mark.parametrize(("side", "sign"), SIDES)
def test_house_stands_at_its_offset_with_its_size(side: Side, sign: float) -> None:
    mesh, _ = built(side=side, offset_m=6.0, size_m=(12.0, 8.0, 5.0))
    road = ground().road
    walls = points_of(mesh, "plaster", "brick")
    s, t = road.places_m(walls)
    assert (sign * t - 3.5).min() == pytest.approx(6.0, abs=0.5)  # the road bends along the front
    foot = float(ground().ground_height_m(50.0, sign * 9.5))
    assert walls[:, 2].min() == pytest.approx(foot - FOUNDATION_M, abs=1e-3)
    assert points_of(mesh, "roof")[:, 2].max() > foot + 5.0 + 2.5
    assert abs(float(np.mean([s.min(), s.max()])) - 50) < 1


@pytest.mark.parametrize("num", [0, 1, 3, 8])
def test_as_many_windows_shine_as_asked(num: int) -> None:
    _, lights = built(num_lit_windows=num, window_cd_m2=40.0)
    assert len(lights) == num
    for light in lights:
        assert light.kind == "window"
        assert light.size_m == WINDOW_SIZE_M
        assert light.intensity_cd == pytest.approx(40.0 * WINDOW_SIZE_M[0] * WINDOW_SIZE_M[1])
    assert built(num_lit_windows=num, window_cd_m2=0)[1] == []


def test_windows_shine_out_of_the_wall_just_before_their_panes() -> None:
    mesh, lights = built(num_lit_windows=8)
    panes = points_of(mesh, "window")
    middle = mesh.vertices_m.mean(0)
    for light in lights:
        distances = np.linalg.norm(panes - light.pose.position_m, axis=1)
        beside = panes[distances < 0.9]
        assert len(beside) >= 8
        in_front = light.pose.to_body(beside)
        assert in_front[:, 0].max() < 0
        assert np.allclose(in_front.mean(0), [-0.05, 0, 0], atol=0.01)
        assert np.dot(light.pose.rotation[:, 0], light.pose.position_m - middle) > 0


@pytest.mark.parametrize(("side", "sign"), SIDES)
def test_street_lamp_shines_down_beside_the_road(side: Side, sign: float) -> None:
    terrain = ground()
    lamp = StreetLamp(side=side, s_m=40, offset_m=1.5, height_m=6, intensity_cd=700)
    meshes, (light,) = build_street_lamps((lamp,), terrain)
    assert light.kind == "street_lamp"
    assert light.intensity_cd == 700
    assert np.allclose(light.pose.rotation[:, 0], [0, 0, -1], atol=1e-9)
    foot = float(terrain.ground_height_m(40.0, sign * 5.0))
    assert light.pose.position_m[2] == pytest.approx(foot + 6)
    _, t = terrain.road.places_m(light.pose.position_m)
    assert sign * t == pytest.approx(5.0 - 1.2, abs=0.1)  # the arm reaches to the road
    points = points_of(joined(meshes), "pole")
    assert points[:, 2].min() < foot
    over = np.linalg.norm(points[:, :2] - light.pose.position_m[:2], axis=1) < 0.3
    assert points[over, 2].min() > light.pose.position_m[2]


def test_a_lamp_that_is_out_keeps_its_pole() -> None:
    meshes, lights = build_street_lamps((StreetLamp(side="left", s_m=40, intensity_cd=0),), ground())
    assert len(meshes) == 1
    assert lights == []
