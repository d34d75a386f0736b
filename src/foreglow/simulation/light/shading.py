"""How surfaces reflect the light of a lamp: diffuse, glossy, retroreflected, and through leaves."""

from __future__ import annotations

from foreglow.simulation.light.llvm import clipped, dr, greatest, least
from foreglow.simulation.light.raycast import Number
from foreglow.simulation.light.surfaces import Surface

SHEETING_DEG, SHEETING_POWER = 0.6, 1.15
"""Fall-off of a sign's sheeting with the observation angle: 0.75, 0.6 and 0.02 of the coefficient at 0.2, 0.33 and
2 degrees. Source: minimum coefficients of class RA2 in EN 12899-1 (250, 180, 5 cd/lx/m^2).
"""

BEADS_DEG = 2.5
"""Fall-off of the beads in markings, which send light back into a wider cone."""

MIN_COSINE = 0.01
"""Grazing views below this are shaded as if they were at it."""


def reflectance_per_sr(surface: Surface, to_lamp: Number) -> Number:
    """Luminance for 1 lx on a plane that faces the lamp, 1/sr: the BRDF times the lamp's cosine.

    Source: Lambert; Walter et al., Microfacet models, 2007 (GGX, Smith's shadowing with correlated heights); Schlick
    1994 (Fresnel); EN 12899-1, EN 1436 (what the coefficients of retroreflection mean).
    """
    facing = dr.dot(surface.normal, to_lamp)
    front, back = greatest(facing, 0.0), greatest(-facing, 0.0)
    seen = greatest(dr.dot(surface.normal, surface.view), MIN_COSINE)
    return (
        _diffuse(surface, to_lamp, front, back)
        + _glossy(surface, to_lamp, front, seen)
        + _retroreflected(surface, to_lamp, front, seen)
    )


def _diffuse(surface: Surface, to_lamp: Number, front: Number, back: Number) -> Number:
    """Lambert, with a share through to the other side; a canopy's mean over leaves of all directions far away.

    Source: Ross, The radiation regime and architecture of plant stands, 1981 (scattering of spherical leaf angles).
    """
    phase = dr.acos(clipped(dr.dot(to_lamp, surface.view), -1.0, 1.0))
    sine, cosine = dr.sin(phase), dr.cos(phase)
    leaf_front = (sine + (dr.pi - phase) * cosine) * (2.0 / (3.0 * dr.pi))
    leaf_back = (sine - phase * cosine) * (2.0 / (3.0 * dr.pi))
    front, back = dr.lerp(front, leaf_front, surface.canopy), dr.lerp(back, leaf_back, surface.canopy)
    through = surface.transmission
    return surface.albedo * dr.inv_pi * ((1.0 - through) * front + through * back)


def _glossy(surface: Surface, to_lamp: Number, front: Number, seen: Number) -> Number:
    middle = dr.normalize(to_lamp + surface.view)
    along, tilted = dr.dot(surface.normal, middle), greatest(dr.dot(surface.view, middle), 0.0)
    alpha2 = dr.square(greatest(surface.alpha, 1e-3))
    spread = dr.square(along) * (alpha2 - 1.0) + 1.0
    distribution = alpha2 / (dr.pi * spread * spread)
    # V = G / (4 cos cos), as in Heitz, Understanding the masking-shadowing function, 2014.
    visible = 0.5 / greatest(
        front * dr.sqrt(dr.square(seen) * (1.0 - alpha2) + alpha2)
        + seen * dr.sqrt(dr.square(front) * (1.0 - alpha2) + alpha2),
        1e-6,
    )
    fresnel = surface.specular + (1.0 - surface.specular) * dr.power(1.0 - tilted, 5.0)
    return dr.select((surface.specular > 0) & (front > 0) & (along > 0), distribution * visible * fresnel * front, 0.0)


def _retroreflected(surface: Surface, to_lamp: Number, front: Number, seen: Number) -> Number:
    """Light that goes back to where it came from, almost."""
    # The chord between the directions: an arc cosine knows no angles below 0.02 degrees in single precision.
    angle_deg = dr.rad2deg(2.0 * dr.asin(least(0.5 * dr.norm(to_lamp - surface.view), 1.0)))
    sheeting = dr.exp(-dr.power(angle_deg / SHEETING_DEG, SHEETING_POWER)) * front
    # R_L of markings is luminance per illuminance facing the lamp: no cosine where lamp and eye are as low.
    beads = dr.exp(-angle_deg / BEADS_DEG) * front / greatest(front, seen)
    return surface.retroreflection * dr.select(surface.is_beaded, beads, sheeting)
