"""Which tracks are lamps of the same vehicle: two at similar height, as far apart as headlamps are at their range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Floats
from foreglow.types import Tracks

SPACING_M, SPACING_LOG_SIGMA = 1.35, 0.2
"""Distance between a vehicle's lamps, 1.1 to 2 m, and its relative spread; an oblique view makes it shorter."""

RISE_SIGMA_M, RISE_SIGMA_PX = 0.05, 4.0
"""Standard deviation of the height of one lamp above the other: vehicles lean, and glare moves boxes."""

HEIGHT_LOG_SIGMA = 0.5
"""Relative standard deviation of the boxes' heights to each other: lamps of a vehicle look alike."""

MAX_DEVIATION = 3.0
"""Combined standard deviations up to which two lamps count as the same vehicle's."""


def group_vehicles(tracks: Tracks, camera: Camera) -> tuple[NDArray[np.int64], ...]:
    """The vehicles whose lamps are among the plausible tracks, as indices into `tracks`: one or two lamps each.

    Tracks that are probably light on a surface belong to no vehicle; if that is unknown, a track counts as a lamp. When
    lamps could be paired in several ways, the likeliest pair is taken first; a lamp without a range stays alone.

    Args:
        tracks: The tracks of one frame.
        camera: Calibration of the frame's image.

    Returns:
        The indices of each vehicle's lamps, ascending; vehicles in the order of their first lamp.
    """
    lamps = np.flatnonzero(tracks.is_plausible & ~(tracks.direct_probabilities < 0.5))
    deviations = _deviations(tracks, camera, lamps)
    is_free = np.ones(len(lamps), np.bool_)
    vehicles = []
    for index in np.argsort(deviations, axis=None, kind="stable"):
        first, second = divmod(int(index), len(lamps))
        if not deviations[first, second] <= MAX_DEVIATION:
            break
        if is_free[first] and is_free[second]:
            is_free[[first, second]] = False
            vehicles.append(lamps[[first, second]])
    vehicles += [lamps[[lamp]] for lamp in np.flatnonzero(is_free)]
    return tuple(sorted(vehicles, key=lambda vehicle: int(vehicle[0])))


def _deviations(tracks: Tracks, camera: Camera, lamps: NDArray[np.int64]) -> Floats:
    """How many standard deviations two lamps are from being a pair, shape (L, L); infinite on and below the diagonal.

    Combines spacing and rise at the common range, the similarity of the boxes, and the difference of the ranges.
    """
    boxes, ranges_m, sigmas_m = tracks.boxes_xyxy_px[lamps], tracks.ranges_m[lamps], tracks.sigmas_m[lamps]
    heights_px = boxes[:, 3] - boxes[:, 1]
    rays = camera.rays((boxes[:, :2] + boxes[:, 2:]) / 2.0) @ camera.vehicle_from_camera.rotation.T
    bearings = np.arctan2(rays[:, 1], rays[:, 0])
    slopes = rays[:, 2] / np.hypot(rays[:, 0], rays[:, 1])
    weights = 1.0 / np.where(np.isfinite(sigmas_m), sigmas_m, ranges_m) ** 2
    sums = weights[:, None] + weights
    range_m, sigma_m = (weights * ranges_m + (weights * ranges_m)[:, None]) / sums, 1.0 / np.sqrt(sums)
    spacing_m = np.abs(bearings[:, None] - bearings) * range_m
    rise_m = np.abs(slopes[:, None] - slopes) * range_m
    pixel_m = range_m / camera.focal_px[1]
    with np.errstate(divide="ignore"):
        deviations = np.sqrt(
            (np.log(spacing_m / SPACING_M) / np.hypot(SPACING_LOG_SIGMA, sigma_m / range_m)) ** 2
            + (rise_m / np.hypot(RISE_SIGMA_M, RISE_SIGMA_PX * pixel_m)) ** 2
            + (np.log(heights_px[:, None] / heights_px) / HEIGHT_LOG_SIGMA) ** 2
            + (ranges_m[:, None] - ranges_m) ** 2 * weights[:, None] * weights / sums
        )
    is_pair = np.triu(np.ones(deviations.shape, np.bool_), 1) & np.isfinite(deviations)
    return np.where(is_pair, deviations, np.inf)
