"""Textures, markings, water and snow, seen from straight above or face on, in even light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.simulation.light.render import Renderer
from foreglow.lab.simulation.scenes.scene import RoadSpec, WeatherSpec
from foreglow.lab.simulation.world.mesh import Mesh
from tests.lab.simulation.light import rendering as small

pytestmark = pytest.mark.renderer

DOWN = small.looking([0.0, 0.0, 30.0], pitch_deg=-90)  # the picture's top is +x, its left is +y
SKY = WeatherSpec(scattering_per_m=0.0, sky_cd_m2=1.0)
CAMERA = small.camera(320, 240)
M_PER_PX = 30.0 / CAMERA.focal_px[0]


def albedos(static: Mesh, seed: int = 7, **road: Any) -> Floats:
    """What the sky's even light shows of the ground from above, shape (240, 320)."""
    world = Renderer(static, {}, CAMERA, small.PLAIN, road=RoadSpec(**road), seed=seed)
    return np.asarray(world.render(DOWN, [], 1, [], SKY).ambient_cd_m2, np.float64)


def offsets_m() -> Floats:
    """Offset to the left of every column, metres."""
    return np.asarray((159.5 - np.arange(320)) * M_PER_PX, np.float64)


def test_lines_are_where_they_belong() -> None:
    road = albedos(small.ground("road"), wear=0.0, centre_marking="solid")
    t = offsets_m()
    line = road.mean(0)
    bare = np.median(line)
    for middle in (-3.3, 0.0, 3.3):  # a lane is 3.5 m; edge lines keep 0.2 m from the edge
        near = np.abs(t - middle) < 0.3
        # Lines are about as wide as a pixel: what they add over their width is the marking's share.
        added = (line[near] - bare).sum() * M_PER_PX / (0.45 - bare)
        assert added == pytest.approx(0.12, rel=0.15)
    far = (np.abs(np.abs(t) - 3.3) > 0.3) & (np.abs(t) > 0.3)
    assert line[far].max() < 1.3 * bare


def test_dashes() -> None:
    road = albedos(small.ground("road"), wear=0.0, has_edge_marking=False)
    middle = road[:, 158:162].mean(1)
    is_paint = middle > 1.5 * np.median(road)
    s = (119.5 - np.arange(240)) * M_PER_PX
    assert np.all(is_paint[(s % 12 > 0.3) & (s % 12 < 3.7)])
    assert not np.any(is_paint[(s % 12 > 4.3) & (s % 12 < 11.7)])
    without = albedos(small.ground("road"), centre_marking="none", has_edge_marking=False, wear=0.0)
    assert without.max() < 1.5 * np.median(without)


def test_side_roads_have_no_lines() -> None:
    ground = small.ground("road")
    shifted = ground.coordinates_m + np.array([0.0, 1000.0], np.float32)
    side = Mesh(ground.vertices_m, ground.faces, ground.materials, ground.normals, shifted)
    seen = albedos(side, wear=0.0)
    assert seen.max() < 1.5 * np.median(seen)


def test_wear_fades_lines() -> None:
    new, old = (albedos(small.ground("road"), wear=wear, centre_marking="solid") for wear in (0.0, 1.0))
    edge = np.abs(np.abs(offsets_m()) - 3.3) < 0.1
    assert old[:, edge].mean() < 0.7 * new[:, edge].mean()


def test_water_darkens_the_road() -> None:
    dry, wet = (albedos(small.ground("road"), wetness=wetness) for wetness in (0.0, 1.0))
    assert np.median(wet) < 0.65 * np.median(dry)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_snow_covers_its_share(share: float) -> None:
    seen = albedos(small.ground("road"), snow=share, centre_marking="none", has_edge_marking=False)
    assert np.mean(seen > 0.35) == pytest.approx(share, abs=0.2 if share else 0.0)


def test_textures_follow_the_seed() -> None:
    grass = small.ground("grass_ground")
    first, again, other = albedos(grass, 1), albedos(grass, 1), albedos(grass, 2)
    np.testing.assert_array_equal(first, again)
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.2
    assert 0.02 < first.std() / first.mean() < 0.5


@pytest.mark.parametrize("material", ["brick", "concrete", "plaster", "rock"])
def test_walls_are_not_flat(material: str) -> None:
    def seen(distance_m: float) -> Floats:
        world = small.renderer(small.wall(distance_m, 0.5 * distance_m, material), CAMERA)
        light = world.render(small.looking([0, 0, 0]), [small.bulb([0, 0, 0])], 1, [], small.NO_AIR)
        return np.asarray(light.surface_cd_m2[0][90:150, 130:190], np.float64)

    near, far = seen(6.0), seen(120.0)
    assert near.std() > 0.02 * near.mean()
    assert far.std() < near.std() / near.mean() * far.mean()  # detail below a pixel is averaged, not sampled
