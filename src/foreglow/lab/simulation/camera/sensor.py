"""The imager: from luminance to grey levels of 8 bits, with the response, noise and fixed pattern of a real one.

Figures are from the one lossless real frame of PVDN. Its even and odd rows have different column patterns, and its
noise is equally correlated in both directions, as after demosaicing.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX, Image, Optics
from foreglow.lab.simulation.scenes.scene import SensorSpec

PATTERN_STREAM, NOISE_STREAM = 41, 42
"""Numbers of the random streams."""

COLUMN_KERNEL = (0.45, 1.0, 0.45)
"""Kernel that gives neighbouring columns the real frame's correlation: 0.61 at distance 1, about 0 beyond."""

COLUMN_GREY = 1.36
"""Standard deviation of the column pattern that all rows share."""

ROW_PARITY_GREY = 0.56
"""Standard deviation of the pattern that is added to even rows and subtracted from odd ones; the correlation of
neighbouring columns is -0.46."""

SHADING_GREY = 0.9
"""Standard deviation of the slow change over the columns; the real frame falls from 9.7 at the left to 6.5."""

UNEVEN_GREY = 0.15
"""Standard deviation of the slow change over the area."""

DARK_SIGNAL_GREY = 0.35
"""Standard deviation of single pixels' offsets (a guess: they cannot be separated from noise in one frame)."""

GAIN_SPREAD = 0.01
"""Standard deviation of single pixels' sensitivity (a usual figure, not measured)."""

ROW_GREY = 0.2
"""Standard deviation of a row's mean from frame to frame."""

DEMOSAICING = np.array([[1, 2, 1], [2, 12, 2], [1, 2, 1]], np.float32) / np.float32(164.0**0.5)
"""Kernel that gives white noise the correlation of the real frame's, 0.34 with a neighbour and 0.2 with a diagonal one,
and keeps its variance.
"""

QUANTISATION_GREY = 12.0**-0.5


