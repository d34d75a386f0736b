"""Lane markings in the headlamps' light: the vehicle's pose between them, and the pitch of its body.

Units: metres, radians, grey levels of 255; x forward, y left; yaw to the left, pitch nose up, curvature to the left.

Strips of ground across the road, at the distances x of `STRIPS_M`, are read from the image as if the ground were flat
and the vehicle level. Across a strip, a marking is a thin ridge. With the mean m(y) over 0.15 m, its strength is

    ridge(y) = max(m(y) - max(m(y - 0.2 m), m(y + 0.2 m)), 0)                                                   (1)

A marking that is Y to the left of the vehicle is seen in the strip at x, for a camera at the height h, at

    y(x) = Y - x (yaw + Y pitch / h) + x^2 curvature / 2                                                        (2)

Yaw turns all markings alike; pitch makes them converge or diverge, so it needs two. (2) is linear in
theta = (Y_1, Y_2, curvature, yaw, pitch): the curvature is the road's minus the map's, since the map's course is taken
off before the fit, and Y in the term of the pitch is taken from the lane's width. With a row a_i for each ridge
at y_i, and a diagonal prior precision Q about 0,

    theta = S A' y / sigma^2,   S = (A' A / sigma^2 + Q)^-1                                                     (3)

S is scaled up by the mean squared residual over sigma^2, if that is above 1. Ridges far off the fit are left out, and
the fit is repeated, three times in all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.distance.ribbon import mapped_course
from foreglow.geometry import Camera, Floats
from foreglow.street import LANE_WIDTH_M
from foreglow.types import Frame, Image

STRIPS_M = np.geomspace(7.0, 24.0, 20)
"""Distances of the strips. Nearer, the bonnet hides the road; farther, a marking is thinner than three pixels of PVDN's
camera."""

REACH_M = 6.5
STEP_M = 0.05
ACROSS_M = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)

HALF_WIDTH = 1
GAP = 3
"""Windows of (1) in steps of `STEP_M`: half the width of a mean, and the gap between two means."""

MIN_RIDGE_GREY = 6.0
MIN_RATIO = 3.0
"""A marking's ridge has at least this strength, and at least this many times the mean strength in its strip."""

SEARCH_M = 0.9
"""How far to either side of its expected position a marking is searched for."""

MIN_STRIPS = 6
"""A marking has to be found in at least so many strips."""

MARKING_SIGMA_M = 0.06
"""sigma in (3), of a marking's position in a strip."""

TOLERANCES_M = (0.35, 0.15, 0.1)
"""How far a ridge may be off the marking's median position, then off the lines fitted so far."""

CURVATURE_SIGMA_PER_M = 2e-3
"""Standard deviation of the map's curvature, in Q."""

PRIOR_SIGMAS_RAD = np.radians([2.0, 0.5])
"""Standard deviations of yaw and pitch of any car on any road, in Q."""

LANE_SIGMA_M = 0.3
"""Standard deviation of the assumed lane width, which counts where a single marking is seen."""

MAX_LANE_ERROR_M = 0.9
"""Two markings whose distance differs more from the assumed one are not those of one lane of two."""

SLOPE_SIGMA_RAD = math.radians(0.1)
"""Standard deviation of the road's slope within the strips against that under the vehicle."""


@dataclass(frozen=True, slots=True)
class LaneView:
    """The vehicle's pose between the markings; infinite standard deviations where nothing was measured.

    Attributes:
        yaw_rad: Heading to the left of the markings.
        left_m: Offset to the left of the middle of the vehicle's lane.
        pitch_rad: Nose up against the road.
        yaw_sigma_rad: Standard deviation of the yaw.
        left_sigma_m: Standard deviation of the offset.
        pitch_sigma_rad: Standard deviation of the pitch.
    """

    yaw_rad: float = 0.0
    left_m: float = 0.0
    pitch_rad: float = 0.0
    yaw_sigma_rad: float = math.inf
    left_sigma_m: float = math.inf
    pitch_sigma_rad: float = math.inf


