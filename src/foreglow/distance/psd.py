"""The paper's estimators on a mapped road: PSD-3D, PSD-3D+ and PSD-2D.

Each looks for the point at which a viewing ray comes closest to the road's centre line: in space, in space after the
road has been turned and shifted to the car's real pose on it, or in the plane.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, methods PSD-3D, PSD-3D+ and PSD-2D.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from foreglow.config import DistanceConfig
from foreglow.distance.alignment import RoadAligner
from foreglow.distance.pixelwise import PixelwiseEstimator, no_ranges
from foreglow.geometry import Floats, rotation
from foreglow.rays import Rays, calibrated
from foreglow.types import Frame

MAP_SIGMA_RAD = math.radians(0.2)
"""Standard deviation of the map's slopes, which come in steps of 0.5 %, as an angle from the camera."""

OFFSET_SIGMA_M = 4.0
"""Standard deviation of the lights' distance from the mapped centre line: they are in a lane, above it, on a guard rail
or in the trees, and the map has an error of its own. Chosen on the training drives, where 72 % of the lights are within
one sigma, and 89 % within two.
"""

YAW_SIGMA_RAD = math.radians(1.0)
"""Standard deviation of the car's heading on the road together with the error of the map's curves."""

LATERAL_SIGMA_M = 4.0
"""Standard deviation of the lights' distance from the centre line, seen from above. Chosen on the training drives,
where 71 % of the lights are within one sigma, and 88 % within two.
"""

MIN_LEVEL = 1e-6
"""A ray whose horizontal part is shorter has no azimuth."""

MAX_SPACING_M = 2.0
"""A coarser line gets a point each metre: the closest point is only searched for beside the nearest point of the line,
and in a coarse line it may lie elsewhere."""

MIN_SQUARED_SINE = 1e-12
"""A ray at less than a millionth of a radian to the road runs along it: no point of it is the closest."""

MIN_REACH_M = 1.0
"""A ray in space that is closest to the road nearer than this only departs from it: there is still our bonnet."""

_BESIDE = np.array([-1, 0])
"""The pieces that end and begin at a point, relative to its index."""


class PSD3D(PixelwiseEstimator):
    """Ranges to where the ray comes closest to the road's centre line.

    The range is that of the point on the ray, not of the road point: like all ranges, it is measured along the ray.
    There is none without a road, where the ray only departs from the road, as above the horizon, so that the closest
    point is less than `MIN_REACH_M` away, or where that is the map's end.
    """

    def pixel_ranges(self, frame: Frame, rays: Rays) -> tuple[Floats, Floats]:
        """Along o + t d, the t of min over i and t >= 0 of D(o + t d, P_i)."""
        if frame.road is None:
            return no_ranges(len(rays.directions))
        offsets_m = dense(self._road_points(frame)) - rays.origin_m
        nearest = nearest_points(rays.directions @ offsets_m.T, offsets_m)
        ranges_m, sines = closest_approach(rays.directions, offsets_m, nearest)
        ranges_m[ranges_m < MIN_REACH_M] = np.nan
        mount = calibrated(frame).mount_sigmas
        angle_sigma_rad = math.hypot(rays.pitch_sigma_rad, MAP_SIGMA_RAD, mount.yaw_rad)
        offset_sigma_m = math.hypot(OFFSET_SIGMA_M, mount.height_m)
        across_m = np.hypot(ranges_m * angle_sigma_rad, offset_sigma_m) / sines
        sigmas_m = np.hypot(across_m, frame.road.error_bound_m / math.sqrt(3.0))
        return ranges_m, np.where(np.isnan(ranges_m), np.inf, sigmas_m)

    def _road_points(self, frame: Frame) -> Floats:
        """The mapped centre line, shape (N, 3), in the vehicle's frame; the frame must have a road."""
        assert frame.road is not None
        return frame.road.points_m


