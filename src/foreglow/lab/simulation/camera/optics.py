"""The lens: point spread, glare over the whole image, and fall-off towards the corners.

The point spread of an image of 1280 columns is a Gaussian core, an exponential part, and a 1/r² tail, which is veiling
glare; all of them include the aperture of a pixel. An image of fewer columns averages such pixels. Lamps are brighter
than their surroundings by seven decades, too much for an FFT in single precision: they are drawn as points, while
extended sources are convolved as an image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import zoom
from scipy.special import erf

from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.scenes.scene import SensorSpec
from foreglow.wording import shortened

Image = NDArray[np.float32]

REFERENCE_WIDTH_PX = 1280
"""Columns of the image whose pixels `SensorSpec` uses as a unit."""

EXPONENTIAL_SHARES = (0.08967, 0.45045, 0.38970, 0.07018)
EXPONENTIAL_SIGMAS = (0.4463, 1.1694, 2.0658, 3.1478)
"""Gaussians whose sum is exp(-r) / 2 pi within 6 % from r = 0.3 to 11, by a least-squares fit of the logarithm.
Gaussians are separable, and their integrals over pixels are known.
"""

TAIL_SOFTENING_PX = 2.0
"""The tail is 1 / (r² + this²); nearer to the centre, the core hides it."""

TAIL_RADIUS_PX = 1000.0
"""The tail's share is the light within this radius; the tail continues beyond it, as in a real lens."""

FAR_SOFTENING_PX = 24.0
FAR_STEP = 4
"""Away from a lamp, its tail is drawn with this softening, smooth enough to be computed for every fourth pixel."""

NEAR_ERROR_CD_M2 = 1e-4
"""Near a lamp, the tail is exact, out to where the softened one differs by less: 0.01 grey levels of the short
exposure."""

MAX_DISC_POINTS = 192


