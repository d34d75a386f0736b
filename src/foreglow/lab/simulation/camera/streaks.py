"""Rain and snow in our own lamps' light, drawn as the streaks that appear during the exposure.

Every particle has a position in a space that repeats like tiles, and falls at its own speed while we drive past: it is
the same from frame to frame until it leaves the tile around the camera's view, which is some ten metres deep. Particles
further away are too faint to be seen individually; they are part of the haze.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Floats, Pose
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX, Image
from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.scenes.scene import WeatherSpec
from foreglow.photometry import illuminance_lx

PARTICLES_STREAM = 43
"""Number of the random stream."""

MAX_RANGE_M = 24.0
MAX_IN_VIEW = 16_000
"""Largest number of particles in view; the range is shortened accordingly in heavy rain or snow."""

MIN_RANGE_M = 0.6
"""Nearer particles would be on the windscreen."""

SNOW_MIN_MM, RAIN_MIN_MM = 0.9, 1.0
"""Smallest diameters, of the drop or the molten flake, that are drawn: smaller ones are not seen individually."""

LARGE_FLAKE_MM = 1.9
"""Molten diameter from which on flakes are drawn further away, where smaller ones are too faint to be seen."""

FLAKE_SWELLING = 3.5
"""Ratio of the diameters of a flake and its drop: large flakes have some 2 % of the density of water."""

FLAKE_SCATTERING_PER_SR = 0.0045
"""Intensity towards the lamp per illuminance and cross-section, by which streaks stand out from a wet road as in real
frames: a fortieth of that of a white Lambertian sphere, since flakes are mostly gaps.
"""

DROP_SCATTERING_PER_SR = 0.02
"""The same for a drop, which reflects little but its glints; similar to Mie calculations."""

APERTURE_M = 6e-3
"""Aperture of the lens, which is focused far away: near particles are blurred by this size."""

BLURS_PX = (0.0, 1.0, 2.2)
"""Standard deviations, in pixels of 1280 columns, of three classes of streaks by size and focus."""

SPACINGS_PX = (2.0, 2.5, 4.0)
"""Distances, in pixels of 1280 columns, of the points of a streak in each class: blur and lens close the gaps."""

MAX_POINTS = 128
"""Largest number of points in a streak; streaks that would need more are close to the camera and leave the image."""

MIN_LUMINANCE_CD_M2 = 1e-4
"""Fainter streaks are left out: 0.1 grey levels of the long exposure."""

TUMBLING_HZ, MAX_TUMBLING = (20.0, 250.0), 0.9
"""Flakes turn as they fall, and so become brighter and darker by up to this share: streaks look dashed."""

FADING_SHARE = 0.3
"""Last part of the range, over which particles fade in."""


@dataclass(frozen=True, slots=True, eq=False)
class _Particles:
    """Positions in the tile at time 0 and velocities in the world, shape (N, 3), and properties, shape (N,).

    `tumbling` has shape (N, 3): the share by which each becomes brighter and darker, how often a second, and the phase.
    """

    positions_m: Floats
    velocities_mps: Floats
    diameters_m: Floats
    cross_sections_m2_sr: Floats
    tumbling: Floats


class FallingParticles:
    """The rain and snow of a drive.

    Attributes:
        swarms: Small flakes near us, large ones further away, and drops.
    """

    def __init__(self, weather: WeatherSpec, camera: Camera, seed: int) -> None:
        rng = np.random.default_rng([seed, PARTICLES_STREAM])
        snow, rain = _gunn_marshall(weather.snow_mm_h), _marshall_palmer(weather.rain_mm_h)
        self._camera = camera
        self.swarms = [
            _Swarm(camera, snow, (SNOW_MIN_MM, LARGE_FLAKE_MM), rng, is_snow=True),
            _Swarm(camera, snow, (LARGE_FLAKE_MM, np.inf), rng, is_snow=True),
            _Swarm(camera, rain, (RAIN_MIN_MM, np.inf), rng, is_snow=False),
        ]

    def luminance(
        self,
        time_s: float,
        exposure_s: float,
        world_from_camera: tuple[Pose, Pose],
        lamps: Sequence[PlacedLamp],
        depth_m: Image | None = None,
    ) -> Image:
        """Luminance of the particles, shape (H, W), float32, cd/m², before the optics; 0 without particles.

        Args:
            time_s: Time at which the shutter opens.
            exposure_s: Duration of the exposure.
            world_from_camera: The camera's poses at its begin and end.
            lamps: Our own lamps, which light the particles; there are no shadows.
            depth_m: Shape (H, W), along each pixel's ray; particles behind it are hidden. None hides nothing.
        """
        image = np.zeros((self._camera.height_px, self._camera.width_px), np.float32)
        for swarm in self.swarms:
            swarm.draw(image, (time_s, exposure_s), world_from_camera, lamps, depth_m)
        return image


class _Swarm:
    """Particles of one kind, of diameters between two limits.

    Attributes:
        particles: They repeat like tiles.
        range_m: Up to which they are drawn.
    """

    def __init__(
        self,
        camera: Camera,
        spectrum: tuple[float, float],
        limits_mm: tuple[float, float],
        rng: np.random.Generator,
        *,
        is_snow: bool,
    ) -> None:
        """Draws the particles of a `spectrum`: density per m³ and mm at 0, and its decay per mm.

        Diameters are those of drops, or of molten flakes.
        """
        self._camera = camera
        per_m3_mm, decay_per_mm = spectrum
        shares = np.exp(-decay_per_mm * np.array(limits_mm))
        density_per_m3 = per_m3_mm / decay_per_mm * float(shares[0] - shares[1])
        half_width = 0.5 * camera.width_px / camera.focal_px[0]
        half_height = 0.5 * camera.height_px / camera.focal_px[1]
        in_view_per_m3 = 4.0 / 3.0 * half_width * half_height  # volume of the pyramid of range 1
        self.range_m = MAX_RANGE_M
        if density_per_m3 > 0:
            self.range_m = min(MAX_RANGE_M, (MAX_IN_VIEW / (in_view_per_m3 * density_per_m3)) ** (1.0 / 3.0))
        # A tile contains the whole view for any yaw of the camera, with some room for its pitch.
        across = 2.0 * float(np.hypot(0.5, half_width)) * self.range_m
        self._tile_m = np.array([across, across, 2.3 * half_height * self.range_m])
        num = round(density_per_m3 * self._tile_m.prod())
        molten_mm = -np.log(rng.uniform(shares[1], shares[0], num)) / decay_per_mm
        diameters = 1e-3 * molten_mm * (FLAKE_SWELLING if is_snow else 1.0)
        # Atlas et al. 1973 for drops; flakes of all sizes fall at about 1 m/s, and drift.
        fall_mps = rng.normal(1.0, 0.2, num) if is_snow else 9.65 - 10.3 * np.exp(-0.6 * molten_mm)
        drift_mps = rng.normal(0.0, 0.35 if is_snow else 0.1, (num, 2))
        scattering = FLAKE_SCATTERING_PER_SR if is_snow else DROP_SCATTERING_PER_SR
        depths = rng.uniform(0.0, MAX_TUMBLING if is_snow else 0.0, num)
        turns_hz = np.exp(rng.uniform(np.log(TUMBLING_HZ[0]), np.log(TUMBLING_HZ[1]), num))
        self.particles = _Particles(
            rng.uniform(0.0, 1.0, (num, 3)) * self._tile_m,
            np.column_stack([drift_mps, -fall_mps]),
            diameters,
            scattering * np.pi / 4.0 * diameters**2,
            np.column_stack([depths, turns_hz, rng.uniform(0.0, 1.0, num)]),
        )

    def draw(
        self,
        image: Image,
        times_s: tuple[float, float],
        world_from_camera: tuple[Pose, Pose],
        lamps: Sequence[PlacedLamp],
        depth_m: Image | None,
    ) -> None:
        """Adds the particles to `image`; the rest as for `FallingParticles.luminance`."""
        if not len(self.particles.diameters_m):
            return
        time_s, exposure_s = times_s
        opened, closed = world_from_camera
        centre = opened.to_outer([0.5 * self.range_m, 0.0, 0.0])
        velocities = self.particles.velocities_mps
        wrapped = (self.particles.positions_m + velocities * time_s - centre) % self._tile_m
        worlds = wrapped - self._tile_m * np.round(wrapped / self._tile_m) + centre
        starts = opened.to_body(worlds)
        kept = np.flatnonzero(self._in_view(starts))
        starts = starts[kept]
        ends = closed.to_body(worlds[kept] + velocities[kept] * exposure_s)
        is_ahead = np.minimum(starts[:, 0], ends[:, 0]) > MIN_RANGE_M
        kept, starts, ends = kept[is_ahead], starts[is_ahead], ends[is_ahead]
        if not len(kept):
            return
        middles = 0.5 * (starts + ends)
        ranges = np.linalg.norm(middles, axis=1)
        intensities = self.particles.cross_sections_m2_sr[kept] * self._illuminances_lx(middles, opened, lamps)
        fading = np.clip((self.range_m - ranges) / (FADING_SHARE * self.range_m), 0.0, 1.0)
        fluxes = intensities * fading / (ranges**2 * self._camera.pixel_solid_angle_sr)
        if depth_m is not None:
            fluxes *= ranges < self._depths_m(middles, depth_m)
        scale = self._camera.width_px / REFERENCE_WIDTH_PX
        sizes_px = np.hypot(self.particles.diameters_m[kept], APERTURE_M) * self._camera.focal_px[0] / ranges
        # A disc's standard deviation is a quarter of its diameter.
        sorts = np.searchsorted([0.6 * scale, 1.5 * scale], 0.25 * sizes_px)
        for sort, (blur_px, spacing_px) in enumerate(zip(BLURS_PX, SPACINGS_PX, strict=True)):
            chosen = np.flatnonzero((sorts == sort) & (fluxes > 0))
            tumbling = self.particles.tumbling[kept[chosen]] * (1.0, exposure_s, 1.0)
            layer = self._drawn((starts[chosen], ends[chosen]), fluxes[chosen], tumbling, spacing_px * scale)
            cv2.add(image, cv2.GaussianBlur(layer, (0, 0), blur_px * scale) if blur_px else layer, dst=image)

    def _in_view(self, points_camera: Floats) -> NDArray[np.bool_]:
        """Whether the camera may see a point during the exposure; wider than its view, for streaks that enter it."""
        forward = points_camera[:, 0]
        margin = 1.15 * forward + 0.3
        half_width = 0.5 * self._camera.width_px / self._camera.focal_px[0]
        half_height = 0.5 * self._camera.height_px / self._camera.focal_px[1]
        return np.asarray(
            (forward > MIN_RANGE_M)
            & (forward < self.range_m)
            & (np.abs(points_camera[:, 1]) < margin * half_width)
            & (np.abs(points_camera[:, 2]) < margin * half_height)
        )

    def _illuminances_lx(self, points_camera: Floats, world_from_camera: Pose, lamps: Sequence[PlacedLamp]) -> Floats:
        worlds = world_from_camera.to_outer(points_camera)
        total = np.zeros(len(worlds))
        for lamp in lamps:
            total += lamp.scale * illuminance_lx(lamp.table, lamp.world_from_lamp, worlds)
        return total

    def _depths_m(self, points_camera: Floats, depth_m: Image) -> Floats:
        """Depth of the image at the points; infinite outside it and where it is NaN."""
        pixels = np.floor(np.nan_to_num(self._camera.project(points_camera), nan=-1.0)).astype(np.intp)
        height, width = depth_m.shape
        is_inside = (pixels >= 0).all(1) & (pixels < (width, height)).all(1)
        depths = np.full(len(pixels), np.inf)
        depths[is_inside] = np.nan_to_num(depth_m[pixels[is_inside, 1], pixels[is_inside, 0]], nan=np.inf)
        return depths

    def _drawn(self, between: tuple[Floats, Floats], fluxes: Floats, tumbling: Floats, spacing_px: float) -> Image:
        """Streaks, shape (H, W): each particle's flux, spread over the time from start to end.

        `tumbling` is that of the particles, with turns during the exposure.
        """
        starts, ends = between
        height, width = self._camera.height_px, self._camera.width_px
        from_px, to_px = self._camera.project(starts), self._camera.project(ends)
        lengths = np.linalg.norm(to_px - from_px, axis=1)
        seen = np.flatnonzero(fluxes > MIN_LUMINANCE_CD_M2 * (lengths + 1.0))
        nums = np.clip(np.ceil(lengths[seen] / spacing_px), 1, MAX_POINTS).astype(np.intp)
        streak = np.repeat(np.arange(len(seen)), nums)
        first = np.repeat(np.cumsum(nums) - nums, nums)
        shares = ((np.arange(len(streak)) - first + 0.5) / nums[streak]).astype(np.float32)
        depths, turns, phases = tumbling[seen].astype(np.float32).T
        weights = (fluxes[seen] / nums).astype(np.float32)[streak]
        weights *= 1.0 + depths[streak] * np.cos(np.float32(2.0 * np.pi) * (phases[streak] + shares * turns[streak]))
        # Particles move faster through the image while they are near: points are evenly spaced in space, not along the
        # streak. The curvature of streaks by the lens's distortion is invisible.
        approach = (starts[seen, 0] / ends[seen, 0]).astype(np.float32)[streak]
        shares /= shares + approach * (1.0 - shares)
        x, y = (
            from_px[seen, axis].astype(np.float32)[streak]
            + shares * (to_px - from_px)[seen, axis].astype(np.float32)[streak]
            - np.float32(0.5)
            for axis in (0, 1)
        )
        inside = np.flatnonzero((x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1))
        x, y, weights = x[inside], y[inside], weights[inside]
        column, row = x.astype(np.int32), y.astype(np.int32)
        u, v = x - column, y - row
        corner = row * width + column
        corners = np.concatenate([corner, corner + 1, corner + width, corner + width + 1])
        parts = np.concatenate([(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]) * np.tile(weights, 4)
        return np.bincount(corners, parts, height * width).astype(np.float32).reshape(height, width)


def _gunn_marshall(snow_mm_h: float) -> tuple[float, float]:
    """Flakes per m³ and mm of molten diameter at 0, and the decay of their number per mm.

    Source: Gunn and Marshall, The distribution with size of aggregate snowflakes, 1958: N0 = 3800 R^-0.87, slope
    2.55 R^-0.48.
    """
    if snow_mm_h == 0:
        return 0.0, 1.0
    return 3800.0 * snow_mm_h**-0.87, 2.55 * snow_mm_h**-0.48


def _marshall_palmer(rain_mm_h: float) -> tuple[float, float]:
    """Drops per m³ and mm of diameter at 0, and the decay of their number per mm.

    Source: Marshall and Palmer, The distribution of raindrops with size, 1948: N0 = 8000, slope 4.1 R^-0.21.
    """
    if rain_mm_h == 0:
        return 0.0, 1.0
    return 8000.0, 4.1 * rain_mm_h**-0.21
