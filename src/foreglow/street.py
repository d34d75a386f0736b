"""Predictive street data (PSD): the messages about the road ahead that a car gets, and the road they describe.

A street message resembles those in real cars: the map is cut into segments with a length in steps of 2 m, a curvature
at the start and at the end (8 bits and a sign) and one slope in steps of 0.5 %; the position on the map comes with a
class of longitudinal error. The scale of the curvature code is not published, and decoders disagree; here it is
geometric: codes 0..254 are radii from 10 m to 10 km in equal ratios of 2.8 %, and 255 is straight.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
from pydantic import Field

from foreglow.config import FrozenModel
from foreglow.geometry import Floats, rotation
from foreglow.types import RoadAhead

LENGTH_STEP_M = 2.0
MAX_LENGTH_CODE = 127
SLOPE_STEP = 0.005
MAX_SLOPE_CODE = 127
STRAIGHT_CODE = 255
MIN_RADIUS_M = 10.0
MAX_RADIUS_M = 10_000.0
NUM_SEGMENT_IDS = 62
"""Six bits, without 0 (no segment) and 63 (unknown); ids are reused further along the road."""

ERROR_BOUNDS_M = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Largest longitudinal error of each class. The last class, above 50 m, has no bound in real cars; here it has one."""

_RADIUS_RATIO = (MAX_RADIUS_M / MIN_RADIUS_M) ** (1 / (STRAIGHT_CODE - 1))

LANE_WIDTH_M = 3.25
"""Assumed width of a lane: between the 2.75 m and the 3.75 m of rural roads."""

ErrorClass: TypeAlias = Annotated[int, Field(ge=0, lt=len(ERROR_BOUNDS_M))]
"""Longitudinal error: 0 below 2 m, 1 below 5, 2 below 10, 3 below 20, 4 below 50, 5 above 50 m."""

_SegmentId: TypeAlias = Annotated[int, Field(ge=0, le=63)]
_CurvatureCode: TypeAlias = Annotated[int, Field(ge=0, le=STRAIGHT_CODE)]


class StreetSegment(FrozenModel):
    """A piece of the road, in codes.

    Attributes:
        segment_id: Its number, 1..62.
        parent_id: Number of the segment before it; 0 for the first.
        length_code: Length in steps of 2 m.
        start_curvature_code: Curvature at its beginning; see `curvature_code`.
        is_start_left: Whether it bends to the left there.
        end_curvature_code: Curvature at its end; linear in between.
        is_end_left: Whether it bends to the left there.
        slope_code: Slope in steps of 0.5 %, positive upwards.
    """

    segment_id: _SegmentId
    parent_id: _SegmentId
    length_code: Annotated[int, Field(ge=1, le=MAX_LENGTH_CODE)]
    start_curvature_code: _CurvatureCode
    is_start_left: bool
    end_curvature_code: _CurvatureCode
    is_end_left: bool
    slope_code: Annotated[int, Field(ge=-MAX_SLOPE_CODE, le=MAX_SLOPE_CODE)]

    @property
    def length_m(self) -> float:
        """Length of the segment."""
        return self.length_code * LENGTH_STEP_M

    @property
    def curvatures_per_m(self) -> tuple[float, float]:
        """Curvature at the beginning and at the end, positive to the left."""
        return (
            curvature_from_code(self.start_curvature_code, self.is_start_left),
            curvature_from_code(self.end_curvature_code, self.is_end_left),
        )

    @property
    def slope(self) -> float:
        """Rise per metre, no unit."""
        return self.slope_code * SLOPE_STEP


class StreetMessage(FrozenModel):
    """A message about the road ahead.

    Attributes:
        segments: The most probable path; the car is assumed to be in the first segment.
        remaining_length_m: Whole metres from the assumed position to the end of the first segment.
        error_class: Class of the longitudinal error.
    """

    segments: Annotated[tuple[StreetSegment, ...], Field(min_length=1, max_length=NUM_SEGMENT_IDS)]
    remaining_length_m: Annotated[int, Field(ge=0, le=int(MAX_LENGTH_CODE * LENGTH_STEP_M))]
    error_class: ErrorClass

    def to_json(self) -> str:
        """The message as JSON text."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str) -> StreetMessage:
        """The message in `text`.

        Raises:
            ValueError: If a field is missing, unknown or out of range.
        """
        return cls.model_validate_json(text)

    @property
    def error_bound_m(self) -> float:
        """Largest longitudinal error of the message's class."""
        return ERROR_BOUNDS_M[self.error_class]


