"""Lane markings in our own light: how we stand between them, and how the body is pitched.

The ground before us is looked at in strips across the road, as if it were flat and we level. Markings are thin ridges
of light in a strip. A marking at Y to our left then lies at

    y(x) = Y - x (yaw + Y pitch / h) + curvature x^2 / 2,

h the camera's height: yaw turns all of them alike, and pitch makes them converge or part.
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
"""Distances of the strips: nearer is the bonnet, farther a marking is thinner than three pixels of PVDN's camera."""

REACH_M = 6.5
STEP_M = 0.05
ACROSS_M = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)

HALF_WIDTH = 1
GAP = 3
"""A ridge is the mean of 0.15 m over both means of 0.15 m beside it, whose middles are 0.2 m away; in steps."""

MIN_RIDGE_GREY = 6.0
"""Of 255; and it must stand out of the strip's other ridges by `MIN_RATIO` of their mean."""

MIN_RATIO = 3.0
SEARCH_M = 0.9
"""To either side of where a marking should be."""

MIN_STRIPS = 6
PLACE_SIGMA_M = 0.06
"""Of a marking in a strip; the fit's own residuals count where they are larger."""

TOLERANCES_M = (0.35, 0.15, 0.1)
"""Off a marking's median place, then off the lines fitted so far."""

CURVATURE_SIGMA_PER_M = 2e-3
"""Of the map's curvature at the believed place."""

PRIOR_SIGMAS_RAD = np.radians([2.0, 0.5])
"""Of yaw and pitch, of any car on any road: what a fit may come to."""

LANE_SIGMA_M = 0.3
"""Of the believed width of a lane: where one marking is seen alone."""

SLOPE_SIGMA_RAD = math.radians(0.1)
"""Of the road's slope within the strips against that under the car."""


@dataclass(frozen=True, slots=True)
class LaneView:
    """How we stand between the markings; an infinite sigma where they do not tell.

    Attributes:
        yaw_rad: How far we head to the left of them.
        left_m: How far we are to the left of our lane's middle.
        pitch_rad: Nose up against the road.
        yaw_sigma_rad: Standard deviation of the yaw.
        left_sigma_m: Of the offset.
        pitch_sigma_rad: Of the pitch.
    """

    yaw_rad: float = 0.0
    left_m: float = 0.0
    pitch_rad: float = 0.0
    yaw_sigma_rad: float = math.inf
    left_sigma_m: float = math.inf
    pitch_sigma_rad: float = math.inf


class MarkingFinder:
    """Finds the markings of our lane; remembers where the latest camera sees the strips.

    Those of the other lane lie on another plane where the road has a crown.
    """

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._pixels = np.zeros((0, 0), np.intp)
        self._is_seen = np.zeros((0, 0), np.bool_)
        self._frame: Frame | None = None
        self._view = LaneView()

    def find(self, frame: Frame) -> LaneView:
        """How we stand in `frame`; nothing known without a camera, or with fewer than `MIN_STRIPS` ridges."""
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
        places_m, is_ridge = _places(ridges, lines_m, bends_m)
        height_m = float(camera.vehicle_from_camera.position_m[2])
        # What lies higher looks farther away, and further to the side, than it is.
        return _fitted(places_m * (1.0 - heights_m / height_m), is_ridge, lines_m, height_m)


def _strip_pixels(camera: Camera) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Flat index of the pixel that sees each place of the strips, shape (strips, places), and whether one does."""
    x, y = np.meshgrid(STRIPS_M, ACROSS_M, indexing="ij")
    points = camera.vehicle_from_camera.to_body(np.stack([x, y, np.zeros_like(x)], -1))
    pixels = camera.project(points)
    is_seen = (pixels >= 0).all(-1) & (pixels < (camera.width_px, camera.height_px)).all(-1)
    # Far outside the view the distortion may fold back.
    half_view = np.hypot(camera.width_px / camera.focal_px[0], camera.height_px / camera.focal_px[1]) / 2 + 0.1
    is_seen &= np.hypot(points[..., 1], points[..., 2]) < half_view * points[..., 0]
    columns, rows = (np.where(is_seen, np.floor(pixels[..., axis]), 0).astype(np.intp) for axis in (0, 1))
    return rows * camera.width_px + columns, is_seen


def _ridges(image: Image, pixels: NDArray[np.intp], is_seen: NDArray[np.bool_]) -> Floats:
    """How much each place of the strips stands out of both its neighbours, grey levels of 255; shape as `pixels`."""
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


def _places(ridges: Floats, lines_m: Floats, bends_m: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Where each strip has each marking, straightened; shape (lines, strips), and whether it has one."""
    noise = ridges.mean(axis=1)
    rows = np.arange(len(ridges))
    places, found = [], []
    for line_m in lines_m:
        begins = np.rint((line_m + bends_m - SEARCH_M + REACH_M) / STEP_M).astype(np.intp)
        columns = begins[:, None] + np.arange(round(2 * SEARCH_M / STEP_M) + 1)
        window = ridges[rows[:, None], np.clip(columns, 0, len(ACROSS_M) - 1)]
        best = window.argmax(axis=1)
        peaks = window[rows, best]
        places.append((begins + best) * STEP_M - REACH_M - bends_m)
        found.append(peaks > np.maximum(MIN_RIDGE_GREY, MIN_RATIO * noise))
    return np.array(places), np.array(found)


