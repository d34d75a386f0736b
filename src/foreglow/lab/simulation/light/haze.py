"""Single scattering: light of each lamp that the air scatters into the view, with shadows, up to every depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera
from foreglow.lab.simulation.light.llvm import angle_rad, clipped, dr, greatest, least, mi
from foreglow.lab.simulation.light.raycast import END_GAP_M, Number
from foreglow.lab.simulation.light.space import Air, Space

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

        out = space.lights.summed(index, luminance)
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
