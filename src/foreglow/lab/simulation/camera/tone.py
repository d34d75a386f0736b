"""From a linear signal to grey levels: curve, sharpening, and denoising in space and time."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.camera.optics import Image
from foreglow.lab.simulation.camera.profile import ToneSpec

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
