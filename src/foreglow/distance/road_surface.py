"""Ranges by the road-surface model: which kinds of light may be where along the road, and which of them a box shows.

`hypotheses` has the equations; `docs/road_surface.md` has the assumptions and how the model was fitted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import foreglow._native as _native
from foreglow.config import DistanceConfig
from foreglow.distance.alignment import RoadAligner, map_alignment
from foreglow.distance.hypotheses import (
    FEATURE_MEANS,
    FEATURE_SCALES,
    BoxEvidence,
    parameters_of,
    read_hypotheses,
)
from foreglow.distance.interface import RangeEstimator
from foreglow.distance.lamp_pairs import NEAREST_TWINS_M, SPACING_M, pair_spacings_rad, twin_columns_px
from foreglow.distance.pitch import MarkingsPitch, make_pitch_source
from foreglow.distance.ribbon import Ribbon, ribbon
from foreglow.distance.weighing import Weigher
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster, calibrated
from foreglow.types import Boxes, Detections, Frame, Image, Ranges
from foreglow.types.arrays import check_kind, with_adjacent_columns

CONTRAST_FLOOR = 5.0
"""Grey levels of 255 that are added to a contrast before its logarithm."""


def light_of_boxes(image: Image, boxes_xyxy_px: Boxes) -> tuple[Floats, Floats]:
    """Where the light of each box is, and how much it stands out.

    A box is sampled on a grid of 9 x 9 points, which costs the same for boxes of any size. The surroundings are 16
    points up to half its width and height beyond it; their median counts, since other lights may be among them.

    Args:
        image: The frame's pixels.
        boxes_xyxy_px: Shape (N, 4).

    Returns:
        Pixels (x, y), shape (N, 2): the mean position in the box, weighted with the square of each pixel's excess over
        the surroundings; the centre of a box without light. And contrasts, shape (N,): the brightest pixel over the
        surroundings in grey levels of 255, plus `CONTRAST_FLOOR`.
    """
    pixels, peaks = _native.light_of_boxes(with_adjacent_columns(image), boxes_xyxy_px)
    return pixels, 255.0 * peaks + CONTRAST_FLOOR


class View(NamedTuple):
    """What the model needs of a frame.

    Attributes:
        road: The road in the vehicle's frame; None without a road, or where the position on it is unknown.
        camera_m: Shape (3,), position of the camera.
        pitch_sigma_rad: Standard deviation of its pitch.
        boxes: What is observed of the boxes.
    """

    road: Ribbon | None
    camera_m: Floats
    pitch_sigma_rad: float
    boxes: BoxEvidence


class RoadSurface(RangeEstimator):
    """Weighs the hypotheses of all kinds of light along the road for each box; their weighted median is its range.

    Without a road, beyond the map's end, and for light that no line of the map explains, the kinds that are tied to no
    line remain: those at a height above the plane under the vehicle.
    """

    def __init__(self, config: DistanceConfig) -> None:
        """Reads the model.

        Raises:
            FileNotFoundError: If the configured model does not exist.
            ValueError: If it is broken, or there is no source of the pitch that `config` asks for.
        """
        check_kind("config", config, DistanceConfig)
        self.model = read_hypotheses(config.model)
        self._weigher = Weigher(parameters_of(self.model))
        self._pitch = make_pitch_source(config.pitch)
        finder = self._pitch.finder if isinstance(self._pitch, MarkingsPitch) else None
        self._aligner = RoadAligner(finder) if config.align else None
        self._caster = RayCaster()

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        """The ranges of `detections` in `frame`: one for every box, with a finite sigma.

        Frames come in the order of time; those without boxes matter too, since they improve the vehicle's position.

        Raises:
            ValueError: If the frame has no camera, or one whose distortion cannot be undone.
        """
        check_kind("frame", frame, Frame)
        check_kind("detections", detections, Detections)
        view = self.view(frame, detections)
        if len(detections) == 0:
            return Ranges(detections, np.zeros(0), np.zeros(0))
        cells = self._weigher.cells_along(view.road, view.camera_m, view.pitch_sigma_rad)
        near_m, ranges_m, far_m = self._weigher.ranges(cells, view.boxes)
        sigmas_m = (far_m - near_m) * (0.5 * self.model.sigma_scale)
        height_sigma_m = calibrated(frame).mount_sigmas.height_m
        if height_sigma_m:
            sigmas_m = np.hypot(sigmas_m, ranges_m * height_sigma_m / view.camera_m[2])
        return Ranges(detections, ranges_m, sigmas_m)

    def view(self, frame: Frame, detections: Detections) -> View:
        """What the model needs of `frame`; the state is updated as in `estimate`.

        Raises:
            ValueError: If the frame has no camera, or one whose distortion cannot be undone.
        """
        camera = calibrated(frame)
        alignment = map_alignment(frame) if self._aligner is None else self._aligner.align(frame)
        pitch = self._pitch.pitch(frame)
        is_placed = frame.road is not None and np.isfinite(alignment.shift_sigma_m)
        road = ribbon(frame.road, alignment) if frame.road is not None and is_placed else None
        boxes_px = detections.boxes_xyxy_px
        pixels, contrasts = light_of_boxes(frame.image, boxes_px)
        rays = self._caster.cast(camera, pixels, pitch.rad)
        forward, left, up = rays.directions.T
        directions = np.stack([np.arctan2(left, forward), np.arctan2(up, np.hypot(forward, left))], -1)
        sizes = (boxes_px[:, 2:] - boxes_px[:, :2]) / camera.focal_px
        features = np.stack([np.log(sizes[:, 0]), np.log(sizes[:, 1] / sizes[:, 0]), np.log(contrasts)], -1)
        spacings_rad = pair_spacings_rad(directions, sizes, contrasts)
        twins_px = twin_columns_px(frame.image, boxes_px)
        twins = np.flatnonzero(np.isnan(spacings_rad) & ~np.isnan(twins_px[:, 0]))
        if len(twins):
            apart_rad = self._apart_rad(camera, twins_px[twins], pixels[twins, 1])
            spacings_rad[twins] = np.where(apart_rad < SPACING_M / NEAREST_TWINS_M, apart_rad, np.nan)
        boxes = BoxEvidence(
            directions_rad=directions,
            sizes_rad=sizes,
            features=(features - FEATURE_MEANS) / FEATURE_SCALES,
            pair_log_ranges=np.log(SPACING_M / spacings_rad),
        )
        return View(road, rays.origin_m, pitch.sigma_rad, boxes)

    def _apart_rad(self, camera: Camera, columns_px: Floats, rows_px: Floats) -> Floats:
        """Angles between two columns in a row each, shape (M,), radians."""
        pixels = np.stack([columns_px, np.repeat(rows_px[:, None], 2, axis=1)], axis=-1)
        left, right = self._caster.cast(camera, pixels.reshape(-1, 2)).directions.reshape(-1, 2, 3).swapaxes(0, 1)
        return np.asarray(np.linalg.norm(left - right, axis=-1))

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._pitch.reset()
        if self._aligner is not None:
            self._aligner.reset()
