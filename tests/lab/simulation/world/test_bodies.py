"""Vehicles' bodies and where their lamps sit."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.simulation.world.bodies import BODIES, Body
from foreglow.lab.simulation.world.materials import MATERIALS, material_number
from foreglow.lab.simulation.world.mesh import Mesh
from tests.lab.simulation.small_scenes import is_of, points_of

TWO_TRACKED = ("car", "van", "lorry", "semitrailer")
bodies = pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))


def is_hit(mesh: Mesh, start: Floats, direction: Floats) -> bool:
    """Whether a ray meets any triangle (Moeller and Trumbore, 1997)."""
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces].astype(np.float64), 1, 0)
    across = np.cross(direction, c - a)
    area = np.sum((b - a) * across, 1)
    area = np.where(np.abs(area) < 1e-12, np.nan, area)
    u = np.sum((start - a) * across, 1) / area
    turned = np.cross(start - a, b - a)
    v, distance = turned @ direction / area, np.sum((c - a) * turned, 1) / area
    return bool(np.any((u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 1e-6)))


@bodies
def test_body_stands_on_the_road_within_its_box(body: Body) -> None:
    points = body.mesh.vertices_m
    centre, half = np.array(body.box_centre_m), np.array(body.size_m) / 2
    assert np.all(points >= centre - half - 1e-3)
    assert np.all(points <= centre + half + 1e-3)
    assert points[:, 2].min() == pytest.approx(0, abs=0.02)
    tyres = points_of(body.mesh, "tyre")
    radius = tyres[:, 2].max() / 2
    assert tyres[:, 0].min() == pytest.approx(-radius, abs=0.02)
    assert tyres[:, 0].max() == pytest.approx(body.wheelbase_m + radius, abs=0.02)


@bodies
def test_lamps_are_not_hidden_by_their_own_body(body: Body) -> None:
    for lamp in body.lamps:
        ahead, aside = np.cos(lamp.yaw_rad), np.sin(lamp.yaw_rad)
        for azimuth, elevation in product(np.radians([-60, -20, 0, 20, 60]), np.radians([-15, 0, 15])):
            along, across = np.cos(azimuth), np.sin(azimuth)
            direction = np.array([ahead * along - aside * across, aside * along + ahead * across, np.tan(elevation)])
            assert not is_hit(body.mesh, np.array(lamp.position_m), direction / np.linalg.norm(direction)), lamp.name


@bodies
def test_lamps_are_close_to_the_body_and_named_by_their_function(body: Body) -> None:
    assert {lamp.function for lamp in body.lamps} >= {"low", "rear"}
    assert len({lamp.name for lamp in body.lamps}) == len(body.lamps)
    for lamp in body.lamps:
        assert lamp.name.startswith(lamp.function)
        assert np.linalg.norm(body.mesh.vertices_m - np.array(lamp.position_m), axis=1).min() < 0.45
        assert 0.02 < lamp.radius_m < 0.15
        left = lamp.position_m[1]
        assert left > 0 if lamp.name.endswith("left") else left < 0 if lamp.name.endswith("right") else left == 0


def test_heights_of_lamps_and_eyes_are_usual() -> None:
    heights = {
        kind: [lamp.position_m[2] for lamp in body.lamps if lamp.function == "low"] for kind, body in BODIES.items()
    }
    assert heights["car"] == [0.65, 0.65]
    assert heights["lorry"] == [0.9, 0.9]
    assert len(heights["motorcycle"]) == 1
    assert BODIES["car"].eye_m[2] == pytest.approx(1.15, abs=0.05)
    assert BODIES["lorry"].eye_m[2] == pytest.approx(2.3, abs=0.1)


@bodies
def test_paint_is_dark_or_light_and_nothing_else_changes(body: Body) -> None:
    dark, light = body.painted(False), body.painted(True)
    assert is_of(dark, "paint_dark").any()
    assert not is_of(light, "paint_dark").any()
    other = ~is_of(dark, "paint_dark")
    assert np.array_equal(dark.materials[other], light.materials[other])
    assert light is body.painted(True)


@bodies
def test_body_is_smooth_finite_and_of_known_materials(body: Body) -> None:
    mesh = body.mesh
    assert np.isfinite(mesh.vertices_m).all()
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-3)
    assert mesh.materials.max() < len(MATERIALS)
    assert len(mesh.faces) < 6000
    if body.kind in TWO_TRACKED:
        assert is_of(mesh, "glass").any()
        assert np.abs(mesh.vertices_m[:, 1].min() + mesh.vertices_m[:, 1].max()) < 1e-3


@bodies
def test_plates_and_reflectors_face_the_followers(body: Body) -> None:
    plates, reflectors = points_of(body.mesh, "plate"), points_of(body.mesh, "rear_reflector")
    rear = body.mesh.vertices_m[:, 0].min()
    assert body.kind == "bicycle" or plates[:, 0].min() < rear + 0.05
    assert np.all(reflectors[:, 0] < rear + 0.05)
    if body.kind in TWO_TRACKED:
        assert plates[:, 0].max() > body.mesh.vertices_m[:, 0].max() - 0.05
    assert MATERIALS[material_number("plate")].retroreflection > 0


@pytest.mark.parametrize("kind", ["lorry", "semitrailer"])
def test_lorry_shows_its_outline_to_the_rear(kind: str) -> None:
    tape = points_of(BODIES[kind].mesh, "contour_tape")
    rear = tape[tape[:, 0] < BODIES[kind].mesh.vertices_m[:, 0].min() + 0.1]
    assert np.ptp(rear[:, 1]) > 2.2
    assert np.ptp(rear[:, 2]) > 2.2
