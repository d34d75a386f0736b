"""A lens behind a windscreen: veil, ghosts and streaks around the point spread, and our own car in the image.

Veils are smooth beyond a degree or so: they are computed on a coarse grid, and lamps get the rest from a small picture
of the veil's core and of the streaks, which is shifted to each of them. The tail of the lens is one of the veils here,
and faint parts of its kernels are left out: the light is within 8 % of that of `Optics`, the exact lens, everywhere,
and within 2 % on nearly all pixels, at a quarter of the cost.
"""

from __future__ import annotations

import zlib
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX, Image, LampPoints, Optics
from foreglow.lab.simulation.camera.profile import CameraProfile, CarSpec, LensSpec, StreakSpec, VeilSpec
from foreglow.lab.simulation.scenes.scene import SensorSpec

VEIL_DEG = 30.0
"""The share of a veil is the light within this angle."""

COARSE_COLUMNS = 160
"""Columns of the grid on which veils are computed."""

NEAR_PX, JOINED_PX = 24.0, 56.0
"""Up to the first distance from a lamp, in pixels of 1280 columns, a veil is drawn in full; from the second one on it
is that of the coarse grid."""

COARSE_EDGE = 4.0
"""Cells of the coarse grid from which on a ghost's edge is wide."""

SURFACE_STEP = 2
"""Streaks of surfaces are computed for every second pixel."""

STREAK_LENGTHS = 4.0
"""A streak is drawn up to so many of its lengths."""

GLINT, GLINT_SHARE = 4.0, 0.004
"""Luminance of the bonnet's edge where it shines, relative to the bonnet, and its width as a share of the rows."""

CAR_STREAM, DIRT_STREAM = 44, 47
"""Numbers of the random streams: the dashboard's reflections, and how dirty the windscreen is in a drive."""

HARMONICS = np.arange(1, 7)
"""Waves around a rough ghost's outline."""

OUTLINE_POINTS = 720

FAINT_KERNEL, FAINT_END = 1e-3, 1e-4
"""What a separable kernel and the ends of one have to exceed, relative to the strongest one and to its middle."""

MAX_DIRT_SHARE = 0.6
"""Largest share of scattered light in any drive."""


