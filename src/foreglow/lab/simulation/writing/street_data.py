"""The true road ahead of us, and the street messages (`foreglow.street`) that a car on it would receive.

Beside the quantisation, a message has a longitudinal error that varies slowly within its class: the assumed position of
the car is too far along the road, or not far enough. This error is what makes PSD methods fail.
"""

from __future__ import annotations

import itertools
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from foreglow.config import FrozenModel
from foreglow.geometry import Floats, Pose
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road, interpolated
from foreglow.street import (
    ERROR_BOUNDS_M,
    LENGTH_STEP_M,
    MAX_LENGTH_CODE,
    NUM_SEGMENT_IDS,
    ErrorClass,
    StreetMessage,
    StreetSegment,
    curvature_code,
    slope_code,
)

STREET_STREAM = 901
"""Random stream of a scene's map, `np.random.default_rng([scene.seed, STREET_STREAM])`."""

# Within a segment the map's curvature may differ from its chord, and the slope from its mean, by this much: half a step
# of slope, and a curvature that bends the road by 0.25 m in 50 m.
_CURVATURE_TOLERANCE_PER_M = 2e-4
_SLOPE_TOLERANCE = 0.005
_MAP_MARGIN_M = 1000.0


class StreetDataError(FrozenModel):
    """How wrong the street messages of a drive are.

    Attributes:
        longitudinal_class: Class of the longitudinal error; None draws one for the drive, by `class_shares`.
        class_shares: How often each class is drawn; need not sum to 1.
        wander_m: Wavelength of the error along the road.
        horizon_m: The message reaches at least this far ahead.
    """

    longitudinal_class: ErrorClass | None = None
    class_shares: Annotated[tuple[Annotated[float, Field(ge=0, le=1000)], ...], Field(min_length=6, max_length=6)] = (
        *(0.25, 0.25, 0.2, 0.15, 0.1),
        0.05,
    )
    wander_m: Annotated[float, Field(ge=10, le=100_000)] = 400.0
    horizon_m: Annotated[float, Field(gt=0, le=2000)] = 400.0

    @model_validator(mode="after")
    def _check(self) -> StreetDataError:
        if not any(self.class_shares):
            raise ValueError("class_shares: expected at least one above 0, got none")
        return self


class StreetMap:
    """The car's map of a road, with the car's own estimate of our position on it.

    The same road, error and generator give the same messages, in any order.
    """

    def __init__(self, road: Road, error: StreetDataError, rng: np.random.Generator) -> None:
        """Cuts the road into segments and draws the error of the position.

        Args:
            road: The true road.
            error: Parameters of the position's error.
            rng: Used here only, such as `np.random.default_rng([scene.seed, STREET_STREAM])`.
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
        """Assumed minus true arc length of the car, at true arc lengths of any shape."""
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
                f"ego_s_m: expected an arc length on the map, {self._starts_m[0]:g} to {self._starts_m[-1]:g} m, "
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
    """The true road ahead: a point each metre from beside our rear axle on, shape (N, 3), in our vehicle's frame.

    Args:
        road: The road that we drive along.
        ego_s_m: Arc length of our rear axle.
        ego_pose: world_from_vehicle.
        length_m: Length; beyond the road's end the line continues straight.
        left_m: Metres to the left of the centre line.
    """
    return ego_pose.to_body(road.points(ego_s_m + np.arange(0.0, length_m + 0.5), left_m))


def _segments(road: Road) -> tuple[Floats, tuple[StreetSegment, ...]]:
    """Arc lengths at which segments meet, with both ends, shape (N + 1,), metres, and the N segments in order."""
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
    """Nodes at which segments meet: each is as long as linear curvature and constant slope allow.

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


def check_ego_on_map(scene: Scene, origin: str) -> None:
    """Checks that our own drive stays on the map.

    Raises:
        ValueError: If it leaves it; the message begins with `origin`.
    """
    times_s = [scene.time_s(number) for number in range(scene.num_frames)]
    arc_lengths_m, _ = interpolated(scene.ego.timetable, times_s)
    first_m, last_m = -_MAP_MARGIN_M, scene.road.length_m + _MAP_MARGIN_M
    for arc_length_m in (arc_lengths_m.min(), arc_lengths_m.max()):
        if not first_m <= arc_length_m < last_m:
            raise ValueError(
                f"{origin}: ego.timetable: expected arc lengths on the map, {first_m:g} to {last_m:g} m, "
                f"got {arc_length_m:g} m"
            )
