"""Trees, woods, undergrowth, single bushes and grass."""

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
from foreglow.lab.simulation.world.mesh import Mesh, instanced, joined, surface, tubes, yaw_rotations
from foreglow.lab.simulation.world.noise import Noise
from foreglow.lab.simulation.world.terrain import Terrain

GOLDEN_ANGLE_RAD = 2.39996


@dataclass(frozen=True, slots=True)
class Detail:
    """Level of detail of a plant; with less detail, it has fewer and larger leaves.

    Attributes:
        num_trunk_parts: Number of pieces of the trunk.
        num_sides: Number of sides of the trunk; branches have fewer.
        num_branches: Number of branches on the trunk.
        num_twigs: Number of twigs on the branches.
        num_leaves: Number of leaves of a tree in full leaf.
        leaf_m: Half the length of a leaf, or of the tuft of leaves that it stands for.
    """

    num_trunk_parts: int
    num_sides: int
    num_branches: int
    num_twigs: int
    num_leaves: int
    leaf_m: float


TREE_DETAILS = (Detail(7, 8, 30, 150, 1500, 0.08), Detail(5, 5, 16, 45, 420, 0.15), Detail(3, 4, 8, 8, 90, 0.32))
BUSH_DETAILS = (Detail(0, 0, 26, 70, 420, 0.045), Detail(0, 0, 12, 10, 110, 0.09), Detail(0, 0, 5, 0, 36, 0.17))


def tree(rng: np.random.Generator, height_m: float, leaves: float, detail: Detail) -> Mesh:
    """A broad-leaved tree with its foot at the origin; `leaves` from 0, bare, to 1, in full leaf.

    The crown begins between a fifth and a half of the height, as in a wood.
    """
    bark = material_number("bark")
    knots = np.linspace(0.0, 0.9 * height_m, detail.num_trunk_parts + 1)
    wander = np.cumsum(rng.normal(0, 0.09, (len(knots), 2)) * np.sqrt(height_m / len(knots)), 0)
    trunk = np.concatenate([wander - wander[0], knots[:, None]], 1)
    trunk[0, 2] = -0.6  # roots, so that no tree floats on a slope
    radii = height_m * rng.uniform(0.010, 0.017) * np.linspace(1.0, 0.18, len(knots))
    crown = rng.uniform(0.2, 0.5)
    share = np.sort(rng.uniform(crown, 0.98, detail.num_branches))
    starts = np.stack([np.interp(share * 0.9 * height_m, knots, trunk[:, axis]) for axis in range(3)], -1)
    azimuths = GOLDEN_ANGLE_RAD * np.arange(detail.num_branches) + rng.normal(0, 0.4, detail.num_branches)
    lengths = height_m * (0.06 + 0.30 * (1.0 - share)) * rng.uniform(0.6, 1.3, detail.num_branches)
    thick = np.interp(share, np.linspace(0, 1, len(knots)), radii) * 0.5
    bends, tips = _branch_ends(rng, starts, azimuths, lengths)
    sides = max(3, detail.num_sides - 3)
    parts = [
        tubes(trunk[:-1], trunk[1:], radii[:-1], radii[1:], detail.num_sides, bark),
        tubes(starts, bends, thick, 0.6 * thick, sides, bark),
        tubes(bends, tips, 0.6 * thick, 0.25 * thick, 3, bark),
    ]
    twig_starts, twig_ends = _twigs(rng, bends, tips, detail.num_twigs, 0.1 * height_m)
    parts.append(tubes(twig_starts, twig_ends, 0.012, 0.006, 3, bark))
    num_leaves = round(leaves * detail.num_leaves)
    if num_leaves:
        anchors = _anchors(rng, np.concatenate([bends, twig_starts]), np.concatenate([tips, twig_ends]), num_leaves)
        anchors += rng.normal(0, 0.03 * height_m, anchors.shape)
        middle = np.array([0.0, 0.0, 0.6 * height_m])
        parts.append(_leaves(rng, anchors, detail.leaf_m, anchors - middle))
    return joined(parts)


