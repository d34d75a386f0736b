"""Woods, undergrowth, single bushes and grass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.surroundings import Span, SurroundingsSpec, Verge, Woods
from foreglow.lab.simulation.world.furniture import SIDE_SIGNS
from foreglow.lab.simulation.world.ground_cover import PAVEMENT_M
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, surface
from foreglow.lab.simulation.world.noise import Noise
from foreglow.lab.simulation.world.primitives import instanced, yaw_rotations
from foreglow.lab.simulation.world.terrain import Terrain
from foreglow.lab.simulation.world.trees import BUSH_DETAILS, TREE_DETAILS, Detail, bush, tree

MAX_TREE_FACES = 520_000
MAX_BUSH_FACES = 130_000
MAX_BLADES = 110_000

DETAIL_REACH_M = (8.0, 18.0)
"""Distances from the edge of the carriageway from which plants are made in less detail."""

DETAIL_SHARES = (0.55, 0.85)
"""Shares of the permitted triangles after which plants are made in less detail, even if they are nearer."""

NUM_SHAPES = 4
UNDERGROWTH_SPACING_M = 1.9
GRASS_DECAY_M = 2.6
"""Distance from the edge over which blades become rarer by 1 / e, since few can be seen singly further off."""

BLADES_PER_TUFT = 5
STALK_SHARE, STALK_FACTOR = 0.03, 3.5
"""Share of dry stalks among the blades, and how many times as high they are."""

FAR_FACTOR = 0.1
"""A plant one metre beyond the end of our drive counts as this much further from the road."""


@dataclass(frozen=True, slots=True, eq=False)
class _Stand:
    """Plants of one kind: the position and the scale of each, shape (N,)."""

    s_m: Floats
    t_m: Floats
    scales: Floats


def build_plants(
    spec: SurroundingsSpec, terrain: Terrain, rng: np.random.Generator, seen_m: Span, near_m: Span
) -> list[Mesh]:
    """All plants in the world: woods and bushes along `seen_m`, blades of grass along `near_m`."""
    meshes: list[Mesh] = []
    share = 1.0 / max(len(spec.woods), 1)
    for woods in spec.woods:
        meshes += _woods(woods, terrain, rng, seen_m, share)
    meshes += _single_bushes(spec.num_bushes, terrain, rng, seen_m)
    for side, verge in ((1.0, spec.left), (-1.0, spec.right)):
        meshes += _grass(verge, side, terrain, rng, near_m)
    return meshes


def _woods(woods: Woods, terrain: Terrain, rng: np.random.Generator, seen_m: Span, share: float) -> list[Mesh]:
    start, end = max(woods.span_m[0], seen_m[0]), min(woods.span_m[1], seen_m[1])
    if end - start <= 0:
        return []
    side, edge = SIDE_SIGNS[woods.side], terrain.road.half_width_m + woods.offset_m
    if woods.depth_m == 0:
        s = np.arange(start + rng.uniform(0, woods.spacing_m), end, woods.spacing_m)
        s = s + rng.normal(0, 0.12, len(s)) * woods.spacing_m
        out = np.abs(rng.normal(0, 0.3, len(s)))
    else:
        num = round((end - start) * woods.depth_m / woods.spacing_m**2)
        s, out = rng.uniform(start, end, num), rng.uniform(0, woods.depth_m, num)
    stand = _standing(terrain, s, side * (edge + out), np.exp(rng.normal(-0.1, 0.22, len(s))), 0.8)

    def grown_tree(detail: Detail) -> Mesh:
        leaves = float(np.clip(woods.leaves * rng.uniform(0.6, 1.4), 0, 1))
        return tree(rng, woods.height_m, leaves, detail)

    meshes = _instances(stand, terrain, rng, grown_tree, TREE_DETAILS, round(MAX_TREE_FACES * share))
    if woods.has_undergrowth:
        depth = min(woods.depth_m, 8.0) + 1.5
        num = round((end - start) * depth / UNDERGROWTH_SPACING_M**2)
        s, out = rng.uniform(start, end, num), rng.uniform(-min(1.5, 0.5 * woods.offset_m), depth - 1.5, num)
        # Brambles and young trees grow in thickets.
        is_thicket = Noise(rng, 9.0)(s, side * out) + rng.normal(0, 0.5, num) > -0.2
        s, out = s[is_thicket], out[is_thicket]
        stand = _standing(terrain, s, side * (edge + out), np.exp(rng.normal(-0.15, 0.35, len(s))), 0.8)

        def grown_bush(detail: Detail) -> Mesh:
            return bush(rng, 1.4, float(np.clip(woods.leaves * rng.uniform(0.4, 1.4), 0, 1)), detail)

        meshes += _instances(stand, terrain, rng, grown_bush, BUSH_DETAILS, round(MAX_BUSH_FACES * share))
    return meshes


def _single_bushes(num: int, terrain: Terrain, rng: np.random.Generator, seen_m: Span) -> list[Mesh]:
    length = terrain.road.length_m
    s, out = rng.uniform(0, length, num), 2.5 + rng.gamma(1.5, 4.0, num)
    t = np.where(rng.random(num) < 0.5, 1, -1) * (terrain.road.half_width_m + out)
    is_seen = (s >= seen_m[0]) & (s <= seen_m[1])
    stand = _standing(terrain, s[is_seen], t[is_seen], rng.uniform(0.5, 1.6, int(is_seen.sum())), 0.8)

    def grown(detail: Detail) -> Mesh:
        return bush(rng, 1.4, float(rng.uniform(0.1, 1.0)), detail)

    return _instances(stand, terrain, rng, grown, BUSH_DETAILS, MAX_BUSH_FACES)


def _standing(terrain: Terrain, s: Floats, t: Floats, scales: Floats, margin_m: float) -> _Stand:
    """The plants that do not stand on a carriageway."""
    is_clear = terrain.is_clear(s, t, margin_m)
    return _Stand(s[is_clear], t[is_clear], scales[is_clear])


def _instances(
    stand: _Stand,
    terrain: Terrain,
    rng: np.random.Generator,
    grown: Callable[[Detail], Mesh],
    details: tuple[Detail, ...],
    max_faces: int,
) -> list[Mesh]:
    """Copies of a few prototypes, in less detail further from the road, with at most `max_faces` triangles."""
    prototypes = [[grown(detail) for _ in range(NUM_SHAPES)] for detail in details]
    num = len(stand.s_m)
    shapes, yaws, leans = rng.integers(0, NUM_SHAPES, num), rng.uniform(0, 2 * np.pi, num), rng.normal(0, 0.03, num)
    away = np.abs(stand.t_m) - terrain.road.half_width_m
    away = away + FAR_FACTOR * np.maximum(stand.s_m - terrain.fine_m[1], 0.0)
    levels = _levels(
        away, np.array([[len(prototype.faces) for prototype in row] for row in prototypes]), shapes, max_faces
    )
    meshes = []
    for level, row in enumerate(prototypes):
        for shape, prototype in enumerate(row):
            chosen = np.flatnonzero((levels == level) & (shapes == shape))
            if len(chosen):
                feet = terrain.points(stand.s_m[chosen], stand.t_m[chosen], -0.05)
                turns = yaw_rotations(yaws[chosen], leans[chosen])
                meshes.append(instanced(prototype, feet, turns, stand.scales[chosen]))
    return meshes


def _levels(
    away_m: Floats, num_faces: NDArray[np.intp], shapes: NDArray[np.int64], max_faces: int
) -> NDArray[np.int64]:
    """Level of detail of each plant, shape (N,): 0 is the finest, -1 omits the plant.

    The nearest plants are as fine as `max_faces` triangles allow; `num_faces` has shape (levels, shapes).
    """
    levels = np.full(len(away_m), -1)
    nearest = np.argsort(away_m, kind="stable")
    spent = 0.0
    for level, (reach, share) in enumerate(zip((*DETAIL_REACH_M, np.inf), (*DETAIL_SHARES, 1.0), strict=True)):
        waiting = nearest[levels[nearest] < 0]
        total = spent + np.cumsum(num_faces[level, shapes[waiting]])
        chosen = waiting[(total <= share * max_faces) & (away_m[waiting] < reach)]
        levels[chosen] = level
        spent += float(num_faces[level, shapes[chosen]].sum())
    return levels


def _grass(verge: Verge, side: float, terrain: Terrain, rng: np.random.Generator, near_m: Span) -> list[Mesh]:
    """Tufts of bent blades in patches, with dry stalks in between."""
    start, end = max(near_m[0], -20.0), min(near_m[1], terrain.road.length_m + 20.0)
    if verge.grass_height_m == 0 or verge.grass_per_m2 == 0 or end <= start:
        return []
    wanted = verge.grass_per_m2 * (end - start) * GRASS_DECAY_M * (1 - 0.85 * verge.snow)
    num_tufts = round(min(wanted, MAX_BLADES / 2) / BLADES_PER_TUFT)
    # Twice as many candidates as tufts: only those in patches grow.
    first = PAVEMENT_M + 0.1 if verge.ground == "pavement" else 0.12
    s, out = rng.uniform(start, end, 2 * num_tufts), first + rng.exponential(GRASS_DECAY_M, 2 * num_tufts)
    patches = Noise(rng, 1.8)(s, out) + 0.5 * rng.normal(size=len(s))
    chosen = np.sort(np.argsort(patches, kind="stable")[num_tufts:])
    s, t, lush = s[chosen], side * (terrain.road.half_width_m + out[chosen]), patches[chosen]
    is_clear = terrain.is_clear(s, t, 0.1)
    s, t, lush = (np.repeat(values[is_clear], BLADES_PER_TUFT) for values in (s, t, lush))
    if not len(s):
        return []
    spread = 0.7 * verge.grass_height_m + 0.05
    s, t = s + rng.normal(0, spread, len(s)), t + rng.normal(0, spread, len(s))
    is_off = np.abs(t) > terrain.road.half_width_m + 0.05
    heights = verge.grass_height_m * np.clip(0.5 + 0.25 * lush + 0.3 * rng.normal(size=len(s)), 0.2, 1.9)
    heights = heights * np.where(rng.random(len(s)) < STALK_SHARE, STALK_FACTOR, 1.0)
    return [_blades(terrain.points(s[is_off], t[is_off], -0.02), heights[is_off], rng)]


def _blades(feet: Floats, heights: Floats, rng: np.random.Generator) -> Mesh:
    """Blades that bend to one side, each of three triangles; `heights` are their lengths."""
    num = len(feet)
    azimuths, lean = rng.uniform(0, 2 * np.pi, num), rng.uniform(0.15, 1.1, num)
    over = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(num)], -1)
    twist = azimuths + rng.normal(np.pi / 2, 0.5, num)
    wide = np.stack([np.cos(twist), np.sin(twist), np.zeros(num)], -1) * rng.uniform(0.002, 0.006, (num, 1))
    up = np.array([0.0, 0.0, 1.0])
    half, lean = 0.5 * heights[:, None] + 0.01, lean[:, None]
    knees = feet + (over * np.sin(0.5 * lean) + up * np.cos(0.5 * lean)) * half
    tips = knees + (over * np.sin(1.6 * lean) + up * np.cos(1.6 * lean)) * half
    vertices = np.stack([feet - wide, feet + wide, knees - 0.8 * wide, knees + 0.8 * wide, tips], 1)
    faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]])[None] + 5 * np.arange(num)[:, None, None]
    return surface(vertices, faces, material_number("grass_blade"))
