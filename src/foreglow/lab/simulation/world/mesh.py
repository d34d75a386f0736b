"""Triangle meshes as plain arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Pose


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
