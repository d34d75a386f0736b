"""Ranges from the road's surface: what may be lit where along the road ahead, and what the box speaks for.

`docs/road_surface.md` has the equations, what is assumed and how the model was fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from foreglow.config import DistanceConfig
from foreglow.distance.alignment import RoadAligner, believed
from foreglow.distance.box_light import light_of_boxes
from foreglow.distance.hypotheses import (
    FEATURE_MEANS,
    FEATURE_SCALES,
    BoxEvidence,
    Cells,
    Parameters,
    cells_along,
    log_weights,
    parameters_of,
    read_hypotheses,
)
from foreglow.distance.lamp_pairs import SPACING_M, pair_spacings_rad
from foreglow.distance.pitch import MarkingsPitch, make_pitch_source
from foreglow.distance.rays import RayCaster
from foreglow.distance.ribbon import Ribbon, ribbon
from foreglow.geometry import Floats
from foreglow.types import Detections, Frame, Ranges

BELOW_ONE_SIGMA = 0.1587
"""Share of a Gaussian."""


class View(NamedTuple):
    """What a frame offers to the model.

    Attributes:
        road: As it lies before us; None where there is none, or where our place on it is not known.
        camera_m: Shape (3,), where the camera is.
        pitch_sigma_rad: Standard deviation of its pitch.
        boxes: What is seen of the boxes.
    """

    road: Ribbon | None
    camera_m: Floats
    pitch_sigma_rad: float
    boxes: BoxEvidence


class RoadSurface:
    """For each box, the hypotheses of all kinds of light along the road; their weighted median is its range.

    Without a road, beyond the map's end and where light is seen that the map has no place for, those kinds count that
    are tied to no line: at their height above the plane that we stand on.
    """

    def __init__(self, config: DistanceConfig) -> None:
        """Reads the model.

        Raises:
            FileNotFoundError: If the configured model does not exist.
            ValueError: If it is broken, or there is no source of the pitch that `config` asks for.
        """
        self.model = read_hypotheses(config.model)
        self._parameters = parameters_of(self.model)
        self._in_single = _single(self._parameters)
        self._pitch = make_pitch_source(config.pitch)
        finder = self._pitch.finder if isinstance(self._pitch, MarkingsPitch) else None
        self._aligner = RoadAligner(finder) if config.align else None
        self._caster = RayCaster()

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        """The ranges of `detections` in `frame`: one for every box, with a finite sigma.

        Frames come in the order of time; those without boxes count, too, for what is learnt of our place.

        Raises:
            ValueError: If the frame has no camera, or one whose distortion cannot be undone.
        """
        view = self.view(frame, detections)
        if len(detections) == 0:
            return Ranges(detections, np.zeros(0), np.zeros(0))
        cells = cells_along(self._parameters, view.road, view.camera_m, view.pitch_sigma_rad)
        weights = log_weights(self._in_single, _single(cells), _single(view.boxes))
        shares = (BELOW_ONE_SIGMA, 0.5, 1.0 - BELOW_ONE_SIGMA)
        near_m, ranges_m, far_m = np.exp(weighted_quantiles(cells.log_ranges, weights, shares))
        return Ranges(detections, ranges_m, (far_m - near_m) * (0.5 * self.model.sigma_scale))

    def view(self, frame: Frame, detections: Detections) -> View:
        """What `frame` offers to the model; the state goes on as in `estimate`.

        Raises:
            ValueError: If the frame has no camera, or one whose distortion cannot be undone.
        """
        camera = frame.camera
        if camera is None:
            raise ValueError(f"Frame.camera: expected a calibration to estimate ranges, frame {frame.frame} has none")
        alignment = believed(frame) if self._aligner is None else self._aligner.align(frame)
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
        boxes = BoxEvidence(
            directions_rad=directions,
            sizes_rad=sizes,
            features=(features - FEATURE_MEANS) / FEATURE_SCALES,
            pair_log_ranges=np.log(SPACING_M / pair_spacings_rad(directions, sizes, contrasts)),
        )
        return View(road, rays.origin_m, pitch.sigma_rad, boxes)

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._pitch.reset()
        if self._aligner is not None:
            self._aligner.reset()


def weighted_quantiles(values: Floats, log_weights: NDArray[np.floating], shares: Sequence[float]) -> Floats:
    """For each share, the value that so much of the weight lies below, shape (len(shares), N).

    Every value stands for the middle of its weight; between two of them it is linear.

    Args:
        values: Shape (C,).
        log_weights: Shape (N, C), to a constant in each row.
        shares: Between 0 and 1.

    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.zeros((1, 3)), [0.5, 1 / 3]).round(6).tolist()
    [[2.0], [1.5]]
    """
    order = np.argsort(values)
    values = values[order]
    weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))[:, order]
    weights /= weights.sum(axis=1, keepdims=True)
    # One after another the rows make one rising line, on which all is looked up at once: row i goes from i to i + 1.
    ends = weights.ravel().cumsum(dtype=np.float64)
    middles = ends - 0.5 * weights.ravel()
    wanted = np.arange(len(weights)) + np.asarray(shares)[:, None]
    firsts = np.arange(len(weights)) * len(values)
    after = np.minimum(np.maximum(middles.searchsorted(wanted), firsts + 1), firsts + len(values) - 1)
    low, high = middles[after - 1], middles[after]
    between = np.minimum(np.maximum((wanted - low) / np.maximum(high - low, 1e-30), 0.0), 1.0)
    after -= firsts
    return np.asarray(values[after - 1] + between * (values[after] - values[after - 1]))


_Tuple = TypeVar("_Tuple", Parameters, Cells, BoxEvidence)


def _single(numbers: _Tuple) -> _Tuple:
    """The same in single precision, in which all boxes are weighed against all hypotheses: half the time."""
    return type(numbers)(*(one if one.dtype == np.bool_ else one.astype(np.float32) for one in numbers))
