"""Trees and bushes as prototypes in three levels of detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined, surface
from foreglow.lab.simulation.world.primitives import tubes

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
