"""Triangle meshes as plain arrays, and the shapes that the world is made of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles, each with a material.

    Attributes:
        vertices_m: Shape (V, 3), float32.
        faces: Shape (F, 3), uint32, indices into `vertices_m`.
        materials: Shape (F,), uint8, indices into `materials.MATERIALS`.
        normals: Shape (V, 3), float32, unit length; either side may be the outside.
        coordinates_m: Shape (V, 2), float32: surface coordinates for textures and markings; on the ground, the arc
            length along the road and the offset to the left of its centre line.
    """

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.uint32]
    materials: NDArray[np.uint8]
    normals: NDArray[np.float32]
    coordinates_m: NDArray[np.float32]

    def moved(self, pose: Pose) -> Mesh:
        """The mesh of a body, in the outer frame of its pose."""
        return Mesh(
            pose.to_outer(self.vertices_m).astype(np.float32),
            self.faces,
            self.materials,
            (self.normals @ pose.rotation.T).astype(np.float32),
            self.coordinates_m,
        )


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """All of `meshes` as one; without meshes, a mesh without triangles."""
    parts = list(meshes)
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    if not parts:
        nothing = np.zeros((0, 3), np.float32)
        return Mesh(
            nothing, nothing.astype(np.uint32), np.zeros(0, np.uint8), nothing.copy(), np.zeros((0, 2), np.float32)
        )
    return Mesh(
        np.concatenate([part.vertices_m for part in parts]),
        np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.materials for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.coordinates_m for part in parts]),
    )


def surface(
    vertices_m: NDArray[np.floating],
    faces: NDArray[np.integer],
    material: int,
    *,
    normals: NDArray[np.floating] | None = None,
    coordinates_m: NDArray[np.floating] | None = None,
) -> Mesh:
    """A mesh of one material; by default, normals are averaged over the faces around each vertex."""
    vertices = np.asarray(vertices_m, np.float32).reshape(-1, 3)
    triangles = np.asarray(faces, np.uint32).reshape(-1, 3)
    return Mesh(
        vertices,
        triangles,
        np.full(len(triangles), material, np.uint8),
        smooth_normals(vertices, triangles) if normals is None else np.asarray(normals, np.float32).reshape(-1, 3),
        np.zeros((len(vertices), 2), np.float32)
        if coordinates_m is None
        else np.asarray(coordinates_m, np.float32).reshape(-1, 2),
    )


