"""The whole static world of a scene."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.datasets.simulated import KINDS
from foreglow.lab.simulation.scenes.scene import Branch, EgoSpec, RoadSpec, Scene
from foreglow.lab.simulation.scenes.surroundings import (
    House,
    Rail,
    Sign,
    StreetLamp,
    SurroundingsSpec,
    Verge,
    Wall,
    Woods,
)
from foreglow.lab.simulation.world.materials import MATERIALS, column, material_number
from foreglow.lab.simulation.world.world import World, build_world
from tests.lab.simulation.small_scenes import small_scene

FULL = small_scene(
    RoadSpec(length_m=100, curvature_per_m=((20, 0), (40, -0.01)), branches=(Branch(s_m=45, angle_deg=80),)),
    left=Verge(bank_m=2, snow=0.4),
    right=Verge(ground="pavement"),
    rails=(Rail(side="right", span_m=(5, 95)),),
    walls=(Wall(side="left", span_m=(5, 40)), Wall(side="left", span_m=(60, 90), material="rock", offset_m=3)),
    signs=(Sign(side="right", s_m=30, kind="round"), Sign(side="left", s_m=70, kind="chevron_right")),
    woods=(Woods(side="left", span_m=(0, 100), depth_m=6),),
    houses=(House(side="right", s_m=60),),
    street_lamps=(StreetLamp(side="right", s_m=20), StreetLamp(side="left", s_m=80, intensity_cd=0)),
    delineator_spacing_m=30,
    num_bushes=20,
)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(FULL)


def test_world_holds_everything_that_the_scene_names(world: World) -> None:
    names = {MATERIALS[number].name for number in np.unique(world.mesh.materials)}
    asked = "road pavement kerb snow grass_ground grass_blade bark leaf rail metal_post post reflector sign_white"
    asked += " sign_colour concrete rock roof window pole"
    assert set(asked.split()) <= names
    assert len(world.branches) == 1
    assert sorted(light.kind for light in world.lights) == ["street_lamp", "window", "window"]


def test_mesh_is_whole(world: World) -> None:
    mesh = world.mesh
    assert mesh.faces.max() < len(mesh.vertices_m)
    assert mesh.materials.max() < len(MATERIALS)
    assert len(mesh.faces) == len(mesh.materials)
    assert np.isfinite(mesh.vertices_m).all()
    assert np.isfinite(mesh.coordinates_m).all()
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-3)
    assert [str(array.dtype) for array in (mesh.vertices_m, mesh.faces, mesh.materials)] == [
        "float32",
        "uint32",
        "uint8",
    ]


def test_ground_height_is_the_terrains(world: World) -> None:
    assert world.ground_height_m([10.0, 20.0], [0.0, 9.0]).shape == (2,)
    assert world.ground_height_m(10.0, 0.0) == pytest.approx(float(world.road.points(10.0)[2]))


@pytest.mark.slow
def test_same_scene_same_bytes(world: World) -> None:
    again = build_world(FULL.model_copy())
    for name in ("vertices_m", "faces", "materials", "normals", "coordinates_m"):
        assert getattr(again.mesh, name).tobytes() == getattr(world.mesh, name).tobytes()
    assert [light.intensity_cd for light in again.lights] == [light.intensity_cd for light in world.lights]


@pytest.mark.slow
def test_another_seed_changes_plants_and_ground_but_not_the_carriageway(world: World) -> None:
    other = build_world(FULL.model_copy(update={"seed": 1}))
    assert other.mesh.vertices_m.shape != world.mesh.vertices_m.shape
    assert other.ground_height_m(30.0, 20.0) != world.ground_height_m(30.0, 20.0)
    assert other.ground_height_m(30.0, 1.0) == world.ground_height_m(30.0, 1.0)


@pytest.mark.slow
def test_a_sign_more_moves_no_tree(world: World) -> None:
    signs = (*FULL.surroundings.signs, Sign(side="left", s_m=90, kind="triangle"))
    more = build_world(FULL.model_copy(update={"surroundings": FULL.surroundings.model_copy(update={"signs": signs})}))
    bark = [mesh.vertices_m[mesh.faces[mesh.materials == material_number("bark")]] for mesh in (world.mesh, more.mesh)]
    assert np.array_equal(*bark)


def test_empty_surroundings_are_only_ground() -> None:
    bare = build_world(small_scene())
    assert {MATERIALS[number].kind for number in np.unique(bare.mesh.materials)} == {"road", "verge"}
    assert bare.lights == ()
    assert bare.branches == ()


def test_plants_that_we_never_come_near_to_are_left_out() -> None:
    road = RoadSpec(length_m=1500)
    surroundings = SurroundingsSpec(woods=(Woods(side="left", span_m=(0, 1500), depth_m=0, spacing_m=20),))
    scene = Scene(road=road, surroundings=surroundings, duration_s=5, ego=EgoSpec(timetable=((0, 20), (5, 100))))
    mesh = build_world(scene).mesh
    reach = [
        mesh.vertices_m[mesh.faces[mesh.materials == material_number(name)]][..., 0].max()
        for name in ("grass_blade", "bark", "road")
    ]
    assert reach[0] < 160 < 400 < reach[1] < 520 < 1500 < reach[2]


def test_materials_are_physical_and_unknown_ones_refused() -> None:
    assert len({material.name for material in MATERIALS}) == len(MATERIALS) < 255
    assert {material.kind for material in MATERIALS} <= set(KINDS)
    for field, top in (("albedo", 0.9), ("specular", 1), ("roughness", 1), ("transmission", 1)):
        assert np.all((column(field) >= 0) & (column(field) <= top))
    for field in ("retroreflection", "variation", "bump"):
        assert np.all(column(field) >= 0)
    assert np.all(column("roughness") > 0)
    with pytest.raises(ValueError, match=r"expected one of road, marking, .*, got 'velvet'"):
        material_number("velvet")
