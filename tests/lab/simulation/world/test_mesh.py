"""Meshes and the shapes they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.world.mesh import (
    box,
    faceted,
    grid_faces,
    instanced,
    joined,
    loft,
    smooth_normals,
    strip,
    tubes,
    yaw_rotations,
)
from foreglow.lab.simulation.world.noise import Noise, smooth_step
from tests.lab.simulation.small_scenes import face_normals


def test_nothing_joined_is_a_mesh_without_triangles() -> None:
    nothing = joined([])
    assert len(nothing.faces) == len(nothing.vertices_m) == 0
    both = joined([nothing, box((0, 0, 0), (1, 1, 1), 3)])
    assert len(both.faces) == 12


def test_joined_meshes_keep_their_triangles() -> None:
    first, second = box((0, 0, 0), (1, 1, 1), 1), box((5, 0, 0), (2, 2, 2), 2)
    both = joined([first, second])
    assert np.array_equal(both.vertices_m[both.faces[12:]], second.vertices_m[second.faces])
    assert both.materials.tolist() == [1] * 12 + [2] * 12


def test_box_has_its_surface_and_outward_normals() -> None:
    mesh = box((1, 2, 3), (2, 3, 4), 0)
    assert np.linalg.norm(face_normals(mesh), axis=1).sum() / 2 == pytest.approx(2 * (6 + 8 + 12))
    assert np.all(np.sum(mesh.normals * (mesh.vertices_m - [1, 2, 3]), 1) > 0)


def test_tube_stands_between_its_ends() -> None:
    mesh = tubes(np.array([[0.0, 0, 0]]), np.array([[0.0, 0, 2]]), 0.5, 0.25, 40, 0)
    radii = np.hypot(mesh.vertices_m[:, 0], mesh.vertices_m[:, 1])
    assert np.allclose(radii, np.where(mesh.vertices_m[:, 2] > 1, 0.25, 0.5), atol=1e-6)
    slant = np.hypot(2, 0.25)
    area = np.linalg.norm(face_normals(mesh), axis=1).sum() / 2
    assert area == pytest.approx(np.pi * 0.75 * slant, rel=0.01)


def test_no_tubes_are_an_empty_mesh() -> None:
    assert len(tubes(np.zeros((0, 3)), np.zeros((0, 3)), 0.1, 0.1, 5, 0).faces) == 0


def test_closed_loft_has_no_open_edge() -> None:
    angles = np.linspace(0, 2 * np.pi, 9)[:-1]
    ring = np.stack([np.zeros(8), np.cos(angles), np.sin(angles)], -1)
    mesh = loft(np.stack([ring, ring + np.array([1, 0, 0])]), 0)
    _, inverse = np.unique(mesh.vertices_m.round(5), axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts == 2)


def test_strip_measures_its_own_lengths() -> None:
    x, y = np.meshgrid([0.0, 3.0], [0.0, 1.0, 5.0], indexing="ij")
    mesh = strip(np.stack([x, y, 0 * x], -1), 0)
    assert np.allclose(mesh.coordinates_m, mesh.vertices_m[:, :2])
    assert np.allclose(np.abs(mesh.normals[:, 2]), 1)
    assert grid_faces(2, 3).shape == (4, 3)
    assert np.allclose(faceted(mesh).normals, mesh.normals[0])


def test_copies_are_scaled_turned_and_moved() -> None:
    prototype = box((0.5, 0, 0), (1, 0.2, 0.2), 4)
    corners = np.array([[10.0, 0, 0], [0, 10.0, 0]])
    copies = instanced(prototype, corners, yaw_rotations([0.0, np.pi / 2]), [1.0, 2.0])
    assert copies.vertices_m[:24, 0].max() == pytest.approx(11, abs=1e-5)
    second = copies.vertices_m[len(prototype.vertices_m) :]
    assert second[:, 1].max() == pytest.approx(12, abs=1e-5)
    moved = prototype.moved(Pose(corners[0], rotation()))
    assert np.allclose(copies.vertices_m[: len(prototype.vertices_m)], moved.vertices_m)
    stretched = instanced(prototype, corners[:1], yaw_rotations(0.0), np.array([[3.0, 1.0, 1.0]]))
    assert stretched.vertices_m[:, 0].max() == pytest.approx(13)


def test_normals_of_a_vertex_without_area_are_up() -> None:
    flat = np.zeros((3, 3), np.float32)
    assert smooth_normals(flat, np.array([[0, 1, 2]], np.uint32)).tolist() == [[0, 0, 1]] * 3


def test_noise_is_centred_smooth_and_of_its_seed() -> None:
    x, y = np.meshgrid(np.arange(0, 200, 0.7), np.arange(0, 200, 0.7))
    field = Noise(np.random.default_rng(5), 4.0)(x, y)
    assert abs(field.mean()) < 0.1
    assert field.std() == pytest.approx(1, abs=0.15)
    fine = Noise(np.random.default_rng(5), 4.0)(np.arange(0, 10, 1e-3), 3.0)
    assert np.abs(np.diff(fine)).max() < 0.02
    assert np.array_equal(field, Noise(np.random.default_rng(5), 4.0)(x, y))
    assert np.all(np.diff(smooth_step(np.linspace(-1, 2, 50))) >= 0)
