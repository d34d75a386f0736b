"""The imager of a profile: metering, electrons, noise, tone and the stream's encoder, image by image along a drive."""

from __future__ import annotations

import zlib
from fractions import Fraction
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.camera.optics import Image
from foreglow.lab.simulation.camera.profile import CameraProfile, EncoderSpec, ToneSpec
from foreglow.lab.simulation.camera.sensor import DEMOSAICING, QUANTISATION_GREY
from foreglow.lab.simulation.camera.windscreen import Windscreen

TABLE_SIZE = 65536
"""Entries of the curve's table, evenly spaced over the square root of the signal, which is finer in the shadows."""


class Tone:
    """The image processing of a camera, which remembers the previous image."""

    def __init__(self, spec: ToneSpec) -> None:
        self._spec = spec
        signal = np.linspace(0.0, 1.0, TABLE_SIZE) ** 2
        span = spec.white_level - spec.black_level
        self._table = (spec.black_level + span * _crushed(spec, _curve(spec, signal))).astype(np.float32)
        self._previous: Image | None = None

    def grey(self, signal: Image) -> Image:
        """Grey levels, not rounded, of a signal from 0 to 1, without what depends on neighbours."""
        at: Image = np.asarray(cv2.sqrt(np.clip(signal, 0.0, 1.0)), np.float32)
        at *= np.float32(TABLE_SIZE - 1)
        at += np.float32(0.5)
        return self._table[at.astype(np.uint16)]

    def finished(self, grey: Image) -> NDArray[np.uint8]:
        """The next image of the camera, denoised and sharpened."""
        spec = self._spec
        if spec.smooth > 0:
            mean = cv2.blur(grey, (3, 3))
            detail = grey - mean
            is_noise = np.clip(1.5 - cv2.absdiff(grey, mean) / np.float32(spec.noise_level), 0.0, 1.0)
            grey = mean + detail * (1.0 - np.float32(spec.smooth) * is_noise)
        if spec.denoise > 0:
            if self._previous is not None:
                change = cv2.blur(cv2.absdiff(grey, self._previous), (3, 3))
                kept = np.clip(1.5 - change / np.float32(spec.noise_level), 0.0, 1.0) * np.float32(spec.denoise)
                grey = grey + kept * (self._previous - grey)
            self._previous = grey
        if spec.sharpen > 0:
            soft = cv2.GaussianBlur(grey, (0, 0), spec.sharpen_px)
            grey = np.asarray(cv2.addWeighted(grey, 1.0 + spec.sharpen, soft, -spec.sharpen, 0.0), np.float32)
        return np.asarray(cv2.convertScaleAbs(np.clip(grey, 0.0, 255.0)), np.uint8)


