"""GP: the ray meets the plane that the car stands on.

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
"""How far the road under the light leaves the plane, as an angle from the camera; with `HEIGHT_SIGMA_M` chosen on the
training drives, where 68 % of the lights are within one sigma, and 84 % within two: errors have heavy tails.
"""

HEIGHT_SIGMA_M = 0.4
"""How high above the road lights are."""

MIN_DESCENT = 1e-9
"""A ray that falls by less than this for each metre is level: what it meets is nowhere."""


class GroundPlane(PixelwiseEstimator):
    """Ranges to z = 0 of the vehicle's frame.

    It is exact for light on a flat road. What shines above the plane is nearer than it says: a lamp at height l above
    a plane that the camera is h above, by the share l / h. An error p of pitch changes a range r by r^2 p / h.
    """

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Where o + r d has z = 0; NaN at and above the horizon, and for a camera that is not above the plane."""
        height_m, descents = rays.origin_m[2], -rays.directions[:, 2]
        is_hit = (descents > MIN_DESCENT) & (height_m > 0)
        sines = np.where(is_hit, descents, 1.0)
        ranges_m = np.where(is_hit, height_m / sines, np.nan)  # paper, GP
        angle_sigma_rad = math.hypot(rays.pitch_sigma_rad, ROAD_SIGMA_RAD)
        sigmas_m = np.hypot(ranges_m * angle_sigma_rad, HEIGHT_SIGMA_M) / sines
        return ranges_m, np.where(is_hit, sigmas_m, np.inf)
