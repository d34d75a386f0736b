"""How a lamp's light gets to the camera: by surfaces (diffuse, glossy, retroreflected, through leaves) and by haze."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera
from foreglow.lab.simulation.light.lights import Air, Space
from foreglow.lab.simulation.light.llvm import angle_rad, clipped, dr, greatest, least, mi
from foreglow.lab.simulation.light.raycast import END_GAP_M, Number
from foreglow.lab.simulation.light.surfaces import Surface

FAR_M = 600.0
"""End of the haze: beyond, it adds nothing that a camera sees."""

NEAR_M = 3.0
"""Begin of the haze: nearer, it is above our own bonnet, which hides the glow around our own lamps."""

DARKEST_SHARE = 0.1
"""Smallest luminance of a step that is traced, relative to that on surfaces; smaller, since steps add up."""


class Haze:
    """A coarse grid of rays, each with the light gathered up to a number of depths.

    A pixel interpolates between four rays at its own depth, so that haze behind an object does not bleed over its edge.
    Each step is sampled once: if a lit volume begins within the step that ends at a pixel's surface, the error is at
    most the light of one step. Edges of shadows are as sharp as the grid.
    """

    def __init__(self, camera: Camera, size: tuple[int, int, int]) -> None:
        """A grid with `size` columns, rows and steps along each ray; it reaches to the borders of the image."""
        columns, rows, steps = size
        self._size = size
        self._columns, self._rows, self._steps = (dr.opaque(mi.UInt32, count) for count in size)
        x, y = np.meshgrid(np.linspace(0, camera.width_px, columns), np.linspace(0, camera.height_px, rows))
        rays = camera.rays(np.stack([x.ravel(), y.ravel()], -1))
        self._directions = mi.Vector3f(np.ascontiguousarray(rays.T, np.float32))
        self._cell_rad = dr.opaque(mi.Float, camera.width_px / (columns - 1) / camera.focal_px[0])
        self._ends_m = mi.Float(np.geomspace(NEAR_M, FAR_M, steps + 1).astype(np.float32))
        self._log_growth = dr.opaque(mi.Float, float(np.log(FAR_M / NEAR_M) / steps))
        pixel_x, pixel_y = np.meshgrid(
            (np.arange(camera.width_px) + 0.5) * (columns - 1) / camera.width_px,
            (np.arange(camera.height_px) + 0.5) * (rows - 1) / camera.height_px,
        )
        self._grid_points = mi.Point2f(np.stack([pixel_x.ravel(), pixel_y.ravel()]).astype(np.float32))

    def render(self, space: Space, air: Air, distance_m: Number) -> NDArray[np.float32]:
        """Scattered light of every layer, shape (layers, pixels), cd/m^2, up to each pixel's `distance_m`."""
        num_layers = space.lights.num_layers
        steps = self._scattered(space, air).numpy().reshape(num_layers, self._size[2], -1)
        gathered = np.zeros((num_layers, self._size[2] + 1, steps.shape[2]), np.float32)
        np.cumsum(steps, axis=1, out=gathered[:, 1:])
        return self._looked_up(mi.Float(gathered.ravel()), distance_m, num_layers)

    def _scattered(self, space: Space, air: Air) -> Number:
        """Luminance from every step of every ray, cd/m^2, in the order layer, step, ray."""
        num_rays = self._columns * self._rows
        num = self._size[0] * self._size[1] * self._size[2]
        index = dr.arange(mi.UInt32, num)
        step, ray = index // num_rays, index % num_rays
        direction = space.rotation @ dr.gather(mi.Vector3f, self._directions, ray)
        start, end = dr.gather(mi.Float, self._ends_m, step), dr.gather(mi.Float, self._ends_m, step + 1)

        def luminance(number: Number) -> Number:
            lamp = space.lights.position(number)
            nearest_at = dr.dot(lamp - space.origin, direction)
            # The mean of 1/distance over the width of a cell is finite even where a ray meets a lamp.
            soft_m = 0.3 * self._cell_rad * greatest(nearest_at, 0.0) + 0.05
            off_m = dr.sqrt(dr.squared_norm(space.origin + direction * nearest_at - lamp) + dr.square(soft_m))
            # Source: Kulla, Fajardo, Importance sampling techniques for path tracing in participating media, 2012:
            # steps in the angle that the lamp sees, dt / r^2 = d angle / off_m.
            low, high = start - nearest_at, end - nearest_at
            angle = angle_rad(off_m * (end - start), dr.square(off_m) + low * high)
            way_m = nearest_at + off_m * dr.tan(angle_rad(low, off_m) + 0.5 * angle)
            point = space.origin + direction * way_m
            light = space.lights.towards(point, number)
            phase = _henyey_greenstein(dr.dot(light.direction, direction), air.asymmetry)
            lost = dr.exp(-air.scattering_per_m * (way_m + light.distance_m))
            sent = light.intensity_cd * air.scattering_per_m * phase * lost * angle / off_m
            counts = sent > space.darkest_cd_m2 * DARKEST_SHARE
            blocked = space.world.is_blocked(point, light.direction, light.distance_m - END_GAP_M, counts)
            return dr.select(counts & ~blocked, sent, 0.0)

        out = space.lights.summed(index, mi.Bool(True), luminance)
        dr.eval(out)
        return out

    def _looked_up(self, gathered: Number, distance_m: Number, num_layers: int) -> NDArray[np.float32]:
        """Shape (num_layers, pixels): each pixel's light, interpolated at its depth between the four rays around it."""
        num = dr.width(distance_m)
        column = clipped(dr.floor(self._grid_points.x), 0.0, mi.Float(self._columns) - 2.0)
        row = clipped(dr.floor(self._grid_points.y), 0.0, mi.Float(self._rows) - 2.0)
        right, down = self._grid_points.x - column, self._grid_points.y - row
        depth = least(dr.select(dr.isfinite(distance_m), distance_m, FAR_M), FAR_M)
        last = mi.Float(self._steps) - 1.0
        step = mi.UInt32(clipped(dr.floor(dr.log(greatest(depth, NEAR_M) / NEAR_M) / self._log_growth), 0.0, last))
        start, end = dr.gather(mi.Float, self._ends_m, step), dr.gather(mi.Float, self._ends_m, step + 1)
        into = clipped((depth - start) / (end - start), 0.0, 1.0)
        num_rays = self._columns * self._rows
        corner = step * num_rays + mi.UInt32(row) * self._columns + mi.UInt32(column)
        layer_size, index = (self._steps + 1) * num_rays, dr.arange(mi.UInt32, num)
        out = dr.empty(mi.Float, num * num_layers)
        layers, stride = dr.opaque(mi.UInt32, num_layers), dr.opaque(mi.UInt32, num)

        def look_up(layer: Number) -> tuple[Number]:
            first = corner + layer * layer_size

            def at(index: Number) -> Number:
                near, far = (dr.gather(mi.Float, gathered, index + ahead) for ahead in (0, num_rays))
                return dr.lerp(near, far, into)

            above = dr.lerp(at(first), at(first + 1), right)
            below = dr.lerp(at(first + self._columns), at(first + self._columns + 1), right)
            dr.scatter(out, dr.lerp(above, below, down), layer * stride + index)
            return (layer + 1,)

        dr.while_loop((dr.zeros(mi.UInt32, num),), lambda layer: layer < layers, look_up)
        dr.eval(out)
        return np.asarray(out.numpy(), np.float32).reshape(num_layers, num)


def _henyey_greenstein(cosine: Number, asymmetry: Number) -> Number:
    """Phase function, 1/sr; a cosine of 1 is forward scattering. Source: Henyey, Greenstein 1941."""
    spread = greatest(1.0 + dr.square(asymmetry) - 2.0 * asymmetry * cosine, 1e-6)
    return (1.0 - dr.square(asymmetry)) / (4.0 * dr.pi * spread * dr.sqrt(spread))


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
