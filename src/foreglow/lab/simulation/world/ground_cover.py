"""Cover of the ground beside a road: gravel at its edge, grass or soil, pavements and snow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.surroundings import Verge
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, grid_faces, joined
from foreglow.lab.simulation.world.noise import Noise, smooth_step

PAVEMENT_M, KERB_M = 2.2, 0.12
"""Width and height of a pavement."""

KERB_WIDTH_M = 0.16
GRAVEL_M = 0.3
SNOW_M = 0.22
"""Height of drifts along a road whose verge is completely under snow."""

RAGGED = 0.3
"""Raggedness of the snow's borders: amplitude of the fine noise in `snow_score`."""

NUM_PARTS = 3
"""Number of parts, along each axis, that a cell is divided into where two covers meet."""

REFINED_REACH_M = 18.0


@dataclass(frozen=True, slots=True, eq=False)
class GroundCover:
    """The covers of both verges.

    Attributes:
        left: The verge to the left.
        right: The verge to the right.
        half_width_m: Half the width of the carriageway.
        patches: Coarse and fine noise of where snow lies.
        drifts: Noise of its height along the road.
        frays: Noise of the edge of the gravel.
        snow_limits: Values that `snow_score` must exceed, left and right, for the wanted share of snow.
        grass_m: Half the width of a strip of grass between the directions.
    """

    left: Verge
    right: Verge
    half_width_m: float
    patches: tuple[Noise, Noise]
    drifts: Noise
    frays: Noise
    snow_limits: tuple[float, float]
    grass_m: float = 0.0

    def materials(self, s: Floats, t: Floats) -> NDArray[np.uint8]:
        """Material numbers at points of any shape, carriageway included."""
        out = np.abs(t) - self.half_width_m
        kinds = np.full(np.shape(s), material_number("road"), np.uint8)
        kinds[np.abs(t) < self.grass_m] = material_number("grass_ground")
        for is_side, verge, limit in zip((t > 0, t <= 0), (self.left, self.right), self.snow_limits, strict=True):
            beyond = is_side & (out > 0)
            if verge.ground == "pavement":
                kinds[beyond] = material_number("grass_ground")
                kinds[beyond & (out < PAVEMENT_M)] = material_number("pavement")
                kinds[beyond & (out < KERB_WIDTH_M)] = material_number("kerb")
            else:
                kinds[beyond] = material_number(verge.ground)
                kinds[beyond & (out < GRAVEL_M + 0.12 * self.frays(s, t))] = material_number("gravel")
            if verge.snow > 0:
                kinds[beyond & (snow_score(self.patches, s, t, out) > limit)] = material_number("snow")
        return kinds

    def snow_depth_m(self, s: Floats, t: Floats, beyond: Floats, verge: Verge) -> Floats:
        """Height of the low ridge of snow that a plough leaves at the edge; `beyond` is the distance from the edge."""
        if verge.snow == 0:
            return np.zeros(np.shape(beyond))
        ridge = smooth_step((beyond - 0.1) / 0.7) * (1 - 0.7 * smooth_step((beyond - 1.0) / 1.6))
        return SNOW_M * verge.snow * ridge * np.clip(0.8 + 0.5 * self.drifts(s, t), 0.1, 2.0)


def ground_cover(
    left: Verge, right: Verge, half_width_m: float, length_m: float, rng: np.random.Generator, grass_m: float = 0.0
) -> GroundCover:
    """Draws the covers; the limits for snow are quantiles of the score over the verges along the road."""
    patches = Noise(rng, 5.0, 4), Noise(rng, 0.7, 2)
    drifts, frays = Noise(rng, 7.0), Noise(rng, 2.2)
    s, out = np.meshgrid(np.arange(0.0, length_m, 1.5), np.arange(0.1, 15.0, 0.4))
    limits = [
        float(np.quantile(snow_score(patches, s, side * (half_width_m + out), out), 1 - verge.snow))
        for side, verge in ((1, left), (-1, right))
    ]
    # With a share of 1, everything is under snow.
    limits = [-np.inf if verge.snow == 1 else limit for verge, limit in zip((left, right), limits, strict=True)]
    return GroundCover(left, right, half_width_m, patches, drifts, frays, (limits[0], limits[1]), grass_m)


