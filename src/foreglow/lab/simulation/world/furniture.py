"""Guardrails, walls and delineators along a road."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.surroundings import Rail, Side, Span, SurroundingsSpec, Wall
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.noise import Noise, smooth_step
from foreglow.lab.simulation.world.primitives import box, faceted, flat, instanced, strip, yaw_rotations
from foreglow.lab.simulation.world.terrain import Terrain

RAIL_PROFILE_M = np.array(
    [
        [0.030, 0.440],
        [0.012, 0.447],
        [0.000, 0.470],
        [0.000, 0.510],
        [0.018, 0.535],
        [0.062, 0.560],
        [0.080, 0.580],
        [0.080, 0.610],
        [0.062, 0.630],
        [0.018, 0.655],
        [0.000, 0.680],
        [0.000, 0.720],
        [0.012, 0.743],
        [0.030, 0.750],
    ]
)
"""Cross-section of a W-beam: distance behind its face, and height above the edge of the carriageway."""

RAIL_STEP_M = 0.5
RAIL_POST_TOP_M = 0.70
RAIL_POST_SIZE_M = (0.055, 0.10)
RAIL_END_M = 10.0
"""Length over which a rail rises out of the ground."""

BURIED_M = 0.3
"""Depth of posts and walls below the ground."""

WALL_THICKNESS_M = 0.3
DELINEATOR_OFFSET_M = 0.5
DELINEATOR_HEIGHT_M = 1.0
DELINEATOR_FOOT_M = 0.9
"""Length of a post below its zero height; on an embankment, part of it is above the ground."""

SIDE_SIGNS: dict[Side, float] = {"left": 1.0, "right": -1.0}


def build_furniture(spec: SurroundingsSpec, terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """Rails, walls and delineators of the scene, in the world."""
    meshes = [mesh for rail in spec.rails for mesh in _rail(rail, terrain, rng)]
    meshes += [mesh for wall in spec.walls for mesh in _wall(wall, terrain, rng)]
    if spec.delineator_spacing_m > 0:
        meshes += _delineators(spec, terrain, rng)
    return meshes


def clear_spans(terrain: Terrain, span: Span, t_m: float, step_m: float = 0.5) -> list[Span]:
    """The parts of `span` on the road that no side road crosses at the offset `t_m`; each at least 2 m long."""
    start, end = max(span[0], 0.0), min(span[1], terrain.road.length_m)
    if end - start < 2.0:
        return []
    s = np.linspace(start, end, max(2, round((end - start) / step_m) + 1))
    is_clear = np.concatenate([[False], terrain.is_clear(s, np.full(len(s), t_m), 0.3), [False]])
    changes = np.flatnonzero(np.diff(is_clear.astype(np.int8)))
    runs = [(float(s[first]), float(s[last - 1])) for first, last in changes.reshape(-1, 2)]
    return [run for run in runs if run[1] - run[0] >= 2.0]


def rail_base_m(terrain: Terrain, s_m: ArrayLike, t_m: float) -> Floats:
    """Height from which a rail at the offset `t_m` is measured: the carriageway's edge, or the ground far from it."""
    s, road = np.asarray(s_m, np.float64), terrain.road
    edge = road.elevation_m(s) + road.cross_height_m(s, t_m)
    share = smooth_step((abs(t_m) - road.half_width_m - 1.5) / 1.5)
    if share == 0:
        return edge
    # Rails do not follow every bump.
    ground = np.mean([terrain.ground_height_m(s + shift, t_m) for shift in (-4.0, -2.0, 0.0, 2.0, 4.0)], axis=0)
    return np.asarray(edge + share * (ground - edge))


