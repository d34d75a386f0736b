"""Luminance images of a night drive: a layer for each light source, and the depth and material of every pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Pose
from foreglow.lab.simulation.light.lamps import PlacedBody, PlacedLamp
from foreglow.lab.simulation.light.lights import Air, Lights, Space, air_of, space_of
from foreglow.lab.simulation.light.llvm import dr, greatest, mi, prepare
from foreglow.lab.simulation.light.raycast import END_GAP_M, START_GAP_M, Number, Solids
from foreglow.lab.simulation.light.sampling import QUALITIES, RenderSettings, Samples
from foreglow.lab.simulation.light.shading import Haze, reflectance_per_sr
from foreglow.lab.simulation.light.surfaces import Surface, Surfaces
from foreglow.lab.simulation.scenes.scene import RoadSpec, WeatherSpec
from foreglow.lab.simulation.world.materials import NO_MATERIAL
from foreglow.lab.simulation.world.mesh import Mesh

__all__ = ["QUALITIES", "RenderSettings", "Rendered", "Renderer"]

Floats32 = NDArray[np.float32]

MOST_REFLECTED_PER_SR = 1e3
"""Luminance for 1 lx beyond that of all surfaces; the sheeting of signs reaches some hundreds."""


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """The light before optics and imager; H rows, W columns, L layers.

    Attributes:
        surface_cd_m2: Shape (L, H, W), float32: light reflected by surfaces.
        haze_cd_m2: Shape (L, H, W), float32: light scattered by the air.
        ambient_cd_m2: Shape (H, W), float32: the sky, its light on surfaces, and screens that shine by themselves.
        depth_m: Shape (H, W), float32: along the ray through the pixel's centre; NaN for the sky.
        materials: Shape (H, W), uint8: numbers of the materials; 255 for the sky.
        bodies: Shape (H, W), int16: number of the moving body; -1 for none.
    """

    surface_cd_m2: Floats32
    haze_cd_m2: Floats32
    ambient_cd_m2: Floats32
    depth_m: Floats32
    materials: NDArray[np.uint8]
    bodies: NDArray[np.int16]


class Renderer:
    """Renders a world frame by frame.

    It computes direct light with shadows only; further bounces change most lit areas by less than a percent. The lamps'
    own discs and lit windows are left to the sensor, which draws them as points with glare. The same arguments give the
    same bytes with any number of threads.
    """

    def __init__(
        self,
        static: Mesh,
        bodies: Mapping[str, Mesh],
        camera: Camera,
        settings: RenderSettings,
        *,
        road: RoadSpec,
        seed: int,
        is_snowing: bool = False,
    ) -> None:
        """Builds the world.

        Args:
            static: The fixed triangles, in the world.
            bodies: Vehicles in their own frames, called `kind/light` or `kind/dark`.
            camera: The calibration; its mount is not used here.
            settings: Quality and cost of an image.
            road: State of the carriageway.
            seed: Seed of the textures.
            is_snowing: Whether snow sticks to the trees.
        """
        prepare()
        self._settings = settings
        self._world = Solids(static, bodies)
        self._lights = Lights()
        self._surfaces = Surfaces(road, seed, is_snowing=is_snowing)
        self._haze = Haze(camera, settings.haze_cells)
        self._pixel_rad = dr.opaque(mi.Float, 1.0 / float(np.mean(camera.focal_px)))
        self._samples = Samples(camera, settings)

    def render(
        self,
        camera_pose: Pose,
        lamps: Sequence[PlacedLamp],
        num_layers: int,
        bodies: Sequence[PlacedBody],
        weather: WeatherSpec,
        *,
        num_repeated: int = 0,
    ) -> Rendered:
        """The view from `camera_pose`, world_from_camera; layers of lamps are below `num_layers`.

        The last `num_repeated` layers are of lamps that shine in other layers, too: they change nothing in these.

        Raises:
            ValueError: If a lamp's layer is out of range, or there is no mesh for a body.
        """
        for index, lamp in enumerate(lamps):
            if not 0 <= lamp.layer < num_layers:
                raise ValueError(f"lamps[{index}].layer: expected 0 to {num_layers - 1}, got {lamp.layer}")
        self._world.place(bodies)
        self._lights.switch_on([lamp for lamp in lamps if not lamp.lights_nothing], num_layers)
        space = space_of(self._world, self._lights, camera_pose, self._settings.darkest_cd_m2)
        air = air_of(weather)
        samples = self._samples
        first = self._shoot(space, air, samples.first, samples.pixels)
        surface, ambient = first.surface_cd_m2, first.ambient_cd_m2
        haze = self._haze.render(space, air, first.distance_m)
        chosen = samples.detailed(surface[: len(surface) - num_repeated].sum(axis=0).reshape(samples.shape))
        if len(chosen):
            slots = mi.UInt32(np.arange(len(chosen), dtype=np.uint32))
            for rays in samples.further(chosen):
                more = self._shoot(space, air, rays, slots)
                surface[:, chosen] += more.surface_cd_m2
                ambient[chosen] += more.ambient_cd_m2
            surface[:, chosen] /= samples.num
            ambient[chosen] /= samples.num
        return Rendered(
            surface.reshape(-1, *samples.shape)[:num_layers],
            haze.reshape(-1, *samples.shape)[:num_layers],
            ambient.reshape(samples.shape),
            first.distance_m.numpy().reshape(samples.shape),
            first.material.numpy().astype(np.uint8).reshape(samples.shape),
            first.body.numpy().astype(np.int16).reshape(samples.shape),
        )

    def is_visible(
        self,
        origins_m: NDArray[np.floating],
        target_m: NDArray[np.floating],
        bodies: Sequence[PlacedBody],
        *,
        ignore_body: int | None = None,
    ) -> NDArray[np.bool_]:
        """Whether each of `origins_m`, shape (N, 3), sees `target_m`, shape (3,), in the world; shape (N,).

        The last few centimetres at both ends do not count, so that a lamp's glass is no obstacle.

        Args:
            origins_m: Points on a lamp's disc, for example.
            target_m: The camera, or a driver's eye.
            bodies: The moving bodies.
            ignore_body: Number of a body that does not block, such as the driver's own vehicle.
        """
        self._world.place(bodies)
        return self._world.is_free(np.asarray(origins_m, np.float64).reshape(-1, 3), target_m, ignore_body)

    def _shoot(self, space: Space, air: Air, rays: Number, slots: Number) -> _Shot:
        """A sample along each of `rays`, which are in the camera's frame; its values are stored in `slots`."""
        direction = space.rotation @ rays
        hit = space.world.hit(space.origin, direction)
        surface = self._surfaces.at(hit, direction, self._pixel_rad)
        kept = dr.exp(-air.scattering_per_m * hit.distance_m)
        # A wall sees half of the sky's hemisphere, the ground all of it.
        skylight = air.sky_cd_m2 * surface.albedo * (0.5 + 0.5 * surface.normal.z)
        light = _reflected(space, air, surface, hit.distance_m, slots)
        glow = kept * self._surfaces.glow_cd_m2(hit)
        sky = air.sky_towards(direction)
        ambient = dr.select(hit.is_hit, dr.lerp(sky, skylight, kept) + glow, sky)
        ambient = _placed(ambient, slots)
        distance = _placed(dr.select(hit.is_hit, hit.distance_m, dr.nan), slots)
        material = _placed(dr.select(hit.is_hit, hit.material, NO_MATERIAL), slots)
        body = _placed(dr.select(hit.is_hit, hit.body, -1), slots)
        dr.eval(light, ambient, distance, material, body)
        return _Shot(light.numpy().reshape(space.lights.num_layers, -1), ambient.numpy(), distance, material, body)


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """One sample per ray: arrays where they are summed, Dr.Jit values where further kernels read them."""

    surface_cd_m2: Floats32
    ambient_cd_m2: Floats32
    distance_m: Number
    material: Number
    body: Number