def road_from_message(message: StreetMessage, travelled_m: float = 0.0) -> RoadAhead | None:
    """The road that the message describes, in the frame of a vehicle that follows the middle of the right lane.

    Messages have no cross slope: it is taken as 0. None if the message describes less than a metre of road, or more
    remains of the first segment than it has, beyond its rounding: then the position is in another one.

    Args:
        message: The street message.
        travelled_m: How far the vehicle has driven along the road since.
    """
    if message.remaining_length_m > message.segments[0].length_m + LENGTH_STEP_M:
        return None
    points = points_from_message(message, LANE_WIDTH_M / 2, travelled_m)
    if len(points) < 2:
        return None
    return RoadAhead(points, half_width_m=LANE_WIDTH_M, error_bound_m=message.error_bound_m)


def points_from_message(message: StreetMessage, left_m: float = 0.0, travelled_m: float = 0.0) -> Floats:
    """The road that the message describes: a point each metre from the assumed position on, shape (N, 3).

    Points are in the frame of a vehicle that heads along the road, so that the first point is (0, left_m, 0).

    Args:
        message: The street message.
        left_m: Offset of the line to the vehicle's left; the road's centre line is half a lane to the left.
        travelled_m: How far the vehicle is beyond the position of the message.
    """
    ends_m = np.cumsum([segment.length_m for segment in message.segments])
    begin_m = max(message.segments[0].length_m - message.remaining_length_m, 0.0) + travelled_m
    arc_lengths_m = np.arange(begin_m, ends_m[-1] + 1e-9)
    middles_m = (arc_lengths_m[1:] + arc_lengths_m[:-1]) / 2
    knots_m = np.stack([ends_m - [segment.length_m for segment in message.segments], ends_m], -1).ravel()
    curvatures = np.array([segment.curvatures_per_m for segment in message.segments]).ravel()
    slopes = np.array([segment.slope for segment in message.segments])
    first = min(int(np.searchsorted(ends_m, begin_m)), len(slopes) - 1)
    # One step is one metre. Since the curvature may jump between segments, it is taken in the middle of each step.
    turns_rad = np.interp(middles_m, knots_m, curvatures)
    headings_rad = np.cumsum(turns_rad) - turns_rad / 2
    rises_m = slopes[np.minimum(np.searchsorted(ends_m, middles_m), len(slopes) - 1)]
    steps_m = np.stack([np.cos(headings_rad), np.sin(headings_rad), rises_m], -1)
    level = np.concatenate([np.zeros((1, 3)), np.cumsum(steps_m, axis=0)])
    nose_up = rotation(pitch_rad=float(np.arctan(slopes[first])))
    return np.asarray(level @ nose_up + [0.0, left_m, 0.0])


def curvature_code(curvature_per_m: float) -> int:
    """Code of the radius with the nearest ratio, 0..254, or 255 for straight: a radius beyond 10 km.

    >>> curvature_code(0.0), curvature_code(-1 / 10), curvature_code(1 / 10_000)
    (255, 0, 254)
    """
    radius_m = 1.0 / max(abs(curvature_per_m), 1e-12)
    code = round(float(np.log(radius_m / MIN_RADIUS_M) / np.log(_RADIUS_RATIO)))
    return min(max(code, 0), STRAIGHT_CODE)


def curvature_from_code(code: int, is_left: bool) -> float:
    """Curvature in 1/m, positive to the left, that `code` stands for; within 1.4 % of the encoded one."""
    if code == STRAIGHT_CODE:
        return 0.0
    magnitude = float(_RADIUS_RATIO**-code / MIN_RADIUS_M)
    return magnitude if is_left else -magnitude


def slope_code(slope: float) -> int:
    """Nearest slope in steps of 0.5 %, at most 63.5 %."""
    return min(max(round(slope / SLOPE_STEP), -MAX_SLOPE_CODE), MAX_SLOPE_CODE)