def _curve(spec: ToneSpec, signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The curve from 0..1 to 0..1."""
    if spec.curve == "hdr":
        signal = np.log1p(spec.strength * signal) / np.log1p(spec.strength)
    elif spec.curve == "filmic":
        # Source: Reinhard et al. 2002, equation 4: a shoulder that reaches white at the largest signal.
        exposed = spec.strength * signal
        signal = exposed * (1.0 + exposed / spec.strength**2) / (1.0 + exposed)
        signal = signal / signal[-1]
    return np.asarray(np.clip(signal, 0.0, 1.0) ** (1.0 / spec.gamma))


def _crushed(spec: ToneSpec, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values from 0 to 1 less what becomes black: a hyperbola that has the hard crush as its asymptotes."""

    def above(value: Any) -> Any:
        return 0.5 * (value - spec.crush + np.sqrt((value - spec.crush) ** 2 + spec.toe**2))

    return np.asarray((above(values) - above(0.0)) / (above(1.0) - above(0.0)))


LIBRARIES = {"h264": "libx264", "h265": "libx265"}
PRESETS = {"h264": "superfast", "h265": "ultrafast"}
"""The encoders of cameras are simple, and these are the quickest that predict within and between frames."""


FRAMES_PREDICTED = 4.0
"""Frames of the camera's own rate after which an image can hardly be predicted from the last one."""

MAX_MORE_BITS = 4.0
"""Up to how many times the bits of others a frame that is not predicted gets, as encoders give them."""


class Encoder:
    """A stream of one camera through a drive; the same images give the same bytes.

    There are no frames that wait for later ones, so that every image comes back at once.
    """

    def __init__(self, spec: EncoderSpec, width_px: int, height_px: int, step_s: float = 0.0) -> None:
        """A stream of images with `step_s` seconds between them; 0 for those of the camera's own rate."""
        self._size = (width_px, height_px)
        padded = (width_px + width_px % 2, height_px + height_px % 2)
        rate = Fraction(spec.rate_hz).limit_denominator(1001)
        writer: Any = av.CodecContext.create(LIBRARIES[spec.codec], "w")
        writer.width, writer.height = padded
        writer.pix_fmt = "yuv420p"
        writer.framerate, writer.time_base = rate, 1 / rate
        kbps = spec.kbps * min(MAX_MORE_BITS, max(1.0, step_s * spec.rate_hz / FRAMES_PREDICTED))
        writer.bit_rate = round(kbps * 1000)
        writer.gop_size = spec.key_every
        writer.max_b_frames = 0
        writer.thread_count = 1
        options = {"preset": PRESETS[spec.codec], "tune": "zerolatency"}
        buffer = round(kbps)  # of one second
        if spec.codec == "h264":
            options["x264-params"] = f"vbv-maxrate={buffer}:vbv-bufsize={buffer}:force-cfr=1:threads=1:sliced-threads=0"
        else:
            options["x265-params"] = (
                f"vbv-maxrate={buffer}:vbv-bufsize={buffer}:frame-threads=1:pools=1:log-level=error:info=0"
            )
        writer.options = options
        self._writer = writer
        self._reader: Any = av.CodecContext.create({"h264": "h264", "h265": "hevc"}[spec.codec], "r")
        self._reader.thread_count = 1
        self._reader.flags |= av.codec.context.Flags.low_delay
        self._num = 0

    def through(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`image`, shape (H, W), the next of the stream, after compression.

        Raises:
            RuntimeError: If the encoder keeps it back.
        """
        width, height = self._size
        padded = np.pad(image, ((0, height % 2), (0, width % 2)), mode="edge")
        full = np.full((padded.shape[0] * 3 // 2, padded.shape[1]), 128, np.uint8)
        # Of the video range, 16 to 235.
        full[: padded.shape[0]] = LIMITED[padded]
        frame = av.VideoFrame.from_ndarray(full, format="yuv420p")
        frame.pts = self._num
        self._num += 1
        for packet in self._writer.encode(frame):
            for back in self._reader.decode(packet):
                luma = np.asarray(back.to_ndarray())[:height, :width]
                return np.asarray(FULL[luma])
        raise RuntimeError("encoder: expected an image back for every image")


LIMITED = np.rint(16 + np.arange(256) * (219 / 255)).astype(np.uint8)
FULL = np.clip(np.rint((np.arange(256) - 16) * (255 / 219)), 0, 255).astype(np.uint8)


REFERENCE_RATE_HZ = 30.0
"""Frames a second of a camera whose images are not compressed."""

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
        # Temporal denoising sees images in between that are not taken here, rather than the last one that is.
        kept = profile.tone.denoise
        rate_hz = profile.encoder.rate_hz if profile.encoder else REFERENCE_RATE_HZ
        missing = min(1.0, max(0.0, (step_s * rate_hz - 1.0) / (FRAMES_PREDICTED - 1.0)))
        self._tone = Tone(profile.tone.model_copy(update={"denoise": (1.0 - missing) * kept}))
        # Source: standard deviation of a running mean of noise.
        self._noise_share = np.float32(1.0 - missing * (1.0 - np.sqrt((1.0 - kept) / (1.0 + kept))))
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
        noise *= self._noise_e(electrons) * self._noise_share
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
