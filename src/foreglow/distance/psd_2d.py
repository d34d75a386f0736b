"""PSD-2D: where the viewing ray crosses the road, seen from above, without heights.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, method PSD-2D.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.pixelwise import PixelwiseEstimator, no_ranges
from foreglow.distance.road_line import closest_approach, dense, nearest_points
from foreglow.geometry import Floats
from foreglow.rays import Rays
from foreglow.types import Frame

YAW_SIGMA_RAD = math.radians(1.0)
"""Standard deviation of the car's heading on the road together with the error of the map's curves."""

LATERAL_SIGMA_M = 4.0
"""Standard deviation of the lights' distance from the centre line, seen from above. Chosen on the training drives,
where 71 % of the lights are within one sigma, and 88 % within two.
"""

MIN_LEVEL = 1e-6
"""A ray whose horizontal part is shorter has no azimuth."""


class PSD2D(PixelwiseEstimator):
    """Ranges to where the ray's azimuth line first crosses the road's centre line, or else comes closest to it.

    Pitch and heights play no part. That helps on hills and fails on straight roads, where the azimuth line runs along
    the road. There is no range where the line only departs from the road, or is closest to the map's end.
    """

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:
        """In the plane, the t of min over i and t >= 0 of D(o + t d, P_i), then along the ray."""
        if frame.road is None:
            return no_ranges(len(rays.directions))
        level = np.hypot(rays.directions[:, 0], rays.directions[:, 1])
        has_azimuth = level > MIN_LEVEL
        level = np.where(has_azimuth, level, 1.0)
        azimuths = np.where(has_azimuth[:, None], rays.directions[:, :2] / level[:, None], [-1.0, 0.0])
        offsets_m = dense(frame.road.points_m[:, :2]) - rays.origin_m[:2]
        along_m = azimuths @ offsets_m.T
        nearest = nearest_points(along_m, offsets_m)
        # The distance is 0 wherever the line crosses the road, on winding roads several times: the first one counts.
        is_left = azimuths @ (offsets_m[:, ::-1] * [-1.0, 1.0]).T > 0.0
        crosses = (is_left[:, 1:] ^ is_left[:, :-1]) & (along_m[:, 1:] > 0.0)
        first = crosses.argmax(axis=1)
        nearest = np.where(crosses[np.arange(len(first)), first], first, nearest)
        reaches_m, sines = closest_approach(azimuths, offsets_m, nearest)
        across_m = np.hypot(reaches_m * YAW_SIGMA_RAD, LATERAL_SIGMA_M) / sines
        sigmas_m = np.hypot(across_m, frame.road.error_bound_m / math.sqrt(3.0)) / level
        ranges_m = np.where(has_azimuth, reaches_m / level, np.nan)
        return ranges_m, np.where(np.isnan(ranges_m), np.inf, sigmas_m)