def _rail(rail: Rail, terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    side = SIDE_SIGNS[rail.side]
    face = side * (terrain.road.half_width_m + rail.offset_m)
    wobble = Noise(rng, 6.0)
    return [
        mesh
        for span in clear_spans(terrain, rail.span_m, face)
        for mesh in rail_run(terrain, span, face, side, post_spacing_m=rail.post_spacing_m, wobble=wobble)
    ]


def rail_run(
    terrain: Terrain, span: Span, face_m: float, side: float, *, post_spacing_m: float, wobble: Noise
) -> list[Mesh]:
    """A rail and its posts along `span`.

    Args:
        terrain: The ground.
        span: Begin and end.
        face_m: Offset of its face from the centre line.
        side: 1 if its posts stand to the left of its face, else -1.
        post_spacing_m: Distance between posts.
        wobble: How it departs from a straight line.
    """
    start, end = span
    s = np.linspace(start, end, max(2, round((end - start) / RAIL_STEP_M) + 1))
    # Rails are never quite straight, which breaks up their glints.
    behind = RAIL_PROFILE_M[:, 0] + 0.006 * wobble(s, 0.0)[:, None]
    base = rail_base_m(terrain, s, face_m) + 0.004 * wobble(s, 9.0)
    # At its ends the rail goes down into the ground.
    buried = np.minimum(terrain.ground_height_m(s, face_m) - base - 0.2, 0.0) - RAIL_PROFILE_M[-1, 1]
    base = base + (1 - _risen(s, start, end)) * buried
    heights = base[:, None] + RAIL_PROFILE_M[:, 1]
    points = terrain.road.points(s[:, None], face_m + side * behind)
    points[..., 2] = heights
    along = np.broadcast_to(s[:, None], behind.shape)
    around = np.broadcast_to(np.arange(len(RAIL_PROFILE_M)) * 0.032, behind.shape)
    beam = strip(points, material_number("rail"), coordinates_m=np.stack([along, around], -1))
    posts = np.arange(start + 0.5 * post_spacing_m, end, post_spacing_m)
    posts = posts[_risen(posts, start, end) > 0.6]
    return [beam, *_rail_posts(terrain, posts, face_m, side, np.interp(posts, s, base))]


def _risen(s: Floats, start: float, end: float) -> Floats:
    """How far the rail has risen at s: 0 at its ends, 1 along its run."""
    length = min(RAIL_END_M, (end - start) / 3)
    return smooth_step(np.minimum(s - start, end - s) / length)


def _rail_posts(terrain: Terrain, s: Floats, face: float, side: float, base: Floats) -> list[Mesh]:
    if not len(s):
        return []
    t = face + side * (0.08 + RAIL_POST_SIZE_M[1] / 2)
    feet = terrain.points(s, t, -BURIED_M)
    post = box((0.0, 0.0, 0.5), (1.0, 1.0, 1.0), material_number("metal_post"))
    lengths = base + RAIL_POST_TOP_M - feet[:, 2]
    sizes = np.stack([np.full(len(s), RAIL_POST_SIZE_M[0]), np.full(len(s), RAIL_POST_SIZE_M[1]), lengths], -1)
    return [instanced(post, feet, yaw_rotations(terrain.road.heading_rad(s)), sizes)]


def _wall(wall: Wall, terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    side, is_rock = SIDE_SIGNS[wall.side], wall.material == "rock"
    front = side * (terrain.road.half_width_m + wall.offset_m)
    rough, meshes = Noise(rng, 2.0, 4), []
    thickness = WALL_THICKNESS_M * (4.0 if is_rock else 1.0)
    for start, end in clear_spans(terrain, wall.span_m, front):
        step = 0.3 if is_rock else 0.5
        s = np.linspace(start, end, max(2, round((end - start) / step) + 1))
        levels = np.linspace(0.0, 1.0, max(3, round(wall.height_m / 0.3)) if is_rock else 2)
        ground = terrain.ground_height_m(s, front)
        top = ground + wall.height_m
        if not is_rock:
            # Masons work to a line: the top of the wall follows the ground smoothly.
            top = np.convolve(np.pad(top, 10, "edge"), np.full(21, 1 / 21), "valid")
        bottom = np.minimum(ground, terrain.ground_height_m(s, front + side * thickness)) - BURIED_M
        heights = bottom[:, None] + (top - bottom)[:, None] * levels
        out = np.zeros(heights.shape)
        if is_rock:
            ends = smooth_step(np.minimum(s - start, end - s)[:, None] / 3.0)
            uneven = 0.15 * wall.height_m * np.clip(rough(s[:, None] / 2, 40.0), -2, 2)
            heights = bottom[:, None] + (top - bottom + uneven[:, 0])[:, None] * levels * (0.3 + 0.7 * ends)
            out = 0.16 * rough(s[:, None], heights) + 0.25 * levels * wall.height_m**0.5
        outline = np.concatenate([out, out[:, -1:] + thickness, out[:, -1:] + thickness], 1)
        heights = np.concatenate([heights, heights[:, -1:], bottom[:, None]], 1)
        meshes += _wall_sides(terrain, s, front + side * outline, heights, wall.material, is_rock)
    return meshes


def _wall_sides(terrain: Terrain, s: Floats, t: Floats, heights: Floats, material: str, is_rock: bool) -> list[Mesh]:
    """The faces of a wall with outlines of shape (len(s), corners) and sharp edges; rock has facets."""
    number = material_number(material)
    points = terrain.road.points(s[:, None], t)
    points[..., 2] = heights
    lengths = np.cumsum(np.abs(np.diff(t, axis=1, prepend=t[:, :1])) + np.abs(np.diff(heights, axis=1, prepend=0)), 1)
    coordinates = np.stack([np.broadcast_to(s[:, None], t.shape), lengths], -1)
    last = t.shape[1]
    cuts = [(0, last)] if is_rock else [(first, first + 2) for first in range(last - 1)]
    faces = [strip(points[:, a:b], number, coordinates_m=coordinates[:, a:b]) for a, b in cuts]
    if is_rock:
        faces = [faceted(face) for face in faces]
    fan = np.array([[0, k, k + 1] for k in range(1, last - 1)])
    return [*faces, *(flat(points[end], fan, number) for end in (0, -1))]


def _delineators(spec: SurroundingsSpec, terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """White posts with a black band; drivers see an upright reflector on the right and two small ones on the left."""
    road = terrain.road
    arc_lengths = np.arange(rng.uniform(0.1, 0.9) * spec.delineator_spacing_m, road.length_m, spec.delineator_spacing_m)
    meshes = []
    for name, side in SIDE_SIGNS.items():
        out = np.full(len(arc_lengths), DELINEATOR_OFFSET_M)
        for rail in (rail for rail in spec.rails if rail.side == name):
            is_behind = (arc_lengths >= rail.span_m[0]) & (arc_lengths <= rail.span_m[1])
            out = np.where(is_behind, np.maximum(out, rail.offset_m + 0.35), out)
        for wall in (wall for wall in spec.walls if wall.side == name):
            is_before = (arc_lengths >= wall.span_m[0]) & (arc_lengths <= wall.span_m[1])
            out = np.where(is_before, np.minimum(out, max(wall.offset_m - 0.2, 0.2)), out)
        t = side * (road.half_width_m + out)
        is_clear = terrain.is_clear(arc_lengths, t, 0.1)
        s, t = arc_lengths[is_clear], t[is_clear]
        if len(s):
            turns = yaw_rotations(road.heading_rad(s) + rng.normal(0, 0.05, len(s)), rng.normal(0, 0.015, len(s)))
            feet = terrain.points(s, t)
            # All have the same height above the carriageway's edge, even where the ground falls away.
            edge = road.points(s, side * road.half_width_m)[:, 2]
            feet[:, 2] = np.clip(edge, feet[:, 2], feet[:, 2] + DELINEATOR_FOOT_M - BURIED_M)
            meshes.append(instanced(_delineator(side * road.spec.mirror), feet, turns))
    return meshes


def _delineator(side: float) -> Mesh:
    """A post with its foot at the origin, for the oncoming side (1) or ours (-1); x along the road."""
    post, black, reflector = (material_number(name) for name in ("post", "sign_black", "reflector"))
    width, depth, top = 0.12, 0.10, DELINEATOR_HEIGHT_M
    parts = [
        box((0, 0, (0.62 - DELINEATOR_FOOT_M) / 2), (depth, width, 0.62 + DELINEATOR_FOOT_M), post),
        box((0, 0, 0.74), (depth, width, 0.24), black),
        box((0, 0, (0.86 + top) / 2), (depth, width, top - 0.86), post),
    ]
    for facing in (-1.0, 1.0):  # towards traffic along the road, and against it
        is_right_hand = side * facing > 0
        x = facing * (depth / 2 + 0.006)
        plates = (
            [((0.0, 0.74), (0.045, 0.18))]
            if is_right_hand
            else [((0.0, 0.69), (0.06, 0.06)), ((0.0, 0.79), (0.06, 0.06))]
        )
        parts += [box((x, y, z), (0.01, *size), reflector) for (y, z), size in plates]
    return joined(parts)
