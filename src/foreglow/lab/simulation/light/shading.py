"""Reflection of a lamp's light by surfaces: diffuse, glossy, retroreflected, and through leaves."""

from __future__ import annotations

from foreglow.lab.simulation.light.llvm import clipped, dr, greatest, least
from foreglow.lab.simulation.light.raycast import Number
from foreglow.lab.simulation.light.surfaces import Surface

SHEETING_DEG, SHEETING_POWER = 0.6, 1.15
"""Fall-off of a sign's sheeting with the observation angle: 0.75, 0.6 and 0.02 of the coefficient at 0.2, 0.33 and
2 degrees. Source: minimum coefficients of class RA2 in EN 12899-1 (250, 180, 5 cd/lx/m^2).
"""

BEADS_DEG = 2.5
"""Fall-off of the beads in markings, which reflect light back into a wider cone."""

OPPOSITION_SURGE, OPPOSITION_WIDTH = 0.5, 0.1
"""Height and width (tangent of half the phase angle) of the brightening of rough surfaces towards the lamp."""

WATER = 0.02
"""Reflectance of water at normal incidence."""

MIN_COSINE = 0.01
"""Smallest cosine between normal and view; more grazing views are shaded with this one."""


def reflectance_per_sr(surface: Surface, to_lamp: Number) -> Number:
    """Luminance for 1 lx on a plane that faces the lamp, 1/sr: the BRDF times the lamp's cosine.

    Source: Lambert; Walter et al., Microfacet models, 2007 (GGX, Smith's shadowing with correlated heights); Schlick
    1994 (Fresnel); EN 12899-1, EN 1436 (definition of the coefficients of retroreflection).
    """
    facing = dr.dot(surface.normal, to_lamp)
    front, back = greatest(facing, 0.0), greatest(-facing, 0.0)
    seen = greatest(dr.dot(surface.normal, surface.view), MIN_COSINE)
    return (
        _diffuse(surface, to_lamp, front, back, seen)
        + _glossy(surface, to_lamp, front, seen)
        + _retroreflected(surface, to_lamp, front, seen)
    )


def _diffuse(surface: Surface, to_lamp: Number, front: Number, back: Number, seen: Number) -> Number:
    """Lambert for smooth paint and leaves, which transmit a share; far leaves as a canopy; everything else rough.

    Source: Ross, The radiation regime and architecture of plant stands, 1981 (scattering of spherical leaf angles).
    """
    cosine = clipped(dr.dot(to_lamp, surface.view), -1.0, 1.0)
    phase, sine = dr.acos(cosine), dr.sqrt(greatest(1.0 - cosine * cosine, 0.0))
    leaf_front = (sine + (dr.pi - phase) * cosine) * (2.0 / (3.0 * dr.pi))
    leaf_back = (sine - phase * cosine) * (2.0 / (3.0 * dr.pi))
    front_leaf, back = dr.lerp(front, leaf_front, surface.canopy), dr.lerp(back, leaf_back, surface.canopy)
    through = surface.transmission
    smooth = surface.albedo * dr.inv_pi * ((1.0 - through) * front_leaf + through * back)
    rough = _rough(surface.albedo, cosine, front, seen)
    passed = (1.0 - _fresnel(WATER, front)) * (1.0 - _fresnel(WATER, seen))
    return dr.select(surface.is_rough, rough * dr.lerp(1.0, passed, surface.film), smooth)


def _rough(albedo: Number, cosine: Number, front: Number, seen: Number) -> Number:
    """Reflection by a surface of grains and holes, such as asphalt, soil and plaster, under grazing light.

    With Lambert's law, the road in our own beam would be several times too dark from 10 m on. With this model, an
    albedo of 0.085 gives 9 mcd/m^2/lx in the geometry of EN 1436, where dry asphalt has 5 to 30, and the fall-off with
    distance fits the real frames.

    Source: Hapke, Bidirectional reflectance spectroscopy 1, J. Geophys. Res. 86, 1981; the albedo is the diffusive
    reflectance.
    """
    loss = (1.0 - albedo) / (1.0 + albedo)
    single = 1.0 - loss * loss
    many_front, many_seen = ((1.0 + 2.0 * mu) / (1.0 + 2.0 * mu * loss) for mu in (front, seen))
    # tan(phase / 2); the shadows in the holes are hidden if the lamp is near the line of sight.
    tangent = dr.sqrt(greatest(1.0 - cosine, 0.0) / greatest(1.0 + cosine, 1e-6))
    surge = 1.0 + OPPOSITION_SURGE / (1.0 + tangent / OPPOSITION_WIDTH)
    return single / (4.0 * dr.pi) * front / (front + seen) * (surge + many_front * many_seen - 1.0)


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
    is_lit = (surface.specular > 0) & (front > 0) & (along > 0)
    return dr.select(is_lit, distribution * visible * _fresnel(surface.specular, tilted) * front, 0.0)


def _fresnel(normal_reflectance: Number, cosine: Number) -> Number:
    """Specularly reflected share of the light. Source: Schlick, An inexpensive BRDF model, 1994."""
    rest = 1.0 - cosine
    square = rest * rest
    return normal_reflectance + (1.0 - normal_reflectance) * square * square * rest


def _retroreflected(surface: Surface, to_lamp: Number, front: Number, seen: Number) -> Number:
    """Light that is reflected almost back to the lamp."""
    # From the chord between the directions: in single precision, an arc cosine does not resolve less than 0.02 degrees.
    angle_deg = dr.rad2deg(2.0 * dr.asin(least(0.5 * dr.norm(to_lamp - surface.view), 1.0)))
    sheeting = dr.exp(-dr.power(angle_deg / SHEETING_DEG, SHEETING_POWER)) * front
    # R_L of markings is luminance per illuminance facing the lamp: no cosine if lamp and eye are at the same height.
    beads = dr.exp(-angle_deg / BEADS_DEG) * front / greatest(front, seen)
    return surface.retroreflection * dr.select(surface.is_beaded, beads, sheeting)
