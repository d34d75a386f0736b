"""Guardrails, walls, delineators and the median along a road, and its fixed lights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.scenes.surroundings import (
    Panel,
    Rail,
    Settlement,
    Side,
    Signal,
    Span,
    SurroundingsSpec,
    Wall,
)
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import (
    Mesh,
    box,
    faceted,
    flat,
    instanced,
    joined,
    polygon,
    strip,
    tubes,
    yaw_rotations,
)
from foreglow.lab.simulation.world.noise import Noise, smooth_step
from foreglow.lab.simulation.world.terrain import Terrain


@dataclass(frozen=True, slots=True, eq=False)
class FixedLight:
    """A fixed light, not that of a vehicle.

    Attributes:
        pose: world_from_lamp; a street lamp's x points down, others' out of their face.
        kind: What it is; a screen is a billboard or a shop window, whose face is a surface of the world.
        intensity_cd: Intensity on its axis; how it falls to the side follows from the kind.
        size_m: Width (along its y) and height (along its z) of its face.
        reach_m: Distance from the camera up to which what it lights matters in the image.
    """

    pose: Pose
    kind: Literal["street_lamp", "window", "screen", "signal", "far_lamp"]
    intensity_cd: float
    size_m: tuple[float, float]
    reach_m: float = 120.0


def screen(size_m: tuple[float, float], screen_cd_m2: float, *, picture: float) -> Mesh:
    """A rectangle that faces along x and shines by itself; `picture`, 0..1, is how much its luminance varies."""
    y, z = size_m[0] / 2, size_m[1] / 2
    corners = np.array([[0.0, -y, -z], [0.0, y, -z], [0.0, y, z], [0.0, -y, z]])
    mesh = polygon(corners, material_number("screen"))
    shine = np.broadcast_to(np.array([screen_cd_m2, picture], np.float32), mesh.coordinates_m.shape)
    return replace(mesh, coordinates_m=shine)


def screen_light(pose: Pose, size_m: tuple[float, float], screen_cd_m2: float) -> FixedLight:
    """The light of a screen at `pose`, world_from_screen, as that of a point slightly in front of its middle."""
    out = Pose(pose.to_outer([0.3, 0.0, 0.0]), pose.rotation)
    return FixedLight(out, "screen", screen_cd_m2 * size_m[0] * size_m[1], size_m)


HOUSING_M = (0.22, 0.32, 0.94)
"""Depth, width and height of a traffic light with three lenses of 0.2 m."""

LENS_M = 0.2
LENS_HEIGHTS_M = {"red": 0.77, "amber": 0.47, "green": 0.17}
"""Heights of the lenses above the lower edge of the housing."""

FAR_LAMP_SPREAD = 1.4
"""Standard deviation of the logarithm of the intensities of lamps in the distance: many are half hidden."""

FAR_LAMP_M, FAR_LAMP_SIZE_M = 4.0, (0.6, 0.3)
"""Least height above the road, width and height of lamps in the distance."""


def build_panels(panels: tuple[Panel, ...], terrain: Terrain) -> tuple[list[Mesh], list[FixedLight]]:
    """The billboards in the world, and their light."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for panel in panels:
        side, (width, height) = SIDE_SIGNS[panel.side], panel.size_m
        t = side * (terrain.road.half_width_m + panel.offset_m + width / 2)
        facing = float(terrain.road.heading_rad(panel.s_m)) + np.pi + side * float(np.radians(panel.yaw_deg))
        foot = Pose(terrain.points(panel.s_m, t), rotation(facing))
        middle = np.array([0.0, 0.0, panel.height_m + height / 2])
        frame = box(middle - [0.12, 0.0, 0.0], (0.2, width + 0.15, height + 0.15), material_number("sign_back"))
        feet = np.array([[-0.12, y, -BURIED_M] for y in (-0.35 * width, 0.35 * width)])
        posts = tubes(
            feet, feet + np.array([0.0, 0.0, panel.height_m + BURIED_M]), 0.08, 0.08, 10, material_number("pole")
        )
        meshes.append(joined([frame, posts]).moved(foot))
        if panel.screen_cd_m2 > 0:
            pose = foot @ Pose(middle, rotation())
            picture = joined([screen(panel.size_m, panel.screen_cd_m2, picture=0.8), *_print(panel.size_m)])
            meshes.append(picture.moved(pose))
            lights.append(screen_light(pose, panel.size_m, panel.screen_cd_m2))
    return meshes, lights


