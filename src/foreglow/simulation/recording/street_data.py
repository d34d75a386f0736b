"""The road ahead of us: as it is, and as predictive street data (PSD) in the car would tell it.

A street message is made like those on real cars: the map is cut into segments with a length in steps of 2 m, a
curvature at the start and at the end (8 bits and a sign) and one slope in steps of 0.5 %; the position on it comes
with a class of longitudinal error. The scale of the curvature's code is not published, and decoders disagree; here it
is geometric: codes 0..254 are the radii from 10 m to 10 km in equal ratios of 2.8 %, and 255 is straight.

Beside the quantisation, the message errs by a longitudinal offset that wanders slowly within its class: the car
believes that it is further along the road, or less far, than it is. That is what PSD methods fail by.
"""

from __future__ import annotations

import itertools
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from foreglow.config import FrozenModel
from foreglow.geometry import Floats, Pose, rotation
from foreglow.simulation.world.road import Road

LENGTH_STEP_M = 2.0
MAX_LENGTH_CODE = 127
SLOPE_STEP = 0.005
MAX_SLOPE_CODE = 127
STRAIGHT_CODE = 255
MIN_RADIUS_M = 10.0
MAX_RADIUS_M = 10_000.0
NUM_SEGMENT_IDS = 62
"""Six bits, without 0 (no segment) and 63 (not known); ids come round again along the road."""

ERROR_BOUNDS_M = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Largest longitudinal error of each class. The last class, above 50 m, has no bound on real cars; here it has one."""

_RADIUS_RATIO = (MAX_RADIUS_M / MIN_RADIUS_M) ** (1 / (STRAIGHT_CODE - 1))
# Within a segment the map's curvature may leave its chord, and the slope its mean, by this much: half a step of slope,
# and a curvature that bends the road by 0.25 m in 50 m.
_CURVATURE_TOLERANCE_PER_M = 2e-4
_SLOPE_TOLERANCE = 0.005
_MAP_MARGIN_M = 1000.0

ErrorClass: TypeAlias = Annotated[int, Field(ge=0, lt=len(ERROR_BOUNDS_M))]
"""Longitudinal error: 0 below 2 m, 1 below 5, 2 below 10, 3 below 20, 4 below 50, 5 above 50 m."""

_SegmentId: TypeAlias = Annotated[int, Field(ge=0, le=63)]
_CurvatureCode: TypeAlias = Annotated[int, Field(ge=0, le=STRAIGHT_CODE)]


class StreetDataError(FrozenModel):
    """How wrong the street messages of a drive are.

    Attributes:
        longitudinal_class: Class of the longitudinal error; None draws one for the drive, by `class_shares`.
        class_shares: How often each class is drawn; need not sum to 1.
        wander_m: Way along the road in which the error goes once from one side to the other and back.
        horizon_m: How far ahead the message reaches, at least.
    """

    longitudinal_class: ErrorClass | None = None
    class_shares: Annotated[tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=6, max_length=6)] = (
        *(0.25, 0.25, 0.2, 0.15, 0.1),
        0.05,
    )
    wander_m: Annotated[float, Field(ge=10)] = 400.0
    horizon_m: Annotated[float, Field(gt=0, le=2000)] = 400.0

    @model_validator(mode="after")
    def _check(self) -> StreetDataError:
        if not any(self.class_shares):
            raise ValueError("class_shares: expected at least one above 0, got none")
        return self


class StreetSegment(FrozenModel):
    """A piece of the road, as codes.

    Attributes:
        segment_id: Its number, 1..62.
        parent_id: Number of the segment before it; 0 for the map's first.
        length_code: Length in steps of 2 m.
        start_curvature_code: Curvature where it begins; see `curvature_code`.
        is_start_left: Whether it bends to the left there.
        end_curvature_code: Curvature where it ends; linear in between.
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
        """Its length."""
        return self.length_code * LENGTH_STEP_M

    @property
    def curvatures_per_m(self) -> tuple[float, float]:
        """Signed curvature where it begins and where it ends, positive to the left."""
        return (
            curvature_from_code(self.start_curvature_code, self.is_start_left),
            curvature_from_code(self.end_curvature_code, self.is_end_left),
        )

    @property
    def slope(self) -> float:
        """Rise per metre, no unit."""
        return self.slope_code * SLOPE_STEP


