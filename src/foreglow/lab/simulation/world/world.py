"""The static part of a scene, as triangles and lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.scenes.surroundings import Span
from foreglow.lab.simulation.world.buildings import build_houses, build_street_lamps
from foreglow.lab.simulation.world.furniture import (
    FixedLight,
    build_furniture,
    build_median,
    build_panels,
    build_settlements,
    build_signals,
)
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.overhead import build_bridges, build_gantries
from foreglow.lab.simulation.world.plants import build_plants
from foreglow.lab.simulation.world.road import Road, branch_road, interpolated
from foreglow.lab.simulation.world.signs import build_signs
from foreglow.lab.simulation.world.terrain import Terrain

__all__ = ["FixedLight", "World", "build_world"]

TERRAIN_STREAM, FURNITURE_STREAM, SIGNS_STREAM, BUILDINGS_STREAM, PLANTS_STREAM = 101, 102, 103, 104, 105
MEDIAN_STREAM, FAR_STREAM, OVERHEAD_STREAM = 106, 107, 108
"""Random streams, one for each part, so that an additional sign does not move a tree."""

GRASS_REACH_M = 45.0
"""Distance ahead of us up to which single blades matter in an image of 1280 columns."""

SIGHT_M = 400.0
"""Distance ahead of us up to which plants are built."""

FINE_REACH_M = 120.0
BEHIND_M = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """The static part of a scene.

    Attributes:
        mesh: All triangles. On the ground, `coordinates_m` are arc length and offset; on side road number n they are
            its own, with the offset shifted by (n + 1) * `terrain.BRANCH_T_M`.
        road: The main road.
        branches: The side roads, in the order of `Scene.road.branches`.
        lights: Street lamps that are on, lit windows, screens, traffic lights, and lamps in the distance.
        terrain: The ground.
    """

    mesh: Mesh
    road: Road
    branches: tuple[Road, ...]
    lights: tuple[FixedLight, ...]
    terrain: Terrain

    def ground_height_m(self, s_m: ArrayLike, t_m: ArrayLike) -> Floats:
        """Height of the ground in the world at arc length s and offset t, any shape."""
        return self.terrain.ground_height_m(s_m, t_m)


def build_world(scene: Scene) -> World:
    """The world of `scene`; parts that we never come close to have less detail."""

    def stream(number: int) -> np.random.Generator:
        return np.random.default_rng([scene.seed, number])

    spec = scene.surroundings
    start, end = _driven_m(scene)
    road = Road(scene.road)
    branches = tuple(branch_road(road, number) for number in range(len(scene.road.branches)))
    terrain = Terrain(
        road, branches, (spec.left, spec.right), stream(TERRAIN_STREAM), (start - BEHIND_M, end + FINE_REACH_M)
    )
    houses, windows = build_houses(spec.houses, terrain, stream(BUILDINGS_STREAM))
    posts, lamps = build_street_lamps(spec.street_lamps, terrain)
    panels, screens = build_panels(spec.panels, terrain)
    masts, signals = build_signals(spec.signals, terrain)
    far = build_settlements(spec.settlements, terrain, stream(FAR_STREAM))
    meshes = [
        terrain.mesh(),
        *build_furniture(spec, terrain, stream(FURNITURE_STREAM)),
        *build_signs(spec.signs, terrain, stream(SIGNS_STREAM)),
        *houses,
        *posts,
        *build_plants(
            spec,
            terrain,
            stream(PLANTS_STREAM),
            seen_m=(start - BEHIND_M, end + SIGHT_M),
            near_m=(start - BEHIND_M, end + GRASS_REACH_M),
        ),
        *build_median(terrain, stream(MEDIAN_STREAM)),
        *panels,
        *masts,
        *build_gantries(spec.gantries, terrain, stream(OVERHEAD_STREAM)),
        *build_bridges(spec.bridges, terrain),
    ]
    return World(joined(meshes), road, branches, (*windows, *lamps, *screens, *signals, *far), terrain)


def _driven_m(scene: Scene) -> Span:
    """Begin and end of our drive."""
    arc_lengths, _ = interpolated(scene.ego.timetable, np.linspace(0.0, scene.duration_s, 50))
    return float(arc_lengths.min()), float(arc_lengths.max())