class PSD3DPlus(PSD3D):
    """PSD-3D on the road that is turned and shifted to our pose on it, as the lane markings in the image show it."""

    def __init__(self, config: DistanceConfig) -> None:
        """As PSD-3D."""
        super().__init__(config)
        self._aligner = RoadAligner()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        super().reset()
        self._aligner.reset()

    def _road_points(self, frame: Frame) -> Floats:
        points_m = super()._road_points(frame)
        standing = self._aligner.align(frame)
        # From the assumed pose to the real one: the road is shifted to the right, then turned to the right.
        return (points_m - [0.0, standing.left_m, 0.0]) @ rotation(yaw_rad=standing.yaw_rad)


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
        yaw_sigma_rad = math.hypot(YAW_SIGMA_RAD, calibrated(frame).mount_sigmas.yaw_rad)
        across_m = np.hypot(reaches_m * yaw_sigma_rad, LATERAL_SIGMA_M) / sines
        sigmas_m = np.hypot(across_m, frame.road.error_bound_m / math.sqrt(3.0)) / level
        ranges_m = np.where(has_azimuth, reaches_m / level, np.nan)
        return ranges_m, np.where(np.isnan(ranges_m), np.inf, sigmas_m)


def dense(points_m: Floats) -> Floats:
    """The line through `points_m`, shape (N, D), with a further point each metre if it is coarse."""
    steps_m = points_m[1:] - points_m[:-1]
    squared = np.einsum("ij,ij->i", steps_m, steps_m)
    if squared.max() <= MAX_SPACING_M**2:
        return points_m
    arc_lengths_m = np.concatenate([[0.0], np.cumsum(np.sqrt(squared))])
    wanted_m = np.union1d(arc_lengths_m, np.arange(0.0, arc_lengths_m[-1]))
    return np.stack([np.interp(wanted_m, arc_lengths_m, column) for column in points_m.T], -1)


def nearest_points(along_m: Floats, offsets_m: Floats) -> NDArray[np.intp]:
    """Index i of the road point that is nearest to each ray, shape (M,): the least of D(x(t), P_i) over i and t >= 0.

    Args:
        along_m: Shape (M, N), d . (P_i - o) of each ray and point.
        offsets_m: Shape (N, D), P_i - o.
    """
    # The best t >= 0 for point i is max(0, d . (P_i - o)); there D^2 = |P_i - o|^2 - t^2.
    reach_m = np.maximum(along_m, 0.0)
    np.multiply(reach_m, reach_m, out=reach_m)
    np.subtract(np.einsum("ij,ij->i", offsets_m, offsets_m), reach_m, out=reach_m)
    return np.asarray(reach_m.argmin(axis=1))


def closest_approach(directions: Floats, offsets_m: Floats, nearest: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Distance along each ray at which it is closest to the line near point `nearest`, and the sine of their angle.

    The line is straight between its points, so that the result does not depend on where they lie.

    Args:
        directions: Shape (M, D), unit vectors d.
        offsets_m: Shape (N, D), the line's points relative to the rays' origin.
        nearest: Shape (M,), index of the point whose two adjoining pieces are searched.

    Returns:
        Distances t, shape (M,), metres, and sines, shape (M,). NaN where the closest point is the ray's origin or an
        end of the line (the line may go on beyond it), and where ray and line are parallel.
    """
    last = len(offsets_m) - 2
    pieces = np.minimum(np.maximum(nearest[:, None] + _BESIDE, 0), last)  # (M, 2)
    starts = offsets_m[pieces]
    spans = offsets_m[pieces + 1] - starts
    # |start + s span - t d|^2 is least where both derivatives are 0; s is then clipped to the piece.
    along_starts = np.einsum("ij,ikj->ik", directions, starts)
    along_spans = np.einsum("ij,ikj->ik", directions, spans)
    lengths_squared = np.einsum("ikj,ikj->ik", spans, spans)
    across_squared = lengths_squared - along_spans * along_spans
    is_across = across_squared > MIN_SQUARED_SINE * lengths_squared
    across_squared[~is_across] = np.inf
    shares = (along_spans * along_starts - np.einsum("ikj,ikj->ik", spans, starts)) / across_squared
    shares = np.minimum(np.maximum(shares, 0.0), 1.0)
    feet = starts + shares[..., None] * spans
    reaches_m = np.maximum(along_starts + shares * along_spans, 0.0)
    better = (np.einsum("ikj,ikj->ik", feet, feet) - reaches_m * reaches_m).argmin(axis=1)
    chosen = np.arange(len(better)), better
    piece, share, reach_m = pieces[chosen], shares[chosen], reaches_m[chosen]
    is_inside = ((piece > 0) | (share > 0.0)) & ((piece < last) | (share < 1.0))
    is_found = is_inside & (reach_m > 0.0) & is_across[chosen]
    sines = np.sqrt(np.where(is_found, across_squared[chosen] / lengths_squared[chosen], 1.0))
    return np.where(is_found, reach_m, np.nan), np.where(is_found, sines, np.nan)
