"""GP: where the viewing ray meets the plane under the car.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, method GP.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.pixelwise import PixelwiseEstimator
from foreglow.geometry import Floats, MountSigmas
from foreglow.rays import Rays, calibrated
from foreglow.types import Frame

ROAD_SIGMA_RAD = math.radians(0.8)
"""How far the road under the light departs from the plane, as an angle from the camera. It was chosen together with
`HEIGHT_SIGMA_M` on the training drives, where 68 % of the lights are within one sigma, and 84 % within two: the errors
have heavy tails.
"""

HEIGHT_SIGMA_M = 0.4
"""Standard deviation of the lights' height above the road."""

MIN_DESCENT = 1e-9
"""A ray that falls by less than this for each metre counts as level, and never meets the plane."""


class GroundPlane(PixelwiseEstimator):
    """Ranges to z = 0 of the vehicle's frame.

    It is exact for light on a flat road. A lamp above the plane is nearer than estimated: by the share l / h for a lamp
    at the height l and a camera at the height h. A pitch error p changes a range r by r^2 p / h.
    """

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:
        """The r at which o + r d has z = 0; NaN at and above the horizon."""
        height_m, descents = rays.origin_m[2], -rays.directions[:, 2]
        is_hit = descents > MIN_DESCENT
        sines = np.where(is_hit, descents, 1.0)
        ranges_m = np.where(is_hit, height_m / sines, np.nan)  # paper, GP
        angle_sigma_rad = math.hypot(rays.pitch_sigma_rad, ROAD_SIGMA_RAD)
        sigmas_m = np.hypot(ranges_m * angle_sigma_rad, HEIGHT_SIGMA_M) / sines
        sigmas_m = _with_mount(sigmas_m, ranges_m, calibrated(frame).mount_sigmas, height_m)
        return ranges_m, np.where(is_hit, sigmas_m, np.inf)


def _with_mount(sigmas_m: Floats, ranges_m: Floats, mount: MountSigmas, height_m: float) -> Floats:
    """`sigmas_m` with what an uncertain mount adds: they are infinite where the light may as well be at the horizon.

    The range grows faster than the pitch's error, so the farther end of its interval counts.
    """
    if mount.pitch_rad:
        descents = np.arcsin(height_m / ranges_m) - mount.pitch_rad
        is_below = descents > MIN_DESCENT
        sines = np.sin(np.where(is_below, descents, 1.0))
        sigmas_m = np.maximum(sigmas_m, np.where(is_below, height_m / sines - ranges_m, np.inf))
    return np.hypot(sigmas_m, ranges_m * mount.height_m / height_m) if mount.height_m else sigmas_m