def smooth_normals(vertices_m: NDArray[np.float32], faces: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Unit normals of the vertices, shape (V, 3): the mean over the faces around each, weighted with their areas."""
    corners = vertices_m[faces].astype(np.float64)
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack(
        [
            sum(np.bincount(faces[:, corner], face_normals[:, axis], len(vertices_m)) for corner in range(3))
            for axis in range(3)
        ],
        -1,
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(np.where(lengths > 0, sums / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0]), np.float32)


_BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def grid_faces(num_rows: int, num_columns: int, is_closed: bool = False) -> NDArray[np.uint32]:
    """Two consecutive triangles for each cell between the vertices of a grid, row by row; shape (F, 3).

    A closed grid also has cells between the last column and the first.
    """
    first = np.arange(num_rows * num_columns, dtype=np.uint32).reshape(num_rows, num_columns)
    if is_closed:
        first = np.concatenate([first, first[:, :1]], 1)
    quads = np.stack([first[:-1, :-1], first[1:, :-1], first[1:, 1:], first[:-1, 1:]], -1).reshape(-1, 4)
    return triangulated(quads)


def triangulated(quads: NDArray[Any]) -> NDArray[Any]:
    """Two consecutive triangles for each quadrilateral; from corners of shape (Q, 4) to shape (2 Q, 3)."""
    return np.asarray(quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def strip(points_m: Floats, material: int, *, coordinates_m: Floats | None = None, is_closed: bool = False) -> Mesh:
    """A smooth surface through a grid of points of shape (rows, columns, 3).

    By default, `coordinates_m`, shape (rows, columns, 2), are the lengths along the first column and row.
    """
    if coordinates_m is None:
        rows = _lengths(points_m[:, 0])
        columns = _lengths(points_m[0])
        coordinates_m = np.stack(np.broadcast_arrays(rows[:, None], columns[None, :]), -1)
    faces = grid_faces(points_m.shape[0], points_m.shape[1], is_closed)
    return surface(points_m, faces, material, coordinates_m=coordinates_m)


def loft(sections_m: Floats, material: int) -> Mesh:
    """A body through closed sections of shape (sections, points, 3), with flat lids at both ends."""
    lids = [polygon(section, material) for section in (sections_m[0], sections_m[-1])]
    return joined([strip(sections_m, material, is_closed=True), *lids])


def polygon(outline_m: Floats, material: int) -> Mesh:
    """A flat convex polygon with corners of shape (N, 3)."""
    num = len(outline_m)
    fan = np.stack([np.zeros(num - 2, np.uint32), np.arange(1, num - 1), np.arange(2, num)], -1)
    return flat(outline_m, fan, material)


def flat(vertices_m: ArrayLike, faces: NDArray[np.integer], material: int) -> Mesh:
    """Triangles with sharp edges: each has its own vertices and its own normal."""
    corners = np.asarray(vertices_m, np.float64)[faces]
    across = _across(corners)
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.where(np.abs(normals[:, 2:]) > 0.7, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    up = along - normals * np.sum(along * normals, 1, keepdims=True)
    coordinates = np.stack([np.sum(corners * axis[:, None], -1) for axis in (np.cross(up, normals), up)], -1)
    return surface(
        corners,
        np.arange(3 * len(faces)).reshape(-1, 3),
        material,
        normals=np.repeat(normals, 3, 0),
        coordinates_m=coordinates,
    )


def faceted(mesh: Mesh) -> Mesh:
    """The same triangles with sharp edges."""
    corners = mesh.vertices_m[mesh.faces].astype(np.float64)
    across = _across(corners)
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.where(lengths > 0, across / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    return Mesh(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3),
        mesh.materials,
        np.repeat(normals, 3, 0).astype(np.float32),
        mesh.coordinates_m[mesh.faces].reshape(-1, 2),
    )


def box(centre_m: ArrayLike, size_m: ArrayLike, material: int) -> Mesh:
    """A box along the axes with sharp edges."""
    vertices = _BOX_CORNERS * np.asarray(size_m, np.float64) + np.asarray(centre_m, np.float64)
    return flat(vertices, triangulated(_BOX_SIDES), material)


def tubes(
    starts_m: Floats, ends_m: Floats, start_radii_m: ArrayLike, end_radii_m: ArrayLike, num_sides: int, material: int
) -> Mesh:
    """Round sticks without lids between points of shape (N, 3), with radii of shape (N,) or one for all."""
    along = ends_m - starts_m
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    aside = np.cross(along, np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angles = np.arange(num_sides) * (2 * np.pi / num_sides)
    outwards = (
        aside[:, None] * np.cos(angles)[:, None] + np.cross(along, aside)[:, None] * np.sin(angles)[:, None]
    )  # (N, sides, 3)
    num = len(starts_m)
    radii = [
        np.broadcast_to(np.asarray(radii, np.float64), (num,))[:, None, None] for radii in (start_radii_m, end_radii_m)
    ]
    ends = [starts_m[:, None] + outwards * radii[0], ends_m[:, None] + outwards * radii[1]]
    around = angles * float(np.mean(radii[0])) if num else angles
    lengths = np.linalg.norm(ends_m - starts_m, axis=1)
    coordinates = np.zeros((num, 2, num_sides, 2))
    coordinates[..., 0] = around
    coordinates[:, 1, :, 1] = lengths[:, None]
    faces = grid_faces(2, num_sides, is_closed=True)
    return surface(
        np.stack(ends, 1),
        faces[None] + (np.arange(num, dtype=np.uint32) * 2 * num_sides)[:, None, None],
        material,
        normals=np.stack([outwards, outwards], 1),
        coordinates_m=coordinates,
    )


def yaw_rotations(yaws_rad: ArrayLike, leans_rad: ArrayLike = 0.0) -> Floats:
    """Rotations of shape (N, 3, 3): a lean towards x, followed by a turn to the left about z."""
    yaws, leans = np.broadcast_arrays(np.atleast_1d(np.asarray(yaws_rad, np.float64)), np.asarray(leans_rad))
    cy, sy, cl, sl = np.cos(yaws), np.sin(yaws), np.cos(leans), np.sin(leans)
    zero = np.zeros_like(cy)
    rows = [[cy * cl, -sy, cy * sl], [sy * cl, cy, sy * sl], [-sl, zero, cl]]
    return np.moveaxis(np.array(rows), -1, 0)


def instanced(prototype: Mesh, positions_m: Floats, rotations: Floats, scales: ArrayLike = 1.0) -> Mesh:
    """Copies of `prototype` at positions of shape (N, 3), with rotations of shape (N, 3, 3).

    Scales are one number, one for each copy, or three for each along the prototype's axes, shape (N, 3); with three,
    only normals along an axis stay correct.
    """
    num, num_vertices = len(positions_m), len(prototype.vertices_m)
    turns = np.swapaxes(rotations, 1, 2).astype(np.float32)
    factors = np.asarray(scales, np.float32)
    factors = np.broadcast_to(factors if factors.ndim == 2 else factors.reshape(-1, 1), (num, 3))[:, None]
    vertices = np.matmul(prototype.vertices_m * factors, turns) + positions_m[:, None].astype(np.float32)
    starts = (np.arange(num, dtype=np.uint32) * np.uint32(num_vertices))[:, None, None]
    # Copies are shifted on the texture, or all would have the same spots.
    shifts = np.arange(num, dtype=np.float32)[:, None, None] * np.float32(3.7)
    return Mesh(
        vertices.reshape(-1, 3),
        (prototype.faces[None] + starts).reshape(-1, 3),
        np.tile(prototype.materials, num),
        np.matmul(prototype.normals, turns).reshape(-1, 3),
        (prototype.coordinates_m[None] + shifts).reshape(-1, 2),
    )


def _across(corners_m: Floats) -> Floats:
    """Vectors across triangles of shape (F, 3, 3), as long as twice their areas."""
    return np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])


def _lengths(points_m: Floats) -> Floats:
    """Arc lengths along points of shape (N, 3), from 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
