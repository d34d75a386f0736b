"""Ray casting: the fixed world is in one tree, all moving bodies are in another that is built for every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.light.lamps import PlacedBody
from foreglow.lab.simulation.light.llvm import dr, mi
from foreglow.lab.simulation.world.mesh import Mesh, joined

RECORD = 16
"""Floats in a triangle's record: three normals, three pairs of coordinates, and its code. One cache line."""

CODES_PER_BODY = 256
"""A triangle's code is its material plus this times (number of its body + 1): a whole number that a float can hold."""

END_GAP_M = 0.06
"""Shadow rays end this far before the lamp, so that its own housing does not block them."""

START_GAP_M = 3e-3
"""Shadow rays start this far from the surface: more than the error of single precision a kilometre from the origin."""

MAX_SELF_HITS = 24
"""Largest number of surfaces of an ignored body that a ray passes."""

Number = Any
"""Dr.Jit values, one per ray; their types depend on the variant and exist only once it is set."""


@dataclass
class Hit:
    """The hits of rays; each field has one value per ray.

    Attributes:
        is_hit: Whether the ray hits anything.
        distance_m: Distance along the ray; 0 without a hit.
        position: Position in the world, metres.
        normal: Interpolated normal, unit length, on the ray's side.
        coordinates_m: Surface coordinates, as in `Mesh`.
        material: Number of the material.
        body: Number of the moving body; -1 for the fixed world.
    """

    is_hit: Number
    distance_m: Number
    position: Number
    normal: Number
    coordinates_m: Number
    material: Number
    body: Number


