"""The imager of a profile: metering, electrons, noise, tone and compression, image by image along a drive."""

from __future__ import annotations

import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.camera.encoder import Encoder
from foreglow.lab.simulation.camera.optics import Image
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.camera.sensor import DEMOSAICING, QUANTISATION_GREY
from foreglow.lab.simulation.camera.tone import Tone
from foreglow.lab.simulation.camera.windscreen import Windscreen

PATTERN_STREAM, NOISE_STREAM = 45, 46
"""Numbers of the random streams."""

RED_SHARE = 0.3
"""Share of the red channel in luma, the rest is green and blue. Source: ITU-R BT.601."""

RED_IN_RED, RED_IN_OTHERS = 2.6, 0.31
"""Signal of red light of rear lamps behind a red and behind the other filters, relative to white light of the same
luminance; luma keeps the luminance where nothing is clipped."""

FAINTEST_RED = 0.02
"""Smallest share of red light that changes a colour, for a few grey levels at most."""

MONO_RED = 1.8
"""Signal of such light without filters: silicon sees red better than the eye."""

METERED_STEP = 8
"""A camera meters every eighth pixel."""

METERING_STEPS = 24


class ElectronImager:
    """The imager of one camera along one drive; its images must be taken in the order of time.

    Attributes:
        optics: What is in front of it.
        exposure_s: Time for which the shutter is open.
        readout_s: Time between the first and the last row.
        sees_colour: Whether red light has to be told from the rest.
    """

    sees_colour = True

    def __init__(self, profile: CameraProfile, optics: Windscreen, seed: int, step_s: float = 0.0) -> None:
        """The imager of `profile` behind `optics`; `step_s` passes from image to image, 0: the camera's own rate."""
        self.optics = optics
        self.exposure_s, self.readout_s = profile.exposure.seconds, profile.exposure.readout_s
        self._imager, self._exposure = profile.imager, profile.exposure
        self._seeds = (seed, zlib.crc32(profile.name.encode()))
        camera = optics.camera
        self._shape = (camera.height_px, camera.width_px)
        self._gain = profile.exposure.gain
        self._metered_s: float | None = None
        rng = np.random.default_rng([*self._seeds, PATTERN_STREAM])
        uneven = 1.0 + profile.imager.fixed_pattern * rng.standard_normal(self._shape, np.float32)
        columns = rng.standard_normal(self._shape[1], np.float32) * np.float32(profile.imager.column_pattern_e)
        self._electrons_per_cd_m2 = optics.fall_off * np.float32(profile.imager.response_e * self.exposure_s)
        self._uneven = uneven.astype(np.float32)
        self._columns_e = columns
        self._tone = Tone(profile.tone)
        self._encoder = Encoder(profile.encoder, *self._shape[::-1], step_s) if profile.encoder else None

    def meter(self, luminance: Image, time_s: float) -> None:
        """Sets the amplification for the image with this light on the pixels."""
        spec = self._exposure
        if spec.metering == "fixed":
            return
        seen = luminance[METERED_STEP // 2 :: METERED_STEP, METERED_STEP // 2 :: METERED_STEP]
        if spec.metering == "centre":
            rows, columns = seen.shape
            seen = seen[rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4]
        signal = seen * np.float32(self._imager.response_e * self.exposure_s / self._imager.full_well_e)
        low, high = np.log(spec.min_gain), np.log(spec.max_gain)
        target = spec.target * 2.0**spec.compensation_ev
        for _ in range(METERING_STEPS):  # the mean grows with the gain
            middle = 0.5 * (low + high)
            is_dark = float(np.minimum(signal * np.exp(middle), 1.0).mean()) < target
            low, high = (middle, high) if is_dark else (low, middle)
        wanted = 0.5 * (low + high)
        if self._metered_s is not None:  # the first image has settled
            follow = 1.0 - np.exp(-(time_s - self._metered_s) / spec.lag_s)
            wanted = np.log(self._gain) + follow * (wanted - np.log(self._gain))
        self._metered_s = time_s
        self._gain = float(np.clip(np.exp(wanted), spec.min_gain, spec.max_gain))

    def expected_grey(self, luminance: Image, red: Image | None = None) -> Image:
        """Grey levels for the light on the pixels, without noise and pattern; `red` is a part of it."""
        return self._grey(self._electrons(luminance), None if red is None else self._electrons(red))

    def noise_grey(self, luminance: Image) -> Image:
        """Standard deviation of the grey levels from frame to frame, rounding included, denoising and stream not."""
        electrons = self._electrons(luminance)
        noise = self._noise_e(electrons)
        change = 0.5 * cv2.absdiff(self._grey(electrons + noise, None), self._grey(electrons - noise, None))
        return np.sqrt(change * change + np.float32(QUANTISATION_GREY**2))

    def capture(self, luminance: Image, frame: int, red: Image | None = None) -> NDArray[np.uint8]:
        """The image, shape (H, W), uint8, of the light on the pixels; the same frame number gives the same noise."""
        rng = np.random.Generator(np.random.SFC64([*self._seeds, NOISE_STREAM, frame]))
        electrons = self._electrons(luminance)
        noise = rng.standard_normal(self._shape, np.float32)
        if self._imager.colour == "bayer":
            noise = np.asarray(cv2.filter2D(noise, -1, DEMOSAICING, borderType=cv2.BORDER_REFLECT), np.float32)
        noise *= self._noise_e(electrons)
        electrons *= self._uneven
        electrons += noise
        electrons += self._columns_e
        if self._imager.bloom > 0:
            electrons = self._bloomed(electrons)
        grey = self._grey(electrons, None if red is None else self._electrons(red))
        image = self._tone.finished(grey)
        return image if self._encoder is None else self._encoder.through(image)

    def _electrons(self, luminance: Image) -> Image:
        """Electrons, without limit; with gains below 1 the shutter closes earlier."""
        scale = np.float32(min(1.0, self._gain))
        return np.asarray(luminance * self._electrons_per_cd_m2 * scale)

    def _noise_e(self, electrons: Image) -> Image:
        full = np.float32(self._imager.full_well_e)
        variance = np.clip(electrons, 0.0, full) + np.float32(self._imager.read_noise_e**2)
        return np.asarray(cv2.sqrt(variance), np.float32)

    def _grey(self, electrons: Image, red_e: Image | None) -> Image:
        if red_e is None or self._imager.colour == "mono":
            if red_e is not None:
                electrons = electrons + np.float32(MONO_RED - 1.0) * red_e
            return self._tone.grey(self._digital(electrons))
        grey = self._tone.grey(self._digital(electrons))
        is_red = red_e > FAINTEST_RED * electrons + 2.0
        if is_red.any():
            rows, columns = np.flatnonzero(is_red.any(1)), np.flatnonzero(is_red.any(0))
            at = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            white, red = electrons[at] - red_e[at], red_e[at]
            in_red = self._tone.grey(self._digital(white + np.float32(RED_IN_RED) * red))
            in_others = self._tone.grey(self._digital(white + np.float32(RED_IN_OTHERS) * red))
            grey[at] = RED_SHARE * in_red + (1.0 - RED_SHARE) * in_others
        return grey

    def _digital(self, electrons: Image) -> Image:
        """The converter's numbers, 0..1, after amplification."""
        limited = np.minimum(electrons, np.float32(self._imager.full_well_e))
        steps = 2.0**self._imager.bits - 1.0
        limited *= np.float32(steps * max(1.0, self._gain) / self._imager.full_well_e)
        np.rint(limited, out=limited)
        limited *= np.float32(1.0 / steps)
        return np.clip(limited, 0.0, 1.0, out=limited)

    def _bloomed(self, electrons: Image) -> Image:
        """Spills what full pixels cannot hold into their neighbours; all of it is taken from a moderate overflow."""
        full = np.float32(self._imager.full_well_e)
        excess = np.clip(electrons - full, 0.0, 20.0 * full)
        if not excess.any():
            return electrons
        spilt = cv2.GaussianBlur(excess, (0, 0), self._imager.bloom_px)
        return np.asarray(np.minimum(electrons, full) + np.float32(self._imager.bloom) * spilt)
