"""Materials of surfaces: how they reflect, and the kind of a light artifact that is seen on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import Kind


@dataclass(frozen=True, slots=True)
class Material:
    """Diffuse, glossy and retroreflective parts of a surface's reflection.

    Attributes:
        name: Unique.
        kind: Kind of a light artifact on it.
        albedo: Diffuse reflectance, 0..1.
        specular: Reflectance at normal incidence of the glossy part (F0).
        roughness: GGX roughness, 0..1.
        transmission: Share of the diffuse light that leaves on the other side (leaves, grass).
        retroreflection: Coefficient of retroreflection at an observation angle of 0, cd/lx/m^2.
        variation: Standard deviation of the natural logarithm of the albedo, over textures of several sizes.
        bump: Standard deviation of the surface's slope in the texture, no unit.
    """

    name: str
    kind: Kind
    albedo: float
    specular: float = 0.0
    roughness: float = 0.9
    transmission: float = 0.0
    retroreflection: float = 0.0
    variation: float = 0.0
    bump: float = 0.0


MATERIALS: tuple[Material, ...] = (
    Material("road", "road", 0.055, 0.04, 0.55, variation=0.1, bump=0.0025),
    Material("marking", "road", 0.45, 0.04, 0.5, retroreflection=0.12, variation=0.15),
    Material("pavement", "road", 0.20, 0.02, 0.7, variation=0.15, bump=0.02),
    Material("gravel", "verge", 0.10, 0.0, 0.9, variation=0.12, bump=0.03),
    Material("grass_ground", "verge", 0.06, 0.0, 0.9, variation=0.12, bump=0.03),
    Material("soil", "verge", 0.07, 0.0, 0.9, variation=0.12, bump=0.03),
    Material("snow", "verge", 0.65, 0.02, 0.6, variation=0.25, bump=0.15),
    Material("grass_blade", "verge", 0.08, 0.02, 0.7, transmission=0.3),
    Material("bark", "foliage", 0.13, 0.0, 0.9, variation=0.25, bump=0.1),
    Material("leaf", "foliage", 0.12, 0.02, 0.6, transmission=0.4),
    Material("rail", "rail", 0.30, 0.30, 0.4, variation=0.1),
    Material("post", "sign", 0.55, 0.04, 0.3),
    Material("metal_post", "rail", 0.10, 0.12, 0.5),
    Material("reflector", "sign", 0.30, 0.04, 0.2, retroreflection=60.0),
    Material("sign_white", "sign", 0.45, 0.04, 0.35, retroreflection=120.0),
    Material("sign_colour", "sign", 0.15, 0.04, 0.35, retroreflection=30.0),
    Material("sign_black", "sign", 0.03, 0.04, 0.25),
    Material("sign_back", "sign", 0.30, 0.20, 0.5),
    Material("concrete", "wall", 0.28, 0.0, 0.9, variation=0.25, bump=0.04),
    Material("plaster", "wall", 0.50, 0.0, 0.9, variation=0.15, bump=0.03),
    Material("brick", "wall", 0.18, 0.0, 0.9, variation=0.35, bump=0.06),
    Material("rock", "wall", 0.22, 0.0, 0.9, variation=0.4, bump=0.25),
    Material("roof", "wall", 0.12, 0.02, 0.7, variation=0.25),
    Material("window", "wall", 0.03, 0.05, 0.1),
    Material("paint_dark", "vehicle", 0.03, 0.04, 0.2),
    Material("paint_light", "vehicle", 0.45, 0.04, 0.2),
    Material("glass", "vehicle", 0.02, 0.05, 0.08),
    Material("tyre", "vehicle", 0.04, 0.0, 0.8),
    Material("sign_dark", "sign", 0.08, 0.04, 0.35, retroreflection=6.0),
    Material("plate", "vehicle", 0.50, 0.04, 0.4, retroreflection=15.0),
    Material("rear_reflector", "vehicle", 0.10, 0.04, 0.2, retroreflection=120.0),
    Material("contour_tape", "vehicle", 0.30, 0.04, 0.3, retroreflection=60.0),
    Material("lamp_glass", "vehicle", 0.20, 0.08, 0.1),
    Material("clothing", "vehicle", 0.05, 0.0, 0.9),
    Material("kerb", "road", 0.30, 0.0, 0.8, variation=0.2, bump=0.02),
    Material("pole", "sign", 0.14, 0.10, 0.5, variation=0.1),
    Material("screen", "sign", 0.05, 0.04, 0.3),
    Material("paint_mid", "vehicle", 0.16, 0.04, 0.25),
)
"""Every material of a world; its index is the number in `Mesh.materials`. Albedos and coefficients of retroreflection
are similar to published tables (EN 1436 for markings, EN 12899 for signs) and not tuned on images.
"""

_NUMBERS = {material.name: number for number, material in enumerate(MATERIALS)}

NO_MATERIAL = 255
"""Number of the sky in a material image."""


def material_number(name: str) -> int:
    """The number of the material called `name`.

    Raises:
        ValueError: If there is none; the message lists those that exist.
    """
    if name not in _NUMBERS:
        raise ValueError(f"material: expected one of {', '.join(_NUMBERS)}, got {name!r}")
    return _NUMBERS[name]


def column(field: str) -> NDArray[np.float32]:
    """One field of every material, shape (len(MATERIALS),), float32."""
    return np.array([getattr(material, field) for material in MATERIALS], np.float32)