def _reflected(space: Space, air: Air, surface: Surface, distance_m: Number, slots: Number) -> Number:
    """Light that reaches the camera from the surfaces, cd/m^2, ordered by layer and slot."""

    def luminance(number: Number) -> Number:
        light = space.lights.towards(surface.position, number)
        lost = dr.exp(-air.scattering_per_m * (distance_m + light.distance_m))
        illuminance = light.intensity_cd * lost / greatest(dr.square(light.distance_m), 1e-4)

        def sent(illuminance: Number, distance_m: Number, *direction: Number) -> Number:
            return _sent(space, surface, illuminance, mi.Vector3f(*direction), distance_m)

        # Rays that are computed together pass over a lamp that lights none of them: most vehicles' lamps look away.
        counts = illuminance > space.darkest_cd_m2 / MOST_REFLECTED_PER_SR
        values = (illuminance, light.distance_m, *light.direction)
        return dr.if_stmt(values, counts, sent, lambda *_: mi.Float(0.0))

    return space.lights.summed(slots, surface.is_hit, luminance)


def _sent(space: Space, surface: Surface, illuminance_lx: Number, direction: Number, distance_m: Number) -> Number:
    """Luminance of the surfaces in the light of a lamp in `direction`, unless something is in between."""
    sent = illuminance_lx * reflectance_per_sr(surface, direction)
    counts = sent > space.darkest_cd_m2
    side = dr.select(dr.dot(surface.outward, direction) > 0, START_GAP_M, -START_GAP_M)
    start = surface.position + surface.outward * side + direction * START_GAP_M
    blocked = space.world.is_blocked(start, direction, distance_m - END_GAP_M, counts)
    return dr.select(counts & ~blocked, sent, 0.0)


def _placed(values: Number, slots: Number) -> Number:
    """The values reordered into their slots."""
    out = dr.empty(type(values), dr.width(slots))
    dr.scatter(out, values, slots)
    return out
