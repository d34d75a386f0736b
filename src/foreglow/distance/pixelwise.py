"""Base of the paper's estimators: rays through a box's pixels, a range for each ray, and one range for the box."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from foreglow.config import DistanceConfig
from foreglow.distance.heuristics import HEURISTICS, all_pixels
from foreglow.distance.interface import RangeEstimator
from foreglow.distance.pitch import make_pitch_source
from foreglow.geometry import Floats
from foreglow.rays import RayCaster, Rays, calibrated
from foreglow.types import Detections, Frame, Ranges
from foreglow.types.arrays import check_kind


class PixelwiseEstimator(RangeEstimator):
    """An estimator that gives each sampled pixel a range; a heuristic makes them the range of the box."""

    def __init__(self, config: DistanceConfig) -> None:
        """Raises ValueError if the configuration is none, or there is no source of the pitch that `config` asks for."""
        check_kind("config", config, DistanceConfig)
        self._heuristic = HEURISTICS[config.heuristic]
        self._uses_all_pixels = config.all_pixels and self._heuristic.is_sampled
        self._pitch = make_pitch_source(config.pitch)
        self._caster = RayCaster()

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        """The ranges of `detections` in `frame`; NaN and infinity where no pixel of a box has one.

        Raises:
            ValueError: If the frame has no camera, or one whose distortion cannot be undone.
        """
        check_kind("frame", frame, Frame)
        check_kind("detections", detections, Detections)
        camera = calibrated(frame)
        pitch = self._pitch.pitch(frame)

        def box_ranges(pixels: Floats) -> tuple[Floats, Floats]:
            rays = self._caster.cast(camera, pixels.reshape(-1, 2), pitch.rad, pitch.sigma_rad)
            ranges_m, sigmas_m = self.pixel_ranges(frame, rays)
            shape = pixels.shape[:2]
            return self._heuristic.reduce(ranges_m.reshape(shape), sigmas_m.reshape(shape))

        if not self._uses_all_pixels:
            return Ranges(detections, *box_ranges(self._heuristic.pixels(detections.boxes_xyxy_px)))
        # Boxes differ in their number of pixels.
        boxes = [box_ranges(all_pixels(box)) for box in detections.boxes_xyxy_px.tolist()]
        ranges_m, sigmas_m = zip(no_ranges(0), *boxes, strict=True)
        return Ranges(detections, np.concatenate(ranges_m), np.concatenate(sigmas_m))

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._pitch.reset()

    @abstractmethod
    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:
        """Range along each of the M rays, and its standard deviation, shapes (M,); NaN and infinity where it misses."""


def no_ranges(num: int) -> tuple[Floats, Floats]:
    """`num` unknown ranges and their sigmas."""
    return np.full(num, np.nan), np.full(num, np.inf)