def snow_score(patches: tuple[Noise, Noise], s: Floats, t: Floats, out: Floats) -> Floats:
    """Where snow lies longest: the higher the score, the longer; highest in the drifts at the edge."""
    drift = 0.8 * smooth_step(out / 0.5) * (1 - smooth_step((out - 1.2) / 2.5))
    return patches[0](s, t) + RAGGED * patches[1](s, t) + drift


def covered(mesh: Mesh, shape: tuple[int, int], cover: GroundCover) -> Mesh:
    """A grid of `shape` rows and columns with its covers; cells are subdivided where two covers meet near the road."""
    rows, columns = shape
    coordinates = mesh.coordinates_m.astype(np.float64).reshape(rows, columns, 2)
    middles = (coordinates[:-1, :-1] + coordinates[1:, 1:]) / 2
    kinds = cover.materials(middles[..., 0], middles[..., 1])
    differs = np.zeros(kinds.shape, bool)
    for axis in (0, 1):
        change = np.diff(kinds.astype(np.int64), axis=axis) != 0
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        differs |= np.pad(change, before) | np.pad(change, after)
    out = np.abs(middles[..., 1]) - cover.half_width_m
    is_cut = (differs & (out > 0) & (out < REFINED_REACH_M)).ravel()
    whole = np.repeat(~is_cut, 2)
    rest = replace(mesh, faces=mesh.faces[whole], materials=np.repeat(kinds.ravel(), 2)[whole])
    return joined([rest, _cut(mesh, mesh.faces[::2][is_cut], mesh.faces[1::2][is_cut], cover)])


def _cut(mesh: Mesh, first: NDArray[np.uint32], second: NDArray[np.uint32], cover: GroundCover) -> Mesh:
    """Cells, each given as two triangles, divided into NUM_PARTS x NUM_PARTS smaller ones with their own covers."""
    corners = np.stack([first[:, 0], second[:, 2], first[:, 1], first[:, 2]], -1)
    steps = np.linspace(0.0, 1.0, NUM_PARTS + 1)
    u, v = np.meshgrid(steps, steps, indexing="ij")
    middles = mesh.coordinates_m[corners].mean(1)[:, None].astype(np.float64)
    # Vertices within a cell are moved a little, or borders would look like the teeth of a saw.
    is_inside = ((u > 0) & (u < 1) & (v > 0) & (v < 1)).ravel()
    number = np.arange(u.size) * 0.37
    aside = [
        is_inside * np.clip(0.3 * cover.frays(shift + 90 * middles[..., 0] + number, 90 * middles[..., 1]), -0.24, 0.24)
        for shift in (0.0, 31.0)
    ]
    u, v = u.ravel() + aside[0] / NUM_PARTS, v.ravel() + aside[1] / NUM_PARTS
    weights = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], -1)
    points, normals, coordinates = (
        np.matmul(weights, array[corners].astype(np.float64))
        for array in (mesh.vertices_m, mesh.normals, mesh.coordinates_m)
    )
    faces = grid_faces(NUM_PARTS + 1, NUM_PARTS + 1)
    centres = coordinates[:, faces].mean(2)
    kinds = cover.materials(centres[..., 0], centres[..., 1])
    starts = (np.arange(len(corners), dtype=np.uint32) * np.uint32(u.shape[-1]))[:, None, None]
    lengths = np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    return Mesh(
        points.reshape(-1, 3).astype(np.float32),
        (faces[None] + starts).reshape(-1, 3).astype(np.uint32),
        kinds.ravel(),
        (normals / lengths).reshape(-1, 3).astype(np.float32),
        coordinates.reshape(-1, 2).astype(np.float32),
    )