@dataclass(frozen=True, slots=True, eq=False)
class LampPoints:
    """Lamps as the camera sees them: points, or small discs.

    Attributes:
        positions_px: Shape (N, 2), full-frame pixels x, y; also outside the image, since glare reaches into it.
        illuminances_lx: Shape (N,), at the camera, by the visible part of the lamp.
        radii_px: Shape (N,), radii of the discs.

    Raises:
        ValueError: If the shapes differ, or a value is not finite or negative.
    """

    positions_px: Floats
    illuminances_lx: Floats
    radii_px: Floats

    def __post_init__(self) -> None:
        num = len(np.atleast_1d(self.illuminances_lx))
        for name, shape in (("positions_px", (num, 2)), ("illuminances_lx", (num,)), ("radii_px", (num,))):
            array = np.array(getattr(self, name), np.float64).reshape(
                shape if num == 0 else np.shape(getattr(self, name))
            )
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f"LampPoints.{name}: expected finite numbers of shape {shape}, got {shortened(array)}")
            if name != "positions_px" and (array < 0).any():
                raise ValueError(f"LampPoints.{name}: expected at least 0, got {array.min()}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)


class Optics:
    """The lens of one camera.

    Attributes:
        static_cd_m2: Shape (H, W), light that stands still in the image, on the pixels; None for none.
    """

    static_cd_m2: Image | None = None

    def __init__(self, spec: SensorSpec, camera: Camera) -> None:
        self.camera = camera
        self._scale = camera.width_px / REFERENCE_WIDTH_PX
        core_share = 1.0 - spec.middle_share - spec.tail_share
        if core_share < 0:
            raise ValueError(f"SensorSpec: expected middle_share + tail_share of at most 1, got {1.0 - core_share:g}")
        self._shares = np.array([core_share, *(share * spec.middle_share for share in EXPONENTIAL_SHARES)])
        # Standard deviations before the pixel, whose own variance is 1/12 px².
        sigmas = np.array([spec.core_px, *(sigma * spec.middle_px for sigma in EXPONENTIAL_SIGMAS)])
        reference_sigmas = np.sqrt(np.maximum(sigmas**2 - 1.0 / 12.0, 0.01))
        self._sigmas_px = reference_sigmas * self._scale
        self._softening_px = TAIL_SOFTENING_PX * self._scale
        self._far_softening_px = FAR_SOFTENING_PX * self._scale
        within = np.pi * np.log1p((TAIL_RADIUS_PX / TAIL_SOFTENING_PX) ** 2)
        self._tail = spec.tail_share / within  # times 1 / (r² + softening²), r in pixels of any size
        self._vignetting = spec.vignetting
        self._spectra: dict[tuple[int, int], NDArray[np.complex64]] = {}

    @cached_property
    def fall_off(self) -> Image:
        """Shape (H, W): a surface's light on the sensor, relative to the axis: cos^4 to the power of the vignetting."""
        return np.asarray(self._cosines ** (4.0 * self._vignetting), np.float32)

    def spread(self, luminance: Image) -> Image:
        """Light on the pixels, cd/m², from extended sources with `luminance`, shape (H, W), cd/m².

        The core and the exponential part are computed at full resolution, the tail at a quarter of it. Beyond the
        image, the edge is continued for the former, and it is dark for the tail.
        """
        image = np.asarray(luminance, np.float32)
        spread = self._glare(image) if self._tail else np.zeros_like(image)
        for across, down in self._kernels:
            cv2.add(spread, cv2.sepFilter2D(image, -1, across, down, borderType=cv2.BORDER_REPLICATE), dst=spread)
        return spread

    def draw_points(self, points: LampPoints) -> Image:
        """Luminance of lamps with their halo, shape (H, W), cd/m², to be added after `spread`.

        It is exact near each lamp, over all decades; away from it, the tail is softened and drawn at a quarter of the
        resolution, without a limiting radius.
        """
        height, width = self.camera.height_px, self.camera.width_px
        rows = (np.arange(0, height + FAR_STEP, FAR_STEP, dtype=np.float32) + 0.5 * FAR_STEP)[:, np.newaxis]
        columns = np.arange(0, width + FAR_STEP, FAR_STEP, dtype=np.float32) + 0.5 * FAR_STEP
        far = np.zeros((len(rows), columns.size), np.float32)
        fluxes = points.illuminances_lx / self._pixel_solid_angles_sr(points.positions_px)
        lamps = zip(points.positions_px, fluxes, strict=True) if self._tail else ()
        for (x, y), flux in lamps:
            squares = (rows - np.float32(y)) ** 2 + (columns - np.float32(x)) ** 2
            np.add(far, np.float32(flux * self._tail) / (squares + np.float32(self._far_softening_px**2)), out=far)
        whole = cv2.resize(far, (columns.size * FAR_STEP, len(rows) * FAR_STEP), interpolation=cv2.INTER_LINEAR)
        image: Image = np.array(whole[:height, :width], np.float32)
        for (x, y), flux, radius in zip(points.positions_px, fluxes, points.radii_px, strict=True):
            if flux > 0:
                self._add_near(image, (float(x), float(y)), float(flux), float(radius))
        return image

    def _add_near(self, image: Image, position_px: tuple[float, float], flux: float, radius_px: float) -> None:
        """Adds to `image` the difference between the exact and the softened spread around one lamp.

        Args:
            image: Shape (H, W), changed in place.
            position_px: Position of the lamp.
            flux: Sum over all pixels, cd/m².
            radius_px: Radius of the lamp's disc.
        """
        softening2, far2 = self._softening_px**2 + 0.5 * radius_px**2, self._far_softening_px**2
        differs_to = (flux * self._tail * far2 / NEAR_ERROR_CD_M2) ** 0.25
        reach = max(6.0 * float(self._sigmas_px.max()) + radius_px + 2.0, differs_to)
        (x, y), (height, width) = position_px, image.shape
        x0, x1 = max(0, int(x - reach)), min(width, int(x + reach) + 2)
        y0, y1 = max(0, int(y - reach)), min(height, int(y + reach) + 2)
        if x0 >= x1 or y0 >= y1:
            return
        squares = (np.arange(y0, y1)[:, np.newaxis] + 0.5 - y) ** 2 + (np.arange(x0, x1) + 0.5 - x) ** 2
        near = self._tail * (1.0 / (squares + softening2) - 1.0 / (squares + far2))
        # Fades out towards the border of the window, which otherwise would show as a faint square.
        near *= np.clip(4.0 * (1.0 - np.sqrt(squares) / reach), 0.0, 1.0)
        offsets = _disc(radius_px, float(self._sigmas_px[0]))
        down = _over_pixels(np.arange(y0, y1 + 1), y + offsets[:, 1], self._sigmas_px)
        across = _over_pixels(np.arange(x0, x1 + 1), x + offsets[:, 0], self._sigmas_px)
        down *= self._shares[:, np.newaxis, np.newaxis] / len(offsets)
        near += np.tensordot(down, across, ((0, 1), (0, 1)))
        image[y0:y1, x0:x1] += (flux * near).astype(np.float32)

    def _glare(self, image: Image) -> Image:
        """The tail of extended sources, at a quarter of the resolution, without wrap-around."""
        height, width = image.shape
        small = cv2.resize(image, (-(-width // FAR_STEP), -(-height // FAR_STEP)), interpolation=cv2.INTER_AREA)
        shape = (next_fast_len(2 * small.shape[0], True), next_fast_len(2 * small.shape[1], True))
        spread = irfft2(rfft2(small, shape, workers=2) * self._spectrum(shape), shape, workers=2)
        cut = np.maximum(spread[: small.shape[0], : small.shape[1]], 0.0).astype(np.float32)
        return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)

    def _spectrum(self, shape: tuple[int, int]) -> NDArray[np.complex64]:
        """Spectrum of the tail's kernel, whose elements are means over a cell of pixels times the cell's area."""
        if shape not in self._spectra:
            offsets = np.arange(FAR_STEP) - (FAR_STEP - 1) / 2
            down, across = (np.fft.fftfreq(num, 1 / num) * FAR_STEP for num in shape)
            kernel = np.zeros(shape, np.float64)
            for dy in offsets:
                for dx in offsets:
                    squares = (down[:, np.newaxis] + dy) ** 2 + (across + dx) ** 2
                    kernel += self._tail / (squares + self._softening_px**2)
            self._spectra[shape] = rfft2(kernel).astype(np.complex64)
        return self._spectra[shape]

    @cached_property
    def _kernels(self) -> tuple[tuple[Floats, Floats], ...]:
        """Core and exponential part as sums of separable kernels (across, down), to 1e-5 of the light."""
        radius = int(np.ceil(5.0 * self._sigmas_px.max())) + 1
        edges = np.arange(-radius, radius + 2) - 0.5
        profiles = _over_pixels(edges, np.zeros(1), self._sigmas_px)[:, 0]
        profiles /= profiles.sum(1, keepdims=True)
        kernel = np.einsum("k,ky,kx->yx", self._shares, profiles, profiles)
        left, values, right = np.linalg.svd(kernel)
        num = int(np.searchsorted(-values, -1e-5 * values[0]))
        return tuple((right[k] * np.sqrt(values[k]), left[:, k] * np.sqrt(values[k])) for k in range(num))

    @cached_property
    def _cosines(self) -> Floats:
        """Shape (H, W), cosine of the angle between each pixel's ray and the axis; computed for every fourth pixel."""
        height, width = self.camera.height_px, self.camera.width_px
        coarse = [np.linspace(0.5, num - 0.5, max(2, num // FAR_STEP)) for num in (width, height)]
        rays = self.camera.rays(np.stack(np.meshgrid(*coarse), -1))
        return np.asarray(zoom(rays[..., 0], (height / len(coarse[1]), width / len(coarse[0])), order=1))

    def _pixel_solid_angles_sr(self, positions_px: Floats) -> Floats:
        """Solid angles of pixels, smaller by cos³ away from the axis, without the distortion.

        Together with `fall_off`, a lamp becomes weaker by cos towards the corners, like its image in a lens.
        """
        offsets = (positions_px - self.camera.centre_px) / self.camera.focal_px
        return np.asarray(self.camera.pixel_solid_angle_sr * (1.0 + (offsets**2).sum(-1)) ** -1.5)


def _disc(radius_px: float, sigma_px: float) -> Floats:
    """Points (x, y) that fill a disc evenly (a sunflower), dense enough for the core to hide their spacing."""
    num = int(np.clip(np.ceil(4.0 * (radius_px / max(sigma_px, 0.2)) ** 2), 1, MAX_DISC_POINTS))
    if num == 1:
        return np.zeros((1, 2))
    numbers = np.arange(num) + 0.5
    radii, angles = radius_px * np.sqrt(numbers / num), numbers * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], -1)


def _over_pixels(edges_px: ArrayLike, centres_px: Floats, sigmas_px: Floats) -> Floats:
    """Integrals over pixels, shape (K, N, P), of Gaussians of K widths about N centres; P + 1 `edges_px`."""
    offsets = np.asarray(edges_px, np.float64) - centres_px[:, np.newaxis]
    return np.asarray(0.5 * np.diff(erf(offsets / (np.sqrt(2.0) * sigmas_px[:, np.newaxis, np.newaxis])), axis=-1))