class MarkingFinder:
    """Finds the two markings of the vehicle's own lane; remembers which pixels of the latest camera show the strips.

    The other lane's markings are not used: where the road has a crown, they lie on another plane.
    """

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._pixels = np.zeros((0, 0), np.intp)
        self._is_seen = np.zeros((0, 0), np.bool_)
        self._frame: Frame | None = None
        self._view = LaneView()

    def find(self, frame: Frame) -> LaneView:
        """The pose in `frame`; unknown without a camera, or with fewer than `MIN_STRIPS` ridges."""
        if frame is not self._frame:
            self._frame, self._view = frame, self._found(frame)
        return self._view

    def _found(self, frame: Frame) -> LaneView:
        camera, road = frame.camera, frame.road
        if camera is None or camera.vehicle_from_camera.position_m[2] <= 0:
            return LaneView()
        if camera is not self._camera:
            self._camera, (self._pixels, self._is_seen) = camera, _strip_pixels(camera)
        width_m = LANE_WIDTH_M if road is None else road.half_width_m
        bends_m, heights_m = np.zeros(len(STRIPS_M)), np.zeros(len(STRIPS_M))
        if road is not None:
            bends_m, heights_m = mapped_course(road, STRIPS_M)
        ridges = _ridges(frame.image, self._pixels, self._is_seen)
        lines_m = np.array([0.5, -0.5]) * width_m
        positions_m, is_ridge = _positions(ridges, lines_m, bends_m)
        height_m = float(camera.vehicle_from_camera.position_m[2])
        # Ground that is higher than assumed looks farther away, and further to the side, than it is.
        return _fitted(positions_m * (1.0 - heights_m / height_m), is_ridge, lines_m, height_m)


def _strip_pixels(camera: Camera) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Flat index of the pixel that shows each step of each strip, shape (strips, steps), and whether there is one."""
    x, y = np.meshgrid(STRIPS_M, ACROSS_M, indexing="ij")
    points = camera.vehicle_from_camera.to_body(np.stack([x, y, np.zeros_like(x)], -1))
    pixels = camera.project(points)
    is_seen = (pixels >= 0).all(-1) & (pixels < (camera.width_px, camera.height_px)).all(-1)
    # Far outside the field of view, the distortion polynomial may fold back into the image.
    half_view = np.hypot(camera.width_px / camera.focal_px[0], camera.height_px / camera.focal_px[1]) / 2 + 0.1
    is_seen &= np.hypot(points[..., 1], points[..., 2]) < half_view * points[..., 0]
    columns, rows = (np.where(is_seen, np.floor(pixels[..., axis]), 0).astype(np.intp) for axis in (0, 1))
    return rows * camera.width_px + columns, is_seen


def _ridges(image: Image, pixels: NDArray[np.intp], is_seen: NDArray[np.bool_]) -> Floats:
    """Strength (1) of the ridge at each step of the strips, grey levels of 255; shape as `pixels`."""
    strips = image.reshape(-1)[pixels] * (255.0 / np.iinfo(image.dtype).max)
    width = 2 * HALF_WIDTH + 1
    sums = np.zeros((strips.shape[0], strips.shape[1] + 1))
    np.cumsum(strips, axis=1, out=sums[:, 1:])
    means = (sums[:, width:] - sums[:, :-width]) / width
    shift = HALF_WIDTH + GAP
    ridges = np.zeros_like(strips)
    middle = means[:, shift:-shift] - np.maximum(means[:, : -2 * shift], means[:, 2 * shift :])
    ridges[:, shift + HALF_WIDTH : -shift - HALF_WIDTH] = middle
    return np.where(is_seen, np.maximum(ridges, 0.0), 0.0)


def _positions(ridges: Floats, lines_m: Floats, bends_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Position of each marking in each strip, less the map's bend, shape (lines, strips), and whether it is there."""
    noise = ridges.mean(axis=1)
    rows = np.arange(len(ridges))
    positions, found = [], []
    for line_m in lines_m:
        begins = np.rint((line_m + bends_m - SEARCH_M + REACH_M) / STEP_M).astype(np.intp)
        columns = begins[:, None] + np.arange(round(2 * SEARCH_M / STEP_M) + 1)
        window = ridges[rows[:, None], np.clip(columns, 0, len(ACROSS_M) - 1)]
        best = window.argmax(axis=1)
        peaks = window[rows, best]
        positions.append((begins + best) * STEP_M - REACH_M - bends_m)
        found.append(peaks > np.maximum(MIN_RIDGE_GREY, MIN_RATIO * noise))
    return np.array(positions), np.array(found)


