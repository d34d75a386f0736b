"""PSD-3D: where the viewing ray comes closest to the road's centre line in space.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, method PSD-3D.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.pixelwise import PixelwiseEstimator, no_ranges
from foreglow.distance.road_line import closest_approach, dense, nearest_points
from foreglow.geometry import Floats
from foreglow.rays import Rays
from foreglow.types import Frame

MAP_SIGMA_RAD = math.radians(0.2)
"""Standard deviation of the map's slopes, which come in steps of 0.5 %, as an angle from the camera."""

OFFSET_SIGMA_M = 4.0
"""Standard deviation of the lights' distance from the mapped centre line: they are in a lane, above it, on a guard rail
or in the trees, and the map has an error of its own. Chosen on the training drives, where 72 % of the lights are within
one sigma, and 89 % within two.
"""


class PSD3D(PixelwiseEstimator):
    """Ranges to where the ray comes closest to the road's centre line.

    The range is that of the point on the ray, not of the road point: like all ranges, it is measured along the ray.
    There is none without a road, where the ray only departs from the road, as above the horizon, or where the closest
    point is the map's end.
    """

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:
        """Along o + t d, the t of min over i and t >= 0 of D(o + t d, P_i)."""
        if frame.road is None:
            return no_ranges(len(rays.directions))
        offsets_m = dense(self._road_points(frame)) - rays.origin_m
        nearest = nearest_points(rays.directions @ offsets_m.T, offsets_m)
        ranges_m, sines = closest_approach(rays.directions, offsets_m, nearest)
        angle_sigma_rad = math.hypot(rays.pitch_sigma_rad, MAP_SIGMA_RAD)
        across_m = np.hypot(ranges_m * angle_sigma_rad, OFFSET_SIGMA_M) / sines
        sigmas_m = np.hypot(across_m, frame.road.error_bound_m / math.sqrt(3.0))
        return ranges_m, np.where(np.isnan(ranges_m), np.inf, sigmas_m)

    def _road_points(self, frame: Frame) -> Floats:
        """The mapped centre line, shape (N, 3), in the vehicle's frame; the frame must have a road."""
        assert frame.road is not None
        return frame.road.points_m