class Sensor:
    """The imager behind a lens; its fixed pattern is the same in every frame.

    Images of fewer than 1280 columns are binned from such pixels: noise and pattern are averaged accordingly. All rows
    are exposed at once, and all colours alike.
    """

    sees_colour = False
    readout_s = 0.0

    def __init__(self, spec: SensorSpec, camera: Camera, seed: int, optics: Optics | None = None) -> None:
        """The imager behind `optics`; None for the lens that `spec` describes."""
        self.spec = spec
        self.optics = optics or Optics(spec, camera)
        self._seed = seed
        self._shape = (camera.height_px, camera.width_px)
        gain, self._analogue_gain = 1.0, 1.0
        if spec.exposure == "night":
            gain = spec.night_gain
            # The part of the gain that the longer exposure does not provide is amplification, also of noise.
            self._analogue_gain = max(1.0, gain * spec.day_exposure_s / spec.night_exposure_s)
        self._binning = min(1.0, camera.width_px / REFERENCE_WIDTH_PX)
        self._grain_px, self._averaging = _binned_grain(spec.grain_px, self._binning)
        self._row_grey = ROW_GREY * self._analogue_gain * spec.row_noise
        self._grey_per_cd_m2 = self.optics.fall_off * np.float32(spec.grey_per_cd_m2 * gain)
        rng = np.random.default_rng([seed, PATTERN_STREAM])
        self.pattern_grey = self._pattern(rng)
        sensitivity = 1.0 + self._binning * GAIN_SPREAD * rng.standard_normal(self._shape, np.float32)
        self._uneven_grey_per_cd_m2 = self._grey_per_cd_m2 * sensitivity

    @property
    def exposure_s(self) -> float:
        """Time for which the shutter is open."""
        return self.spec.night_exposure_s if self.spec.exposure == "night" else self.spec.day_exposure_s

    def meter(self, luminance: Image, time_s: float) -> None:
        """Does nothing: the exposure is fixed."""

    def expected_grey(self, luminance: Image) -> Image:
        """Grey levels for the light on the pixels, shape (H, W), float32, not rounded, without noise and pattern.

        Args:
            luminance: Shape (H, W), cd/m², spread by the optics.
        """
        return np.minimum(self._response(luminance * self._grey_per_cd_m2), 255.0)

    def noise_grey(self, luminance: Image) -> Image:
        """Standard deviation of the grey levels from frame to frame, shape (H, W), rounding included."""
        signal = luminance * self._grey_per_cd_m2
        slope = self.spec.log_slope / (self.spec.log_slope + np.maximum(signal - self.spec.knee, 0.0))
        row = self._row_grey
        return np.sqrt((slope * self._noise(signal)) ** 2 + (slope * row) ** 2 + QUANTISATION_GREY**2)

    def capture(self, luminance: Image, frame: int) -> NDArray[np.uint8]:
        """The image, shape (H, W), uint8, of the light on the pixels; the same frame number gives the same noise."""
        rng = np.random.default_rng([self._seed, NOISE_STREAM, frame])
        signal = luminance * self._uneven_grey_per_cd_m2
        signal += self._correlated(rng.standard_normal(self._shape, np.float32)) * self._noise(signal)
        signal += self.pattern_grey
        rows = rng.standard_normal((self._shape[0], 1), np.float32)
        signal += cv2.blur(rows, (1, 2)) * np.float32(2.0**0.5 * self._row_grey)
        grey = self._response(signal)
        return np.asarray(np.clip(np.rint(grey, out=grey), 0.0, 255.0, out=grey), np.uint8)

    def _correlated(self, white: Image) -> Image:
        """White noise with the correlation of the sensor's, and the same variance."""
        if self._grain_px == 0:
            return np.asarray(cv2.filter2D(white, -1, DEMOSAICING, borderType=cv2.BORDER_REFLECT))
        size = 2 * int(np.ceil(3.0 * self._grain_px)) + 1
        kernel = np.asarray(cv2.getGaussianKernel(size, self._grain_px, cv2.CV_32F), np.float32)
        kernel = kernel / np.linalg.norm(kernel)
        return np.asarray(cv2.sepFilter2D(white, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT))

    def _response(self, signal: Image) -> Image:
        """The response: linear up to the knee, logarithmic above, with a continuous slope."""
        knee, slope = self.spec.knee, self.spec.log_slope
        above = cv2.log(np.maximum(signal - knee, 0.0) * np.float32(1.0 / slope) + np.float32(1.0))
        above *= np.float32(slope)
        above += np.minimum(signal, np.float32(knee))
        above += np.float32(self.spec.black_level)
        return np.asarray(above)

    def _noise(self, signal: Image) -> Image:
        """Standard deviation before the response: read noise and shot noise, both amplified by the analogue gain."""
        read = self.spec.read_noise * self._analogue_gain
        variance = np.maximum(signal, 0.0) * np.float32(self.spec.shot_noise * self._analogue_gain)
        variance += np.float32(read**2)
        return cv2.sqrt(variance) * np.float32(self._averaging)

    def _pattern(self, rng: np.random.Generator) -> Image:
        """The fixed pattern in grey levels before the response: columns, shading, single pixels."""
        height, width = self._shape
        num = max(width, REFERENCE_WIDTH_PX)
        # Student's t distribution makes a few columns stand out (kurtosis 6 in the real frame).
        columns = np.convolve(rng.standard_t(6.0, num), COLUMN_KERNEL, "same")
        columns *= COLUMN_GREY / columns.std()
        parity = np.diff(rng.standard_normal(num + 1)) * (ROW_PARITY_GREY / 2.0**0.5)
        shading = SHADING_GREY * (rng.standard_normal() * np.linspace(-1.7, 1.7, num) + 0.3 * _slow(rng, num))
        even, odd = (columns + shading + sign * parity for sign in (1.0, -1.0))
        pair = cv2.resize(np.stack([even, odd]).astype(np.float32), (width, 2), interpolation=cv2.INTER_AREA)
        if self._binning < 1.0:  # every binned row contains even and odd rows
            pair[:] = self._binning * pair + (1.0 - self._binning) * pair.mean(0)
        pattern = np.tile(pair, (-(-height // 2), 1))[:height] * np.float32(self.spec.column_noise)
        coarse = rng.standard_normal((max(2, height // 64), max(2, width // 64)), np.float32)
        pattern += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * np.float32(UNEVEN_GREY)
        pattern += rng.standard_normal(self._shape, np.float32) * np.float32(DARK_SIGNAL_GREY * self._binning)
        return pattern


def _binned_grain(grain_px: float, binning: float) -> tuple[float, float]:
    """Grain in pixels that are binned, 1 / binning along either axis, and their noise relative to that of one.

    Noise that is blurred by a Gaussian is averaged away by less than white noise.
    """
    if grain_px == 0:
        return 0.0, binning
    wider = binning**-2 - 1.0
    return binning * (grain_px**2 + wider / 12.0) ** 0.5, (1.0 + wider / (12.0 * grain_px**2)) ** -0.5


def _slow(rng: np.random.Generator, num: int) -> NDArray[np.float64]:
    """Random numbers that change slowly, over some 80 elements."""
    coarse = rng.standard_normal(max(4, num // 80))
    return np.interp(np.linspace(0.0, len(coarse) - 1.0, num), np.arange(len(coarse)), coarse)