class Tree:
    """A tree of triangles for ray casting."""

    def __init__(self, mesh: Mesh, bodies: NDArray[np.intp] | None = None) -> None:
        """Builds the tree; `bodies`, shape (F,), are numbers of moving bodies, None for the fixed world."""
        if not len(mesh.faces):
            mesh, bodies = _nowhere(), None
        shape = mi.Mesh("mesh", len(mesh.vertices_m), len(mesh.faces))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(mesh.vertices_m, np.float32).ravel())
        parameters["faces"] = mi.UInt32(np.ascontiguousarray(mesh.faces, np.uint32).ravel())
        parameters.update()
        self.scene = mi.load_dict({"type": "scene", "mesh": shape})
        self.records = mi.Float(_records(mesh, bodies).ravel())
        dr.eval(self.records)

    def first(self, origin: Number, direction: Number, limit_m: Number, is_active: Number = True) -> Number:
        """The first triangle along each ray, as Mitsuba's preliminary intersection."""
        ray = mi.Ray3f(origin, direction, limit_m, 0.0, [])
        return self.scene.ray_intersect_preliminary(ray, coherent=True, active=mi.Bool(is_active))

    def record(self, found: Number, is_active: Number) -> tuple[Number, Number, Number]:
        """Interpolated normal (not normalised), surface coordinates and code of the triangles found."""
        start = mi.UInt32(found.prim_index) * (RECORD // 4)
        a, b, c, d = (dr.gather(mi.Vector4f, self.records, start + part, is_active) for part in range(4))
        second, third = found.prim_uv.x, found.prim_uv.y
        first = 1.0 - second - third
        normal = (
            mi.Vector3f(a.x, a.y, a.z) * first
            + mi.Vector3f(a.w, b.x, b.y) * second
            + mi.Vector3f(b.z, b.w, c.x) * third
        )
        coordinates = mi.Point2f(c.y, c.z) * first + mi.Point2f(c.w, d.x) * second + mi.Point2f(d.y, d.z) * third
        return normal, coordinates, d.w


class Solids:
    """The fixed world, and the bodies that move through it."""

    def __init__(self, static: Mesh, bodies: Mapping[str, Mesh]) -> None:
        """Builds the tree of the fixed world; `bodies` are in the vehicles' frames, by kind and paint."""
        self._static = Tree(static)
        self._bodies = dict(bodies)
        self._placed: tuple[PlacedBody, ...] = ()
        self._moving = Tree(joined([]))
        self._face_starts = np.zeros(1, np.intp)

    def place(self, bodies: Sequence[PlacedBody]) -> None:
        """Moves the bodies to their current poses.

        Raises:
            ValueError: If there is no mesh for one of them.
        """
        if len(bodies) == len(self._placed) and all(a is b for a, b in zip(bodies, self._placed, strict=True)):
            return
        moved = [self._mesh(body).moved(body.world_from_vehicle) for body in bodies]
        counts = [len(mesh.faces) for mesh in moved]
        self._moving = Tree(joined(moved), np.repeat(np.arange(len(moved)), counts))
        self._face_starts = np.cumsum([0, *counts])
        self._placed = tuple(bodies)

    def _mesh(self, body: PlacedBody) -> Mesh:
        if body.mesh_name not in self._bodies:
            raise ValueError(f"bodies: expected one of {', '.join(self._bodies)}, got {body.mesh_name!r}")
        return self._bodies[body.mesh_name]

    def hit(self, origin: Number, direction: Number) -> Hit:
        """The first hit of each ray."""
        fixed = self._static.first(origin, direction, mi.Float(dr.largest(mi.Float)))
        moving = self._moving.first(origin, direction, fixed.t)
        is_moving = moving.is_valid()
        is_fixed = fixed.is_valid() & ~is_moving
        fixed_record = self._static.record(fixed, is_fixed)
        moving_record = self._moving.record(moving, is_moving)
        normal, coordinates, code = (
            dr.select(is_moving, a, b) for a, b in zip(moving_record, fixed_record, strict=True)
        )
        normal = dr.normalize(normal + mi.Vector3f(0, 0, 1e-9))
        normal = dr.select(dr.dot(normal, direction) > 0, -normal, normal)
        number = mi.UInt32(code)
        is_hit = is_fixed | is_moving
        distance = dr.select(is_hit, dr.select(is_moving, moving.t, fixed.t), 0.0)
        return Hit(
            is_hit,
            distance,
            origin + direction * distance,
            normal,
            coordinates,
            number % CODES_PER_BODY,
            mi.Int32(number // CODES_PER_BODY) - 1,
        )

    def is_blocked(self, origin: Number, direction: Number, limit_m: Number, is_active: Number) -> Number:
        """Whether anything blocks each ray before `limit_m`."""
        ray = mi.Ray3f(origin, direction, limit_m, 0.0, [])
        by_fixed = self._static.scene.ray_test(ray, coherent=True, active=is_active)
        return by_fixed | self._moving.scene.ray_test(ray, coherent=True, active=is_active & ~by_fixed)

    def is_free(
        self, origins: NDArray[np.floating], target: NDArray[np.floating], ignore_body: int | None
    ) -> NDArray[np.bool_]:
        """Whether each of `origins`, shape (N, 3), sees `target`, shape (3,); shape (N,)."""
        if not len(origins):
            return np.zeros(0, bool)
        ways = np.asarray(target, np.float64) - np.asarray(origins, np.float64)
        lengths = np.linalg.norm(ways, axis=1)
        ways /= np.maximum(lengths, 1e-9)[:, None]
        start = mi.Point3f(np.ascontiguousarray((origins + ways * END_GAP_M).T, np.float32))
        direction = mi.Vector3f(np.ascontiguousarray(ways.T, np.float32))
        limit = mi.Float(np.maximum(lengths - 2 * END_GAP_M, 0.0).astype(np.float32))
        ray = mi.Ray3f(start, direction, limit, 0.0, [])
        free = ~self._static.scene.ray_test(ray)
        first, last = (0, 0) if ignore_body is None else self._face_starts[ignore_body : ignore_body + 2]
        is_ignored_face = (dr.opaque(mi.UInt32, int(first)), dr.opaque(mi.UInt32, int(last)))

        def passes(number: Number, distance: Number, is_open: Number, is_clear: Number) -> Any:
            found = self._moving.first(start + direction * distance, direction, limit - distance, is_open)
            is_own = (
                found.is_valid() & (found.prim_index >= is_ignored_face[0]) & (found.prim_index < is_ignored_face[1])
            )
            is_clear &= ~is_open | is_own | ~found.is_valid()
            return number + 1, dr.select(is_own, distance + found.t + 1e-3, distance), is_open & is_own, is_clear

        _, _, _, is_clear = dr.while_loop(
            (mi.UInt32(0), mi.Float(0.0), mi.Bool(free), mi.Bool(free)),
            lambda number, _distance, is_open, _clear: is_open & (number < MAX_SELF_HITS),
            passes,
        )
        return np.array(free & is_clear, bool).reshape(-1)


def _records(mesh: Mesh, bodies: NDArray[np.intp] | None) -> NDArray[np.float32]:
    """The data of each triangle for shading, shape (F, RECORD), float32."""
    records = np.empty((len(mesh.faces), RECORD), np.float32)
    records[:, :9] = mesh.normals[mesh.faces].reshape(-1, 9)
    records[:, 9:15] = mesh.coordinates_m[mesh.faces].reshape(-1, 6)
    records[:, 15] = mesh.materials if bodies is None else mesh.materials + CODES_PER_BODY * (bodies + 1.0)
    return records


def _nowhere() -> Mesh:
    """One tiny triangle far below everything, since a tree cannot be empty."""
    corners = np.array([[0, 0, -1e5], [1e-3, 0, -1e5], [0, 1e-3, -1e5]], np.float32)
    faces = np.arange(3, dtype=np.uint32)[None]
    return Mesh(corners, faces, np.zeros(1, np.uint8), np.zeros((3, 3), np.float32), np.zeros((3, 2), np.float32))