class StreetMessage(FrozenModel):
    """What the car is told about the road ahead.

    Attributes:
        segments: The most probable path; the car is believed to be in the first.
        remaining_length_m: Whole metres from the believed position to the end of the first segment.
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
        """Largest longitudinal error of its class."""
        return ERROR_BOUNDS_M[self.error_class]


class StreetMap:
    """The car's map of a road, with its own idea of where on it we are.

    The same road, error and generator give the same messages, in any order.
    """

    def __init__(self, road: Road, error: StreetDataError, rng: np.random.Generator) -> None:
        """Cuts the road into segments and draws how the position will err.

        Args:
            road: The road as it is.
            error: How wrong the position is.
            rng: Used here only, such as `np.random.default_rng([scene.seed, STREAM])`.
        """
        self._error = error
        self._starts_m, self._segments = _segments(road)
        shares = np.array(error.class_shares)
        drawn = int(rng.choice(len(shares), p=shares / shares.sum()))
        self.error_class = drawn if error.longitudinal_class is None else error.longitudinal_class
        lower_m, upper_m = (0.0, *ERROR_BOUNDS_M)[self.error_class], ERROR_BOUNDS_M[self.error_class]
        self._amplitude_m = float(rng.uniform(0.5 * (lower_m + upper_m), 0.99 * upper_m))
        self._phases_rad = rng.uniform(0.0, 2 * np.pi, 2)

    def offset_m(self, ego_s_m: ArrayLike) -> Floats:
        """How much further along the road the car believes to be than it is, at true arc lengths of any shape."""
        turns = 2 * np.pi * np.asarray(ego_s_m, np.float64) / self._error.wander_m
        slow, fast = np.sin(turns + self._phases_rad[0]), np.sin(2.7 * turns + self._phases_rad[1])
        return np.asarray(self._amplitude_m * (0.75 * slow + 0.25 * fast))

    def message(self, ego_s_m: float) -> StreetMessage:
        """The message at the true arc length `ego_s_m` of our rear axle.

        Raises:
            ValueError: If that is off the map, which reaches 1 km beyond either end of the road.
        """
        believed_m = float(ego_s_m + self.offset_m(ego_s_m))
        if not self._starts_m[0] <= believed_m < self._starts_m[-1]:
            raise ValueError(
                f"ego_s_m: expected a place on the map, {self._starts_m[0]:g} to {self._starts_m[-1]:g} m, "
                f"got {ego_s_m:g}"
            )
        first = int(np.searchsorted(self._starts_m, believed_m, side="right")) - 1
        last = int(np.searchsorted(self._starts_m[1:], believed_m + self._error.horizon_m)) + 1
        return StreetMessage(
            segments=self._segments[first : min(last, first + NUM_SEGMENT_IDS)],
            remaining_length_m=round(float(self._starts_m[first + 1]) - believed_m),
            error_class=self.error_class,
        )


def road_ahead(road: Road, ego_s_m: float, ego_pose: Pose, length_m: float = 400.0, left_m: float = 0.0) -> Floats:
    """The road as it is: a point each metre from beside our rear axle on, shape (N, 3), in our vehicle's frame.

    Args:
        road: The road that we drive along.
        ego_s_m: Arc length of our rear axle.
        ego_pose: world_from_vehicle.
        length_m: How far; beyond the road's end it goes on straight.
        left_m: Which line: metres to the left of the centre line.
    """
    places_m = ego_s_m + np.arange(0.0, length_m + 0.5)
    return ego_pose.to_body(road.points(places_m, left_m))


def points_from_message(message: StreetMessage, left_m: float = 0.0) -> Floats:
    """The road as the message tells it: a point each metre from the believed position on, shape (N, 3).

    In the frame of a vehicle that stands on the road and along it, so the first point is (0, left_m, 0).

    Args:
        message: The street message.
        left_m: Where the line runs beside us; the road's centre line is half a lane to our left.
    """
    ends_m = np.cumsum([segment.length_m for segment in message.segments])
    begin_m = max(message.segments[0].length_m - message.remaining_length_m, 0.0)
    places_m = np.arange(begin_m, ends_m[-1] + 1e-9)
    middles_m = (places_m[1:] + places_m[:-1]) / 2
    knots_m = np.stack([ends_m - [segment.length_m for segment in message.segments], ends_m], -1).ravel()
    curvatures = np.array([segment.curvatures_per_m for segment in message.segments]).ravel()
    slopes = np.array([segment.slope for segment in message.segments])
    # One step is one metre. A curvature may jump between segments, so that it is taken in the middle of each step.
    turns_rad = np.interp(middles_m, knots_m, curvatures)
    headings_rad = np.cumsum(turns_rad) - turns_rad / 2
    rises_m = slopes[np.minimum(np.searchsorted(ends_m, middles_m), len(slopes) - 1)]
    steps_m = np.stack([np.cos(headings_rad), np.sin(headings_rad), rises_m], -1)
    level = np.concatenate([np.zeros((1, 3)), np.cumsum(steps_m, axis=0)])
    nose_up = rotation(pitch_rad=float(np.arctan(slopes[0])))
    return np.asarray(level @ nose_up + [0.0, left_m, 0.0])


def curvature_code(curvature_per_m: float) -> int:
    """Code of the nearest radius in ratio, 0..254, or 255 for straight: a radius beyond 10 km.

    >>> curvature_code(0.0), curvature_code(-1 / 10), curvature_code(1 / 10_000)
    (255, 0, 254)
    """
    radius_m = 1.0 / max(abs(curvature_per_m), 1e-12)
    code = round(float(np.log(radius_m / MIN_RADIUS_M) / np.log(_RADIUS_RATIO)))
    return min(max(code, 0), STRAIGHT_CODE)


def curvature_from_code(code: int, is_left: bool) -> float:
    """Signed curvature in 1/m, positive to the left, that `code` stands for; within 1.4 % of what was coded."""
    if code == STRAIGHT_CODE:
        return 0.0
    magnitude = float(_RADIUS_RATIO**-code / MIN_RADIUS_M)
    return magnitude if is_left else -magnitude


def slope_code(slope: float) -> int:
    """Nearest slope in steps of 0.5 %, at most 63.5 %."""
    return min(max(round(slope / SLOPE_STEP), -MAX_SLOPE_CODE), MAX_SLOPE_CODE)


def _segments(road: Road) -> tuple[Floats, tuple[StreetSegment, ...]]:
    """Where the segments begin and the last one ends, shape (N + 1,), metres, and the N segments in order."""
    nodes_m = np.arange(-_MAP_MARGIN_M, road.length_m + _MAP_MARGIN_M + LENGTH_STEP_M / 2, LENGTH_STEP_M)
    curvatures = road.curvature_per_m(nodes_m)
    curvatures[(nodes_m < 0) | (nodes_m > road.length_m)] = 0.0
    heights_m = road.elevation_m(nodes_m)
    cuts = _cuts(curvatures, np.diff(heights_m) / LENGTH_STEP_M)
    segments = tuple(
        StreetSegment(
            segment_id=number % NUM_SEGMENT_IDS + 1,
            parent_id=(number - 1) % NUM_SEGMENT_IDS + 1 if number else 0,
            length_code=end - start,
            start_curvature_code=curvature_code(curvatures[start]),
            is_start_left=bool(curvatures[start] > 0),
            end_curvature_code=curvature_code(curvatures[end]),
            is_end_left=bool(curvatures[end] > 0),
            slope_code=slope_code((heights_m[end] - heights_m[start]) / ((end - start) * LENGTH_STEP_M)),
        )
        for number, (start, end) in enumerate(itertools.pairwise(cuts))
    )
    return nodes_m[cuts], segments


def _cuts(curvatures: Floats, slopes: Floats) -> list[int]:
    """Nodes at which segments meet: each is as long as a line through its curvatures and one slope allow.

    Args:
        curvatures: At the nodes, shape (N,).
        slopes: Between them, shape (N - 1,).
    """
    cuts = [0]
    for end in range(2, len(curvatures)):
        start = cuts[-1]
        inside = curvatures[start : end + 1]
        chord = np.linspace(inside[0], inside[-1], len(inside))
        rises = slopes[start:end]
        if (
            end - start > MAX_LENGTH_CODE
            or np.abs(inside - chord).max() > _CURVATURE_TOLERANCE_PER_M
            or np.abs(rises - rises.mean()).max() > _SLOPE_TOLERANCE
        ):
            cuts.append(end - 1)
    return [*cuts, len(curvatures) - 1]