def build_signals(signals: tuple[Signal, ...], terrain: Terrain) -> tuple[list[Mesh], list[FixedLight]]:
    """The traffic lights in the world, and the light of their lenses."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for signal in signals:
        side = SIDE_SIGNS[signal.side]
        t = side * (terrain.road.half_width_m + signal.offset_m)
        facing = float(terrain.road.heading_rad(signal.s_m)) + (0.0 if signal.faces_oncoming else np.pi)
        foot = Pose(terrain.points(signal.s_m, t), rotation(facing))
        # Seen from the housing's front, the road is to the left of a mast on the reader's right.
        inwards = side * (-1.0 if signal.faces_oncoming else 1.0)
        across = inwards * signal.arm_m
        meshes.append(_signal_mesh(signal.height_m, across).moved(foot))
        if signal.intensity_cd > 0:
            lens = np.array([HOUSING_M[0] / 2 + 0.02, across, signal.height_m + LENS_HEIGHTS_M[signal.lit]])
            pose = foot @ Pose(lens, rotation())
            lights.append(FixedLight(pose, "signal", signal.intensity_cd, (LENS_M, LENS_M)))
    return meshes, lights


def build_settlements(
    settlements: tuple[Settlement, ...], terrain: Terrain, rng: np.random.Generator
) -> list[FixedLight]:
    """The lamps of places in the distance, which face us; most are low and faint, and a few are much brighter."""
    road = terrain.road
    lights = []
    for settlement in settlements:
        middle = np.array([settlement.s_m, SIDE_SIGNS[settlement.side] * (road.half_width_m + settlement.offset_m)])
        for s_m, t_m in middle + rng.uniform(-0.5, 0.5, (settlement.num_lamps, 2)) * settlement.size_m:
            known_m = min(float(s_m), road.length_m)
            heading = float(road.heading_rad(known_m))
            foot = road.points(known_m, t_m) + (s_m - known_m) * np.array([np.cos(heading), np.sin(heading), 0.0])
            height = FAR_LAMP_M + settlement.height_m * rng.beta(1.0, 3.0)
            intensity_cd = settlement.intensity_cd * float(np.exp(FAR_LAMP_SPREAD * rng.normal()))
            pose = Pose(foot + np.array([0.0, 0.0, height]), rotation(heading + np.pi))
            lights.append(FixedLight(pose, "far_lamp", intensity_cd, FAR_LAMP_SIZE_M, reach_m=0.0))
    return lights


def _print(size_m: tuple[float, float]) -> list[Mesh]:
    """Lines of large letters on a billboard, as bars."""
    width, height = size_m
    lines = ((0.0, 0.3, 0.8, 0.1), (-0.14, 0.14, 0.52, 0.06), (0.1, -0.38, 0.6, 0.08))
    return [
        box((0.02, y * width, z * height), (0.02, length * width, size * height), material_number("sign_black"))
        for y, z, length, size in lines
    ]


def _signal_mesh(height_m: float, across_m: float) -> Mesh:
    """Mast, arm and housing; x towards the reader, the foot of the mast at the origin."""
    depth, _, size = HOUSING_M
    top = height_m + size / 2
    behind = -depth / 2 - 0.06
    starts = np.array([[behind, 0.0, -BURIED_M], [behind, 0.0, top]])
    ends = np.array([[behind, 0.0, top], [behind, across_m, top + 0.1]])
    masts = tubes(starts, ends, np.array([0.07, 0.06]), np.array([0.06, 0.04]), 10, material_number("pole"))
    housing = box((0.0, across_m, top), HOUSING_M, material_number("sign_black"))
    return joined([masts, housing])


BARRIER_PROFILE_M = np.array([[-0.30, -0.05], [-0.29, 0.07], [-0.16, 0.26], [-0.09, 0.90], [0.09, 0.90]])
"""Offset and height of the left half and the top of a step barrier of 0.9 m, similar to EN 1317's common shapes."""

STEP_M = 1.0
RAIL_APART_M = 0.45
"""Distance of either rail's face from the centre line."""

REFLECTOR_SPACING_M = 50.0
REFLECTOR_SIZE_M = (0.02, 0.09, 0.18)


def build_median(terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """The median of the terrain's road, in the world; nothing for a road without one."""
    road = terrain.road
    span = (0.0, road.length_m)
    if road.spec.median == "barrier":
        return [_barrier(terrain, span), _reflectors(terrain, road.spec.barrier_m + 0.03)]
    if road.spec.median == "rails":
        wobble = Noise(rng, 6.0)
        rails = [
            rail_run(terrain, span, -side * RAIL_APART_M, side, post_spacing_m=4.0, wobble=wobble)
            for side in (1.0, -1.0)
        ]
        return [*rails[0], *rails[1], _reflectors(terrain, 0.85)]
    return []


def _barrier(terrain: Terrain, span: Span) -> Mesh:
    right = BARRIER_PROFILE_M[:-1][::-1] * [-1.0, 1.0]
    profile = np.concatenate([BARRIER_PROFILE_M[:-1], right])
    s = np.arange(span[0], span[1] + STEP_M / 2, STEP_M)
    heights = np.where(profile[:, 1] > 0.5, terrain.road.spec.barrier_m, profile[:, 1])
    points = terrain.road.points(s[:, None], profile[:, 0], heights)
    return strip(points, material_number("concrete"))


def _reflectors(terrain: Terrain, height_m: float) -> Mesh:
    """Reflectors to both directions on top of the median."""
    s = np.arange(0.5 * REFLECTOR_SPACING_M, terrain.road.length_m, REFLECTOR_SPACING_M)
    plate = box((0.0, 0.0, 0.0), REFLECTOR_SIZE_M, material_number("reflector"))
    feet = terrain.road.points(s, 0.0, height_m + REFLECTOR_SIZE_M[2] / 2)
    return instanced(plate, feet, yaw_rotations(terrain.road.heading_rad(s)))


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