def _fitted(places_m: Floats, is_ridge: NDArray[np.bool_], lines_m: Floats, height_m: float) -> LaneView:
    """Least squares over all markings, without what lies off: first off the markings' medians, then off the fit's."""
    medians_m = [
        np.median(places[is_one]) if is_one.any() else np.inf for places, is_one in zip(places_m, is_ridge, strict=True)
    ]
    fitted_m = np.repeat(np.array(medians_m)[:, None], len(STRIPS_M), axis=1)
    fit: _Fit | None = None
    for tolerance_m in TOLERANCES_M:
        is_used = is_ridge & (np.abs(places_m - fitted_m) < tolerance_m)
        is_used &= (is_used.sum(axis=1) >= MIN_STRIPS)[:, None]
        if not is_used.any():
            return LaneView()
        fit = _fit(places_m, is_used, lines_m, height_m)
        fitted_m = fit.lines_m
    assert fit is not None
    is_line = is_used.any(axis=1)
    left_m, left_sigma_m = _offset(fit.at_us_m, is_line, lines_m)
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
    """Markings as straight lines: where each is beside us and in each strip, and how we stand against them."""

    at_us_m: Floats
    lines_m: Floats
    yaw_rad: float
    pitch_rad: float
    yaw_sigma_rad: float
    pitch_sigma_rad: float


def _fit(places_m: Floats, is_used: NDArray[np.bool_], lines_m: Floats, height_m: float) -> _Fit:
    """The lines through the used places; what they do not tell stays at nothing."""
    num = len(lines_m)
    line, strip = np.nonzero(is_used)
    # Unknown are where each marking is, what the map's curvature lacks, the yaw, and the pitch.
    rows = np.zeros((len(line), num + 3))
    rows[np.arange(len(line)), line] = 1.0
    rows[:, -3] = STRIPS_M[strip] ** 2 / 2
    rows[:, -2], rows[:, -1] = -STRIPS_M[strip], -STRIPS_M[strip] * lines_m[line] / height_m
    prior = np.diag(
        np.concatenate([1e-6 + ~is_used.any(axis=1), [CURVATURE_SIGMA_PER_M**-2.0], PRIOR_SIGMAS_RAD**-2.0])
    )
    precision = rows.T @ rows / PLACE_SIGMA_M**2 + prior
    covariance = np.linalg.inv(precision)
    solved = covariance @ (rows.T @ places_m[is_used]) / PLACE_SIGMA_M**2
    residuals_m = places_m[is_used] - rows @ solved
    sigmas = np.sqrt(np.diag(covariance) * max(float(np.mean(residuals_m**2)) / PLACE_SIGMA_M**2, 1.0))
    slopes = solved[-2] + lines_m * solved[-1] / height_m
    lines = solved[:num, None] - slopes[:, None] * STRIPS_M + solved[num] * STRIPS_M**2 / 2
    return _Fit(solved[:num], lines, float(solved[-2]), float(solved[-1]), float(sigmas[-2]), float(sigmas[-1]))


def _offset(at_us_m: Floats, is_line: NDArray[np.bool_], lines_m: Floats) -> tuple[float, float]:
    """How far we are to the left of our lane's middle: halfway between its markings, or by the lane's width."""
    if is_line[0] and is_line[1]:
        return float(-(at_us_m[0] + at_us_m[1]) / 2), PLACE_SIGMA_M
    seen = int(is_line.argmax())
    return float(lines_m[seen] - at_us_m[seen]), LANE_SIGMA_M * abs(float(lines_m[seen] / (lines_m[0] - lines_m[1])))
