"""GP: where the viewing ray meets the plane under the car.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, method GP.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.pixelwise import PixelwiseEstimator
from foreglow.geometry import Floats
from foreglow.rays import Rays
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

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:  # noqa: ARG002
        """The r at which o + r d has z = 0; NaN at and above the horizon, and for a camera below the plane."""
        height_m, descents = rays.origin_m[2], -rays.directions[:, 2]
        is_hit = (descents > MIN_DESCENT) & (height_m > 0)
        sines = np.where(is_hit, descents, 1.0)
        ranges_m = np.where(is_hit, height_m / sines, np.nan)  # paper, GP
        angle_sigma_rad = math.hypot(rays.pitch_sigma_rad, ROAD_SIGMA_RAD)
        sigmas_m = np.hypot(ranges_m * angle_sigma_rad, HEIGHT_SIGMA_M) / sines
        return ranges_m, np.where(is_hit, sigmas_m, np.inf)
