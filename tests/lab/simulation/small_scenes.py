"""Small scenes and grounds that several tests build."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, Scene
from foreglow.lab.simulation.scenes.surroundings import SurroundingsSpec, Verge
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.world.terrain import Terrain

BARE = Verge(grass_height_m=0)
BEND = RoadSpec(length_m=100, curvature_per_m=((20, 0), (30, 0.02)), elevation_m=((0, 0), (50, 3), (100, 0)))


def small_scene(road: RoadSpec = BEND, seed: int = 0, **surroundings: Any) -> Scene:
    """A drive over 100 m without grass or delineators, unless `surroundings` says otherwise."""
    spec: dict[str, Any] = {"left": BARE, "right": BARE, "delineator_spacing_m": 0, **surroundings}
    ego = EgoSpec(timetable=((0, 10), (5, 60)))
    return Scene(seed=seed, duration_s=5, road=road, surroundings=SurroundingsSpec(**spec), ego=ego)


def drawn_terrain(road: Road, left: Verge = BARE, right: Verge = BARE, branches: tuple[Road, ...] = ()) -> Terrain:
    return Terrain(road, branches, (left, right), np.random.default_rng(3))


def is_of(mesh: Mesh, *names: str) -> NDArray[np.bool_]:
    """Which triangles are of one of the materials."""
    return np.isin(mesh.materials, [material_number(name) for name in names])


def points_of(mesh: Mesh, *names: str) -> Floats:
    """Corners of the triangles of these materials, shape (N, 3)."""
    return mesh.vertices_m[np.unique(mesh.faces[is_of(mesh, *names)])].astype(np.float64)


def face_normals(mesh: Mesh) -> Floats:
    """Normals of the triangles as their corners turn, twice their area long, shape (F, 3)."""
    corners = mesh.vertices_m[mesh.faces].astype(np.float64)
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