def bush(rng: np.random.Generator, height_m: float, leaves: float, detail: Detail) -> Mesh:
    """A bush with its foot at the origin: stems that spread out of the ground, with side twigs and leaves."""
    num = detail.num_branches
    azimuths, spread = rng.uniform(0, 2 * np.pi, num), rng.uniform(0.1, 0.9, num)
    out = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(num)], -1)
    starts = out * rng.uniform(0, 0.2, (num, 1)) * height_m - [0.0, 0.0, 0.15]
    lengths = height_m * rng.uniform(0.5, 1.05, num)[:, None]
    tips = starts + (out * spread[:, None] * 0.7 + [0.0, 0.0, 1.0]) * lengths
    bends = 0.5 * (starts + tips) + rng.normal(0, 0.11, (num, 3)) * height_m * [1.0, 1.0, 0.5]
    bark = material_number("bark")
    parts = [tubes(starts, bends, 0.012, 0.009, 3, bark), tubes(bends, tips, 0.009, 0.005, 3, bark)]
    twig_starts, twig_ends = _twigs(rng, bends, tips, detail.num_twigs, 0.35 * height_m)
    parts.append(tubes(twig_starts, twig_ends, 0.007, 0.004, 3, bark))
    num_leaves = round(leaves * detail.num_leaves)
    if num_leaves:
        anchors = _anchors(rng, np.concatenate([bends, twig_starts]), np.concatenate([tips, twig_ends]), num_leaves)
        anchors += rng.normal(0, 0.06 * height_m, anchors.shape)
        anchors[:, 2] = np.maximum(anchors[:, 2], 0.05)
        parts.append(_leaves(rng, anchors, detail.leaf_m, anchors - [0.0, 0.0, 0.3 * height_m]))
    return joined(parts)


def _branch_ends(rng: np.random.Generator, starts: Floats, azimuths: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """The bends and ends of branches, which begin flat and turn upwards."""
    num = len(starts)
    rise = rng.uniform(0.1, 0.8, num)
    out = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(num)], -1)
    first = (out * np.cos(rise)[:, None] + [0.0, 0.0, 1.0] * np.sin(rise)[:, None]) * lengths[:, None] * 0.5
    second = (
        first + np.array([0.0, 0.0, 0.35]) * lengths[:, None] * 0.5 + rng.normal(0, 0.08, (num, 3)) * lengths[:, None]
    )
    return starts + first, starts + first + second


def _twigs(rng: np.random.Generator, starts: Floats, ends: Floats, num: int, length_m: float) -> tuple[Floats, Floats]:
    """Starts and ends of `num` twigs that leave the branches in any direction."""
    branch = rng.integers(0, len(starts), num)
    along = (ends - starts)[branch]
    begin = starts[branch] + along * rng.uniform(0.0, 1.0, (num, 1))
    direction = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9) + rng.normal(0, 0.7, (num, 3))
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    return begin, begin + direction * length_m * rng.uniform(0.4, 1.2, (num, 1))


def _anchors(rng: np.random.Generator, starts: Floats, ends: Floats, num: int) -> Floats:
    stick = rng.integers(0, len(starts), num)
    return np.asarray(starts[stick] + (ends - starts)[stick] * rng.uniform(0.2, 1.2, (num, 1)))


def _leaves(rng: np.random.Generator, centres: Floats, half_length_m: float, outwards: Floats) -> Mesh:
    """Leaves as rhombs of two triangles, randomly oriented.

    Their shading normals are tilted out of the crown, like the mean normal of the many small leaves that each stands
    for; the normals of the triangles would make them sparkle from frame to frame.
    """
    num = len(centres)
    along, random = rng.normal(size=(2, num, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, random)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    size = half_length_m * rng.uniform(0.5, 1.4, (num, 1))
    corners = [
        centres - along * size,
        centres + across * size * 0.6,
        centres + along * size,
        centres - across * size * 0.6,
    ]
    vertices = np.stack(corners, 1)
    normals = np.cross(along, across)
    out = outwards / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    normals = normals * np.where(np.sum(normals * out, 1, keepdims=True) < 0, -1, 1) + out
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = np.array([[0, 1, 2], [0, 2, 3]])[None] + 4 * np.arange(num)[:, None, None]
    return surface(vertices, faces, material_number("leaf"), normals=np.repeat(normals, 4, 0))


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
