"""The ground: the carriageway, the verges with ditches, banks and snow, and the side roads."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.surroundings import Span, Verge
from foreglow.lab.simulation.world.ground_cover import KERB_M, PAVEMENT_M, covered, ground_cover
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined, strip
from foreglow.lab.simulation.world.noise import Noise, smooth_step
from foreglow.lab.simulation.world.road import Road

OUTS_M = np.array(
    [0.04, 0.16, 0.35, 0.6, 0.9, 1.25, 1.65, 2.2, 2.8, 3.4, 4.1, 5, 6, 7.2, 8.6, 10.5, 13, 16, 20, 25, 32, 41, 53, 70]
)
"""Distances of the columns of the mesh from the edge of the carriageway."""

LANE_STEP_M = 0.5
FINE_STEP_M, COARSE_STEP_M = 0.5, 2.0
LEAD_M = 60.0
"""Length of the ground before and after the road."""

SHOULDER_SLOPE = 0.04
DITCH_WIDTH_M = 1.5
BRANCH_T_M = 1000.0
"""On side road number n, the second surface coordinate is its own offset plus (n + 1) times this, so that no lane
marking or wheel track of the main road appears there."""

CORRIDOR_M = 6.0
"""Width over which the ground beside a side road adapts to the height of that road."""

_FLARE_M = 4.0


class Terrain:
    """The ground along a road; heights are the world's."""

    def __init__(
        self,
        road: Road,
        branches: tuple[Road, ...],
        verges: tuple[Verge, Verge],
        rng: np.random.Generator,
        fine_m: Span = (-np.inf, np.inf),
    ) -> None:
        """Draws the unevenness; `verges` are left and right; within `fine_m`, the mesh has short rows."""
        self.road, self.branches = road, branches
        self._left, self._right = verges
        self._rolling, self._rough = Noise(rng, 28.0), Noise(rng, 2.2)
        grass_m = road.spec.median_m / 2 if road.spec.median == "rails" else 0.0
        self._cover = ground_cover(*verges, road.half_width_m, road.length_m, rng, grass_m)
        self.fine_m = fine_m

    def verge(self, t_m: float) -> Verge:
        """The specification of the side on which the offset lies."""
        return self._left if t_m > 0 else self._right

    def ground_height_m(self, s_m: ArrayLike, t_m: ArrayLike) -> Floats:
        """Height of the ground in the world, of the shape of `s_m` and `t_m`: on the road, verges and side roads."""
        s, t = np.broadcast_arrays(np.asarray(s_m, np.float64), np.asarray(t_m, np.float64))
        edge = self.road.elevation_m(s) + self.road.cross_height_m(s, t)
        out = np.abs(t) - self.road.half_width_m
        height = edge + np.where(t > 0, self._rise_m(s, out, self._left, t), self._rise_m(s, out, self._right, t))
        for branch in self.branches:
            target, weight = self._branch_ground(branch, s, t, edge, out)
            height = height + weight * (target - height)
        return np.asarray(height)

    def points(self, s_m: ArrayLike, t_m: ArrayLike, height_m: ArrayLike = 0.0) -> Floats:
        """Points in the world, shape (..., 3), `height_m` above the ground."""
        points = self.road.points(s_m, t_m)
        points[..., 2] = self.ground_height_m(s_m, t_m) + np.asarray(height_m, np.float64)
        return points

    def is_clear(self, s_m: ArrayLike, t_m: ArrayLike, margin_m: float = 0.5) -> NDArray[np.bool_]:
        """Whether something may stand there: `margin_m` off every carriageway, and nearest to this part of the road."""
        s, t = np.broadcast_arrays(np.asarray(s_m, np.float64), np.asarray(t_m, np.float64))
        points = self.road.points(s, t)
        distances = self.road.distances_m(points)
        is_clear = (distances > np.abs(t) - 0.5) & (np.abs(t) > self.road.half_width_m + margin_m)
        for branch in self.branches:
            along, across = branch.places_m(points)
            width = self._branch_half_width_m(branch, np.abs(t) - self.road.half_width_m) + margin_m
            is_clear &= (np.abs(across) > width) | (along < 0) | (along > branch.length_m)
        return np.asarray(is_clear)

    def mesh(self) -> Mesh:
        """The main road with its verges, and the side roads; coordinates are s and t (see `BRANCH_T_M`)."""
        return joined([self._main_mesh(), *(self._branch_mesh(number) for number in range(len(self.branches)))])

    def _rise_m(self, s: Floats, out: Floats, verge: Verge, t: Floats) -> Floats:
        """Height of a verge above the edge of the carriageway; 0 on the carriageway."""
        beyond = np.maximum(out, 0.0)
        is_paved = verge.ground == "pavement"
        start = max(verge.bank_offset_m, PAVEMENT_M if is_paved else 0.3)
        if is_paved:
            # A gentle fall towards the kerb, as pavements have.
            rise = KERB_M * smooth_step((beyond - 0.03) / 0.12) + 0.02 * np.minimum(beyond, start)
            ditch = 0.0
        else:
            rise = -SHOULDER_SLOPE * np.minimum(beyond, start)
            ditch = verge.ditch_m
            start = max(start, 0.4 + DITCH_WIDTH_M) if ditch else start
        middle = start - DITCH_WIDTH_M / 2
        rise = rise - ditch * (1 - smooth_step(np.abs(beyond - middle) / (DITCH_WIDTH_M / 2)))
        width = float(np.clip(1.8 * abs(verge.bank_m), 2.5, 9.0))
        rise = rise + verge.bank_m * smooth_step((beyond - start) / width)
        wild = np.clip((beyond - start) / 25.0, 0.0, 1.5)
        rise = rise + wild * 0.9 * self._rolling(s, t)
        uneven = smooth_step((beyond - (PAVEMENT_M if is_paved else 0.2)) / 1.2)
        rise = rise + (0.03 + 0.02 * abs(verge.bank_m) ** 0.5) * uneven * self._rough(s, t)
        return np.asarray(rise + self._cover.snow_depth_m(s, t, beyond, verge))

    def _branch_half_width_m(self, branch: Road, out: Floats) -> Floats:
        """Half width of a side road at the distance `out` from the main road's edge; it widens at its mouth."""
        return np.asarray(branch.half_width_m + 3.0 * (1 - smooth_step(np.maximum(out, 0.0) / _FLARE_M)) ** 2)

    def _branch_ground(self, branch: Road, s: Floats, t: Floats, edge: Floats, out: Floats) -> tuple[Floats, Floats]:
        """Height of the ground beside a side road, and the weight of that height, 0..1."""
        along, across = branch.places_m(self.road.points(s, t))
        beside = np.abs(across) - self._branch_half_width_m(branch, out) - 0.8
        counts = (1 - smooth_step(beside / CORRIDOR_M)) * smooth_step((along + 2.0) / 2.0)
        counts = counts * (1 - smooth_step((along - branch.length_m) / 15.0)) * (out > 0)
        own = branch.elevation_m(along) + branch.cross_height_m(along, across)
        return edge + (own - edge) * smooth_step(out / 8.0), counts

    def _main_mesh(self) -> Mesh:
        half = self.road.half_width_m
        lanes = np.linspace(-half, half, 2 * round(half / LANE_STEP_M) + 1)
        s = self._rows_m
        outs = self._columns_m(s)
        t = np.concatenate(
            [-half - outs[1][:, ::-1], np.broadcast_to(lanes, (len(s), len(lanes))), half + outs[0]], axis=1
        )
        arc_lengths = np.broadcast_to(s[:, None], t.shape)
        points = self.points(arc_lengths, t)
        points[..., 2] -= self._sunk_m(points, np.abs(t) - half)
        mesh = strip(points, 0, coordinates_m=np.stack([arc_lengths, t], -1))
        return covered(mesh, t.shape, self._cover)

    @cached_property
    def _rows_m(self) -> Floats:
        start, end = -LEAD_M, self.road.length_m + LEAD_M
        fine = np.clip(self.fine_m, start, end)
        parts = [
            np.arange(start, fine[0], COARSE_STEP_M),
            np.arange(fine[0], fine[1], FINE_STEP_M),
            np.arange(fine[1], end + COARSE_STEP_M, COARSE_STEP_M),
        ]
        return np.concatenate(parts)

    def _columns_m(self, s: Floats) -> list[Floats]:
        """Distances of the columns from the edge, for every row, shape (rows, columns), left and right.

        Inside a tight bend, the columns are moved together, so that they end where another part of the road is nearer.
        """
        found = []
        for side in (1, -1):
            t = side * (self.road.half_width_m + OUTS_M)
            distances = self.road.distances_m(self.road.points(s[:, None], t))
            is_nearest = np.logical_and.accumulate(distances > np.abs(t) - 0.4, axis=1)
            last = np.where(is_nearest.all(1), 2 * OUTS_M[-1], OUTS_M[np.maximum(is_nearest.sum(1) - 1, 0)])
            limit = gaussian_filter1d(minimum_filter1d(last, 9), 3.0)[:, None]
            share = OUTS_M / limit
            eased = np.where(share < 0.6, share, 0.6 + 0.4 * (1 - np.exp(-(np.maximum(share, 0.6) - 0.6) / 0.4)))
            found.append(limit * eased)
        return found

    def _sunk_m(self, points: Floats, out: Floats) -> Floats:
        """Depth by which the ground is lowered to stay below the surface of the side roads."""
        sunk = np.zeros(out.shape)
        for branch in self.branches:
            along, across = branch.places_m(points)
            inside = self._branch_half_width_m(branch, out) + 0.2 - np.abs(across)
            is_below = (along > 0) & (along < branch.length_m) & (out > 0.1)
            sunk = np.maximum(sunk, np.where(is_below, 0.25 * smooth_step(inside / 0.8), 0.0))
        return sunk

    def _branch_mesh(self, number: int) -> Mesh:
        """The surface of a side road, and the ground beside it far from the main road."""
        branch = self.branches[number]
        far = np.arange(60.0, branch.length_m, COARSE_STEP_M)
        along = np.concatenate([np.linspace(0.0, 12.0, 25), np.arange(13.0, min(60.0, branch.length_m)), far])
        across = np.concatenate([[-1.08], np.linspace(-1.0, 1.0, 15), [1.08]])
        offsets = across * branch.half_width_m
        _, t = self.road.places_m(branch.points(10.0, 0.0))
        # Each column starts just inside the main road's edge.
        starts = self._mouth_m(branch, across * float(self._branch_half_width_m(branch, np.zeros(1))[0]), float(t))
        shifted = starts + along[:, None] * (branch.length_m - starts) / branch.length_m
        _, t = self.road.places_m(branch.points(shifted, offsets))
        width = self._branch_half_width_m(branch, np.abs(t) - self.road.half_width_m)
        flat = branch.points(shifted, across * width)
        s, t = self.road.places_m(flat)
        out = np.abs(t) - self.road.half_width_m
        flat[..., 2] = self.ground_height_m(s, t) + 0.03 * smooth_step(out / 1.5) - 0.01 * (out < 0)
        flat[:, [0, -1], 2] -= 0.2 * smooth_step(out[:, [0, -1]] / 1.0)
        far_away = np.abs(t) > OUTS_M[-1]
        own = branch.elevation_m(shifted) + branch.cross_height_m(shifted, across * width)
        flat[..., 2] = np.where(far_away, own + 0.03, flat[..., 2])
        coordinates = np.stack([shifted, across * width + (number + 1) * BRANCH_T_M], -1)
        return joined([strip(flat, material_number("road"), coordinates_m=coordinates), *self._far_verges(number)])

    def _mouth_m(self, branch: Road, across: Floats, side: float) -> Floats:
        """Arc lengths along the side road at which lines parallel to it are 0.4 m inside the main road's edge."""
        along = np.arange(0.0, 60.0, 0.1)[:, None]
        _, t = self.road.places_m(branch.points(along, across))
        is_out = np.sign(side) * t > self.road.half_width_m - 0.4
        return np.asarray(np.where(is_out.any(0), along[np.argmax(is_out, 0), 0], 0.0))

    def _far_verges(self, number: int) -> list[Mesh]:
        branch, half = self.branches[number], self.branches[number].half_width_m
        start = OUTS_M[-1] * 0.7
        if branch.length_m < start + 10:
            return []
        along = np.arange(start, branch.length_m + 10.0, COARSE_STEP_M)[:, None]
        parts = []
        for side in (1.0, -1.0):
            across = side * (half + np.array([0.0, 0.6, 2.0, 5.0, 10.0, 20.0]))
            points = branch.points(along, across)
            points[..., 2] += 0.1 * self._rough(along, across) - 0.15
            shift = np.broadcast_to(across + (number + 1) * BRANCH_T_M, points.shape[:2])
            coordinates = np.stack([np.broadcast_to(along, points.shape[:2]), shift], -1)
            parts.append(strip(points, material_number("grass_ground"), coordinates_m=coordinates))
        return parts