def _fitted(positions_m: Floats, is_ridge: NDArray[np.bool_], lines_m: Floats, height_m: float) -> LaneView:
    """The pose by (3) without outliers, which are ridges far off the marking's median, then far off the last fit."""
    medians_m = [
        np.median(positions[is_found]) if is_found.any() else np.inf
        for positions, is_found in zip(positions_m, is_ridge, strict=True)
    ]
    fitted_m = np.repeat(np.array(medians_m)[:, None], len(STRIPS_M), axis=1)
    fit: _Fit | None = None
    for tolerance_m in TOLERANCES_M:
        is_used = is_ridge & (np.abs(positions_m - fitted_m) < tolerance_m)
        is_used &= (is_used.sum(axis=1) >= MIN_STRIPS)[:, None]
        if not is_used.any():
            return LaneView()
        fit = _fit(positions_m, is_used, lines_m, height_m)
        fitted_m = fit.lines_m
    assert fit is not None
    is_line = is_used.any(axis=1)
    left_m, left_sigma_m = _offset(fit.beside_m, is_line, lines_m)
    is_pitch_seen = int(is_line.sum()) >= 2
    return LaneView(
        yaw_rad=fit.yaw_rad,
        left_m=left_m,
        pitch_rad=fit.pitch_rad if is_pitch_seen else 0.0,
        yaw_sigma_rad=fit.yaw_sigma_rad,
        left_sigma_m=left_sigma_m,
        pitch_sigma_rad=math.hypot(fit.pitch_sigma_rad, SLOPE_SIGMA_RAD) if is_pitch_seen else math.inf,
    )


class _Fit(NamedTuple):
    """The markings beside the vehicle (Y) and in each strip, and the vehicle's pose between them."""

    beside_m: Floats
    lines_m: Floats
    yaw_rad: float
    pitch_rad: float
    yaw_sigma_rad: float
    pitch_sigma_rad: float


def _fit(positions_m: Floats, is_used: NDArray[np.bool_], lines_m: Floats, height_m: float) -> _Fit:
    """Equation (3) over the used positions; what they do not determine stays at its prior mean, 0."""
    num = len(lines_m)
    line, strip = np.nonzero(is_used)
    rows = np.zeros((len(line), num + 3))  # A, by (2)
    rows[np.arange(len(line)), line] = 1.0
    rows[:, -3] = STRIPS_M[strip] ** 2 / 2
    rows[:, -2], rows[:, -1] = -STRIPS_M[strip], -STRIPS_M[strip] * lines_m[line] / height_m
    prior = np.diag(
        np.concatenate([1e-6 + ~is_used.any(axis=1), [CURVATURE_SIGMA_PER_M**-2.0], PRIOR_SIGMAS_RAD**-2.0])
    )
    precision = rows.T @ rows / MARKING_SIGMA_M**2 + prior
    covariance = np.linalg.inv(precision)
    solved = covariance @ (rows.T @ positions_m[is_used]) / MARKING_SIGMA_M**2  # (3)
    residuals_m = positions_m[is_used] - rows @ solved
    sigmas = np.sqrt(np.diag(covariance) * max(float(np.mean(residuals_m**2)) / MARKING_SIGMA_M**2, 1.0))
    slopes = solved[-2] + lines_m * solved[-1] / height_m
    lines = solved[:num, None] - slopes[:, None] * STRIPS_M + solved[num] * STRIPS_M**2 / 2
    return _Fit(solved[:num], lines, float(solved[-2]), float(solved[-1]), float(sigmas[-2]), float(sigmas[-1]))


def _offset(beside_m: Floats, is_line: NDArray[np.bool_], lines_m: Floats) -> tuple[float, float]:
    """Offset to the left of the lane's middle: from both markings, or from one of them and the lane's width.

    Unknown where they are apart as the markings of another lane are, as on roads of more lanes.
    """
    if is_line[0] and is_line[1]:
        if abs((beside_m[0] - beside_m[1]) - (lines_m[0] - lines_m[1])) > MAX_LANE_ERROR_M:
            return 0.0, math.inf
        return float(-(beside_m[0] + beside_m[1]) / 2), MARKING_SIGMA_M
    seen = int(is_line.argmax())
    return float(lines_m[seen] - beside_m[seen]), LANE_SIGMA_M * abs(float(lines_m[seen] / (lines_m[0] - lines_m[1])))