class Windscreen(Optics):
    """The lens of a profile, with the windscreen in front of it, as they are in one drive."""

    def __init__(self, profile: CameraProfile, sensor: SensorSpec, camera: Camera, seed: int = 0) -> None:
        """The optics of `profile` for images of `camera`.

        Args:
            profile: The profile.
            sensor: The scene's own, for profiles that use it.
            camera: The calibration.
            seed: The scene's seed, from which the dirt of this drive follows.
        """
        rng = np.random.default_rng([seed, DIRT_STREAM, zlib.crc32(profile.name.encode())])
        lens = _as_dirty_as_today(profile.lens, rng)
        self._outlines = [_outline(ghost.roughness, rng) for ghost in lens.ghosts]
        super().__init__(sensor if profile.imager.model == "scene" else _plain(lens, camera), camera)
        self._direct_share = np.float32(1.0 - lens.scattered_share)
        self._veil_tail, self._tail = self._tail * float(self._direct_share), 0.0
        self._veils, self._ghosts = lens.veils, lens.ghosts
        self._step = max(1, round(camera.width_px / COARSE_COLUMNS))
        self._coarse = (-(-camera.height_px // self._step), -(-camera.width_px // self._step))
        self._veil_spectrum, self._spectrum_shape = self._veil_of_surfaces()
        self._far_kernel = self._veil_of_lamps()
        self._near_picture = self._picture(lens)
        self._surface_streaks = self._streaks_of_surfaces(lens)
        self.transmission, self.static_cd_m2 = _own_car(profile.car, profile.name, camera)

    def spread(self, luminance: Image) -> Image:
        """As `Optics.spread`, with the veil, behind our own bonnet."""
        seen = luminance if self.transmission is None else luminance * self.transmission
        spread = super().spread(seen)
        if self._direct_share < 1.0:
            spread *= self._direct_share
        if self._veil_spectrum is not None:
            rows, columns = self._coarse
            size = (columns * self._step, rows * self._step)
            padded = cv2.copyMakeBorder(
                luminance, 0, size[1] - luminance.shape[0], 0, size[0] - luminance.shape[1], cv2.BORDER_REPLICATE
            )
            small = cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA)
            shape = self._spectrum_shape
            veil = irfft2(rfft2(small, shape) * self._veil_spectrum, shape)[:rows, :columns]
            spread += self._enlarged(np.maximum(veil, 0.0).astype(np.float32))
        if self._surface_streaks is not None:
            size = (-(-luminance.shape[1] // SURFACE_STEP), -(-luminance.shape[0] // SURFACE_STEP))
            small = cv2.resize(luminance, size, interpolation=cv2.INTER_AREA)
            arms = cv2.filter2D(small, -1, self._surface_streaks, borderType=cv2.BORDER_REPLICATE)
            spread += cv2.resize(np.maximum(arms, 0.0), luminance.shape[::-1], interpolation=cv2.INTER_LINEAR)
        return spread

    def draw_points(self, points: LampPoints) -> Image:
        """As `Optics.draw_points`, with veil, streaks and ghosts; the bonnet hides lamps, but not their veil."""
        is_lit = points.illuminances_lx > 0
        points = LampPoints(points.positions_px[is_lit], points.illuminances_lx[is_lit], points.radii_px[is_lit])
        is_free = np.array([self._is_free(x, y) for x, y in points.positions_px], bool)
        image = super().draw_points(
            LampPoints(points.positions_px[is_free], points.illuminances_lx[is_free], points.radii_px[is_free])
        )
        if self._direct_share < 1.0:
            image *= self._direct_share
        fluxes = points.illuminances_lx / self._pixel_solid_angles_sr(points.positions_px)
        lamps = [(float(x), float(y), float(flux)) for (x, y), flux in zip(points.positions_px, fluxes, strict=True)]
        coarse = np.zeros(self._coarse, np.float32) if self._far_kernel is None else self._far(lamps)
        for lamp, radius_px in zip(lamps, points.radii_px, strict=True):
            if self._near_picture is not None:
                _add_shifted(image, self._near_picture, *lamp)
            for number in range(len(self._ghosts)):
                self._add_ghost((image, coarse), number, lamp, float(radius_px))
        image += self._enlarged(coarse)
        return image

    def _is_free(self, x: float, y: float) -> bool:
        if self.transmission is None or not (0 <= x < self.camera.width_px and 0 <= y < self.camera.height_px):
            return True
        return bool(self.transmission[int(y), int(x)] > 0.5)

    def _enlarged(self, coarse: Image) -> Image:
        """A coarse image at full resolution."""
        size = (coarse.shape[1] * self._step, coarse.shape[0] * self._step)
        whole = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(whole[: self.camera.height_px, : self.camera.width_px])

    def _far(self, lamps: list[tuple[float, float, float]]) -> Image:
        """The veil of lamps away from them, on the coarse grid."""
        rows, columns = self._coarse
        far = np.zeros((rows, columns), np.float32)
        kernel = self._far_kernel
        assert kernel is not None
        middle_y, middle_x = kernel.shape[0] // 2, kernel.shape[1] // 2
        for x, y, flux in lamps:
            at_x, at_y = x / self._step - 0.5, y / self._step - 0.5
            shift = np.array([[1, 0, middle_x - at_x], [0, 1, middle_y - at_y]], np.float64)
            veil = cv2.warpAffine(kernel, shift, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            far += veil * np.float32(flux)
        return far

    def _add_ghost(
        self, images: tuple[Image, Image], number: int, lamp: tuple[float, float, float], radius_px: float
    ) -> None:
        """Adds the second image called `number` of a lamp, given with its position and flux.

        A ghost with a wide edge goes into the second image, which is coarse, any other into the first.
        """
        ghost = self._ghosts[number]
        focal = np.array(self.camera.focal_px)
        centre = np.array(self.camera.centre_px)
        shift = np.tan(np.radians(ghost.shift_deg)) * focal
        x, y = centre + ghost.scale * (np.array(lamp[:2]) - centre) + shift
        radii = np.hypot(np.radians(ghost.radius_deg) * focal, abs(ghost.scale) * radius_px) + 0.7
        strength = lamp[2] * ghost.strength / (np.pi * float(radii.prod()))
        image, edge_px = images[0], ghost.softness * float(radii.min())
        if edge_px > COARSE_EDGE * self._step:
            image, x, y, radii = images[1], x / self._step, y / self._step, radii / self._step
        reach = radii * (1.0 + ghost.softness + 2.5 * ghost.roughness) + 1.0
        window = _window(image, x, y, reach)
        if window is None:
            return
        (y0, y1), (x0, x1) = window
        across = (np.arange(x0, x1, dtype=np.float32) + 0.5 - x) / radii[0]
        down = (np.arange(y0, y1, dtype=np.float32) + 0.5 - y)[:, np.newaxis] / radii[1]
        edge = ghost.softness + 1.0 / float(radii.min())
        outline: Floats | float = 1.0
        if ghost.roughness > 0:
            turns = np.arctan2(down, across) / (2.0 * np.pi)
            outline = self._outlines[number][(turns * OUTLINE_POINTS).astype(np.intp)]  # negative ones from the end
        disc = np.clip((outline - np.sqrt(across**2 + down**2)) / edge + 0.5, 0.0, 1.0)
        # The integral of a disc with a linear edge.
        image[y0:y1, x0:x1] += (strength / (1.0 + edge**2 / 12.0) * disc).astype(np.float32)

    @cached_property
    def _kernels(self) -> tuple[tuple[Floats, Floats], ...]:
        """Those of `Optics` that matter, symmetric to the last bit, which OpenCV filters in half the time."""
        kernels = super()._kernels
        strengths = [np.abs(across).max() * np.abs(down).max() for across, down in kernels]
        num = int(np.searchsorted(-np.array(strengths), -FAINT_KERNEL * strengths[0]))
        return tuple((_trimmed(across), _trimmed(down)) for across, down in kernels[:num])

    @property
    def _is_veiled(self) -> bool:
        return bool(self._veils) or self._veil_tail > 0

    def _veil_of_surfaces(self) -> tuple[NDArray[np.complex64] | None, tuple[int, int]]:
        """Spectrum of the veil of extended sources, whose elements are means over a cell times its solid angle."""
        rows, columns = self._coarse
        shape = (next_fast_len(2 * rows, True), next_fast_len(2 * columns, True))
        if not self._is_veiled:
            return None, shape
        down, across = (np.fft.fftfreq(num, 1 / num) * self._step for num in shape)
        kernel = np.zeros(shape)
        offsets = (np.arange(4) - 1.5) / 4 * self._step
        for dy in offsets:
            for dx in offsets:
                distances = np.hypot(down[:, np.newaxis] + dy, across + dx)
                kernel += self._veil(distances) / 16
        return rfft2(kernel * self._step**2).astype(np.complex64), shape

    def _veil_of_lamps(self) -> Image | None:
        """The veil of a lamp of unit flux on the coarse grid, without its core, for lamps at its middle."""
        if not self._is_veiled:
            return None
        down, across = (np.arange(-2 * num, 2 * num + 1) * self._step for num in self._coarse)
        distances = np.hypot(down[:, np.newaxis], across)
        return np.asarray(self._veil(distances) * (1.0 - self._near_weight(distances)), np.float32)

    def _picture(self, lens: LensSpec) -> Image | None:
        """The veil's core and the streaks of a lamp of unit flux, for a lamp at its middle."""
        if not self._is_veiled and not lens.streaks:
            return None
        deg_px = np.radians(1.0) * self.camera.focal_px[0]
        reach = JOINED_PX * self._scale + 2
        for streak in lens.streaks:
            reach = max(reach, STREAK_LENGTHS * streak.length_deg * deg_px)
        along = np.arange(-int(reach) - 1, int(reach) + 2, dtype=np.float64)
        distances = np.hypot(along[:, np.newaxis], along)
        picture = self._veil(distances) * self._near_weight(distances)
        for streak in lens.streaks:
            picture += _streaks(streak, along, deg_px) * np.clip(4.0 * (1.0 - distances / reach), 0.0, 1.0)
        return np.asarray(picture, np.float32)

    def _streaks_of_surfaces(self, lens: LensSpec) -> Image | None:
        """The streaks that surfaces have, of one pixel of the coarser image that they are computed on."""
        streaks = [streak for streak in lens.streaks if streak.of_surfaces]
        if not streaks:
            return None
        deg_px = np.radians(1.0) * self.camera.focal_px[0] / SURFACE_STEP
        reach = int(STREAK_LENGTHS * max(streak.length_deg for streak in streaks) * deg_px) + 1
        along = np.arange(-reach, reach + 1, dtype=np.float64)
        fading = np.clip(4.0 * (1.0 - np.hypot(along[:, np.newaxis], along) / reach), 0.0, 1.0)
        picture = np.sum([_streaks(streak, along, deg_px) for streak in streaks], axis=0) * fading
        return np.asarray(picture[::-1, ::-1], np.float32)  # OpenCV correlates

    def _near_weight(self, distances_px: Floats) -> Floats:
        near, joined = NEAR_PX * self._scale, JOINED_PX * self._scale
        share = np.clip((joined - distances_px) / (joined - near), 0.0, 1.0)
        return np.asarray(share * share * (3.0 - 2.0 * share))

    def _veil(self, distances_px: Floats) -> Floats:
        """Luminance at distances from a source of unit flux, 1 cd/m² on one pixel."""
        angles = np.degrees(np.arctan(distances_px / self.camera.focal_px[0]))
        total = self._veil_tail / (distances_px**2 + self._softening_px**2)
        for veil in self._veils:
            total += veil.share * _scattering_per_sr(veil, angles) * self.camera.pixel_solid_angle_sr
        return np.asarray(total)


def _trimmed(kernel: Floats) -> Floats:
    """A kernel that is symmetric but for rounding, exactly so, and without its faint ends."""
    cut = int(np.argmax(np.abs(kernel) > FAINT_END * np.abs(kernel).max()))
    kept = kernel[cut : len(kernel) - cut]
    return np.asarray(0.5 * (kept + kept[::-1]))


def _scattering_per_sr(veil: VeilSpec, angles_deg: Floats) -> Floats:
    """Scattered light per solid angle, of one unit within `VEIL_DEG`."""

    def shape(angles: Floats) -> Floats:
        return np.asarray((veil.angle_deg**2 + angles**2) ** (-0.5 * veil.exponent))

    steps = np.linspace(0.0, 1.0, 4001) ** 3 * VEIL_DEG
    rings = 2.0 * np.pi * np.sin(np.radians(steps)) * shape(steps)
    return np.asarray(shape(angles_deg) / np.trapezoid(rings, np.radians(steps)))


def _as_dirty_as_today(lens: LensSpec, rng: np.random.Generator) -> LensSpec:
    """The lens with its shares, strengths, radii and lengths as drawn for one drive."""

    def drawn(value: float, largest: float = np.inf) -> float:
        return float(min(value * np.exp(lens.variety * rng.standard_normal()), largest))

    if lens.variety == 0:
        return lens
    factor = drawn(1.0, MAX_DIRT_SHARE / max(lens.scattered_share, 1e-3))
    aside_deg = 0.5 * lens.variety * float(rng.standard_normal())
    return lens.model_copy(
        update={
            "veils": tuple(veil.model_copy(update={"share": veil.share * factor}) for veil in lens.veils),
            "ghosts": tuple(
                ghost.model_copy(
                    update={
                        "strength": drawn(ghost.strength),
                        "radius_deg": (drawn(ghost.radius_deg[0]), drawn(ghost.radius_deg[1])),
                        "shift_deg": (ghost.shift_deg[0] + aside_deg, drawn(ghost.shift_deg[1])),
                    }
                )
                for ghost in lens.ghosts
            ),
            "streaks": tuple(
                streak.model_copy(
                    update={
                        "share": streak.share * factor,
                        "length_deg": drawn(streak.length_deg),
                        "angle_deg": streak.angle_deg + 20.0 * lens.variety * float(rng.standard_normal()),
                    }
                )
                for streak in lens.streaks
            ),
        }
    )


def _outline(roughness: float, rng: np.random.Generator) -> Floats:
    """Relative radius of a ghost over the directions, shape (OUTLINE_POINTS,)."""
    angles = 2.0 * np.pi * (np.arange(OUTLINE_POINTS) + 0.5) / OUTLINE_POINTS
    waves = np.outer(angles, HARMONICS)
    parts = rng.standard_normal((2, len(HARMONICS))) / np.sqrt(len(HARMONICS))
    return np.asarray(np.clip(1.0 + roughness * (np.cos(waves) @ parts[0] + np.sin(waves) @ parts[1]), 0.3, 2.0))


def _streaks(streak: StreakSpec, along_px: Floats, deg_px: float) -> Floats:
    """Arms around the middle of a square picture, whose sum over an endless plane is the streak's share."""
    x, y = along_px[np.newaxis, :], -along_px[:, np.newaxis]
    length, width = streak.length_deg * deg_px, max(streak.width_deg * deg_px, 0.6)
    total = np.zeros((len(along_px), len(along_px)))
    for number in range(streak.num_arms):
        angle = np.radians(streak.angle_deg) + 2.0 * np.pi * number / streak.num_arms
        out, off = x * np.cos(angle) + y * np.sin(angle), -x * np.sin(angle) + y * np.cos(angle)
        widened = width * (1.0 + 0.5 * np.maximum(out, 0.0) / length)
        total += np.where(out > 0, np.exp(-np.maximum(out, 0.0) / length - 0.5 * (off / widened) ** 2) / widened, 0.0)
    return np.asarray(streak.share / streak.num_arms * total / (length * np.sqrt(2.0 * np.pi)))


def _plain(lens: LensSpec, camera: Camera) -> SensorSpec:
    """A point spread that is only a core; `SensorSpec` measures it in pixels of 1280 columns, pixels included."""
    scale = camera.width_px / REFERENCE_WIDTH_PX
    core_px = np.sqrt(max(lens.core_px**2 - 1.0 / 12.0, 0.0) / scale**2 + 1.0 / 12.0)
    return SensorSpec(core_px=float(core_px), middle_share=0.0, tail_share=0.0, vignetting=lens.vignetting)


def _window(image: Image, x: float, y: float, reach_px: Floats) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Rows and columns of the image within reach of a point; None if there are none."""
    height, width = image.shape
    x0, x1 = max(0, int(np.floor(x - reach_px[0]))), min(width, int(np.ceil(x + reach_px[0])) + 1)
    y0, y1 = max(0, int(np.floor(y - reach_px[1]))), min(height, int(np.ceil(y + reach_px[1])) + 1)
    return ((y0, y1), (x0, x1)) if x0 < x1 and y0 < y1 else None


def _add_shifted(image: Image, picture: Image, x: float, y: float, factor: float) -> None:
    """Adds `picture` times `factor` to `image`, with its middle at the point x, y."""
    half = picture.shape[0] // 2
    window = _window(image, x, y, np.array([half, half], np.float64))
    if window is None:
        return
    (y0, y1), (x0, x1) = window
    shift = np.array([[1, 0, x0 + 0.5 - x + half], [0, 1, y0 + 0.5 - y + half]], np.float64)
    size = (x1 - x0, y1 - y0)
    shifted = cv2.warpAffine(picture, shift, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    image[y0:y1, x0:x1] += shifted * np.float32(factor)


def _own_car(car: CarSpec, name: str, camera: Camera) -> tuple[Image | None, Image | None]:
    """Share of the light that passes our bonnet, and the light of bonnet and dashboard, cd/m²; None without."""
    if car.bonnet_share == 0 and car.num_reflections == 0:
        return None, None
    height, width = camera.height_px, camera.width_px
    static = np.zeros((height, width), np.float32)
    transmission = None
    x = np.linspace(-1.0, 1.0, width, dtype=np.float32)
    if car.bonnet_share > 0:
        edge = height * (1.0 - car.bonnet_share * (1.0 - 0.45 * x**2 - 0.05 * x))
        rows = np.arange(height, dtype=np.float32)[:, np.newaxis] + 0.5
        transmission = np.clip((edge - rows) / (0.008 * height) + 0.5, 0.0, 1.0).astype(np.float32)
        sheen = 0.4 + 0.6 * np.exp(-np.maximum(rows - edge, 0.0) / (0.03 * height))
        static += (1.0 - transmission) * np.float32(car.bonnet_cd_m2) * sheen
    rng = np.random.default_rng([CAR_STREAM, zlib.crc32(name.encode())])
    if car.bonnet_share > 0:
        waves = rng.uniform(1.0, 6.0, 3) * x[:, np.newaxis] + rng.uniform(0.0, 2 * np.pi, 3)
        along = np.clip(np.sin(np.pi * waves).sum(1), 0.0, None).astype(np.float32)
        glint = np.exp(-0.5 * ((rows - edge) / (GLINT_SHARE * height)) ** 2)
        static += np.float32(car.bonnet_cd_m2 * GLINT) * along * glint
    for number in range(car.num_reflections):
        middle = rng.uniform([0.05, 0.55], [0.95, 1.0]) * (width, height)
        size = rng.uniform([0.02, 0.006], [0.16, 0.04]) * (width, height)
        corners = cv2.boxPoints((tuple(middle), tuple(size), float(rng.uniform(-25, 25))))
        patch = np.zeros((height, width), np.float32)
        cv2.fillConvexPoly(patch, np.rint(corners).astype(np.int32), 1.0, cv2.LINE_AA)
        blur = float(rng.uniform(0.001, 0.012)) * width
        brightness = car.reflection_cd_m2 * (1.0 if number == 0 else float(rng.uniform(0.1, 0.8)))
        static += cv2.GaussianBlur(patch, (0, 0), blur) * np.float32(brightness)
    return transmission, static
