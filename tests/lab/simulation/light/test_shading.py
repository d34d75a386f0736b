"""Laws that every reflection obeys, and figures from the standards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.simulation.light.llvm import dr, mi
from foreglow.lab.simulation.light.shading import reflectance_per_sr
from foreglow.lab.simulation.light.surfaces import Surface

pytestmark = pytest.mark.renderer

LOOKS: dict[str, dict[str, Any]] = {
    "lambert": {"albedo": 0.5},
    "rough": {"albedo": 0.3, "is_rough": True},
    "wet": {"albedo": 0.1, "is_rough": True, "film": 0.8, "specular": 0.04, "alpha": 0.05},
    "glossy": {"albedo": 0.16, "specular": 0.35, "alpha": 0.13},
    "leaf": {"albedo": 0.12, "transmission": 0.4},
    "canopy": {"albedo": 0.12, "transmission": 0.4, "canopy": 1.0},
    "sheeting": {"albedo": 0.45, "retroreflection": 120.0},
    "beads": {"albedo": 0.45, "is_rough": True, "is_beaded": True, "retroreflection": 0.12},
}


def reflectances(material: dict[str, Any], to_lamps: Floats, views: Floats) -> Floats:
    """BRDF times the lamp's cosine, shape (N,), on a surface that faces upwards; directions of shape (N, 3)."""
    directions = [mi.Vector3f(np.ascontiguousarray(directions.T, np.float32)) for directions in (to_lamps, views)]
    up = mi.Vector3f(0.0, 0.0, 1.0)
    fields = {"albedo": 0.0, "specular": 0.0, "alpha": 0.5, "transmission": 0.0, "retroreflection": 0.0}
    flags = {"is_beaded": False, "is_rough": False}
    values = {name: mi.Float(float(material.get(name, value))) for name, value in fields.items()}
    values |= {name: mi.Float(float(material.get(name, 0.0))) for name in ("film", "canopy")}
    values |= {name: mi.Bool(material.get(name, value)) for name, value in flags.items()}
    surface = Surface(
        is_hit=mi.Bool(True), position=mi.Point3f(0.0), outward=up, normal=up, view=directions[1], **values
    )
    light = reflectance_per_sr(surface, directions[0])
    return np.array(light + dr.zeros(mi.Float, len(views)), np.float64)


def upward(num: int, seed: int) -> Floats:
    """Directions above the ground, not quite level; shape (num, 3)."""
    generator = np.random.default_rng(seed)
    height, angle = generator.uniform(0.03, 1, num), generator.uniform(0, 2 * np.pi, num)
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], -1)


@pytest.mark.parametrize("name", LOOKS)
def test_lamp_and_eye_change_places(name: str) -> None:
    to_lamps, views = upward(500, 1), upward(500, 2)
    views[:250] = to_lamps[:250] + 0.02 * views[:250]  # half of them near each other, where retroreflection is
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    there, back = reflectances(LOOKS[name], to_lamps, views), reflectances(LOOKS[name], views, to_lamps)
    if name != "canopy":  # which has no one normal
        there, back = there / to_lamps[:, 2], back / views[:, 2]
    np.testing.assert_allclose(there, back, rtol=2e-3, atol=1e-7)
    assert (there >= 0).all()
    assert there.max() > 0


@pytest.mark.parametrize("name", ["lambert", "rough", "wet", "glossy", "leaf", "canopy"])
def test_no_more_light_leaves_than_comes(name: str) -> None:
    heights, angles = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(200) + 0.5) / 200 * 2 * np.pi)
    flat = np.sqrt(1 - heights**2)
    views = np.stack([flat * np.cos(angles), flat * np.sin(angles), heights], -1).reshape(-1, 3)
    for height in (0.1, 0.4, 1.0):
        lamp = np.array([np.sqrt(1 - height**2), 0.0, height])
        sent = reflectances(LOOKS[name], np.broadcast_to(lamp, views.shape), views)
        total = 2 * np.pi * np.mean(sent * views[:, 2]) / height
        if name == "lambert":
            assert total == pytest.approx(0.5, rel=1e-3)
        assert 0 < total < 1


def test_leaves_let_their_share_through() -> None:
    through = reflectances(LOOKS["leaf"], np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    front = reflectances(LOOKS["leaf"], np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert through == pytest.approx(0.4 * 0.12 / np.pi, rel=1e-5)
    assert front == pytest.approx(0.6 * 0.12 / np.pi, rel=1e-5)
    opaque = reflectances(LOOKS["rough"], np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert opaque == 0


def turned(degrees: Floats) -> Floats:
    """Directions this far from straight up."""
    angles = np.radians(degrees)
    return np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], -1)


def test_sheeting_falls_off_as_the_standard_says() -> None:
    """EN 12899-1, class RA2, white, 5 degrees entrance: at least 250, 180 and 5 at 0.2, 0.33 and 2 degrees."""
    lamp = np.broadcast_to(turned(np.array([5.0])), (4, 3))
    coefficients = reflectances({"retroreflection": 330.0}, lamp, turned(np.array([5.0, 5.2, 5.33, 7.0])))
    assert coefficients[0] == pytest.approx(330, rel=0.01)
    assert (coefficients[1:] > [230, 180, 5]).all()
    assert coefficients[3] < 15


def test_road_and_marking_in_the_geometry_of_en_1436() -> None:
    """Lamp 1.24 degrees and eye 2.29 degrees above the road: dry asphalt has 5 to 30 mcd/m^2/lx, markings 70 to 300."""
    lamp, eye = turned(np.array([90 - 1.24])), turned(np.array([90 - 2.29]))
    road = 1e3 * reflectances({"albedo": 0.085, "is_rough": True, "specular": 0.04, "alpha": 0.18}, lamp, eye)
    marking = 1e3 * reflectances(LOOKS["beads"], lamp, eye)
    wet = 1e3 * reflectances(LOOKS["wet"], lamp, eye)
    assert 5 < road < 30
    assert 70 < marking < 300
    assert wet < 0.5 * road


def test_gloss_is_brightest_in_the_mirror_direction() -> None:
    lamp = turned(np.array([60.0]))
    mirrored = lamp * [-1, 1, 1]
    angles = np.linspace(-85, 0, 300)
    light = reflectances(LOOKS["glossy"], np.broadcast_to(lamp, (300, 3)), turned(angles))
    assert angles[light.argmax()] == pytest.approx(-60, abs=5)
    flat = {**LOOKS["glossy"], "alpha": 0.5}
    assert reflectances(LOOKS["glossy"], lamp, mirrored) > 5 * reflectances(flat, lamp, mirrored)
