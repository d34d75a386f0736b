"""The roads of a map: the choice of the road that we drive on, and its continuation where its line ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from foreglow.geometry import Floats, Pose
from foreglow.maps.centre_line import MAX_OFFSET_M, CentreLine, Foot, checked_ahead
from foreglow.maps.geographic import GeographicOrigin
from foreglow.types import RoadAhead
from foreglow.types.arrays import check_kind, check_optional

JOIN_M = 2.5
"""Ends of two lines that are this near are joined: through a junction a map may have single lanes, whose middle is half
a lane beside the road's.
"""

MIN_GOING_ON = 0.5
"""Cosine of the largest turn between a road and its continuation, 60 degrees."""


class RoadMap:
    """Roads in a common frame: x east, y north, z up, metres.

    Attributes:
        lines: The roads.
        origin: Position of the frame's origin on earth; None for a map in metres of its own.
        has_heights: Whether z is known; otherwise it is 0.
    """

    def __init__(
        self, lines: Sequence[CentreLine], origin: GeographicOrigin | None = None, *, has_heights: bool = True
    ) -> None:
        """Takes the roads.

        Raises:
            ValueError: If there is none, or something else.
        """
        check_kind("RoadMap.lines", lines, Sequence)
        if not lines:
            raise ValueError("RoadMap.lines: expected at least one road, got none")
        for line in lines:
            check_kind("RoadMap.lines", line, CentreLine)
        check_optional("RoadMap.origin", origin, GeographicOrigin)
        self.lines = tuple(lines)
        self.origin = origin
        self.has_heights = has_heights
        level = [line.points_m[:, :2] for line in lines]
        self._lows = np.array([points.min(0) for points in level])
        self._highs = np.array([points.max(0) for points in level])
        # Two rows for each line: in the direction of its points, and in the other direction.
        begins = np.array([[points[0], points[-1]] for points in level]).reshape(-1, 2)
        steps = np.array([[points[1] - points[0], points[-2] - points[-1]] for points in level]).reshape(-1, 2)
        self._begins, self._directions = begins, steps / np.linalg.norm(steps, axis=1, keepdims=True)

    def ahead(
        self, pose: Pose, length_m: float = 400.0, error_bound_m: float = math.inf, *, is_on_road: bool = False
    ) -> RoadAhead | None:
        """The road ahead on the nearest road with our heading, continued on the straightest line where that ends.

        The width is that of the nearest road. Arguments, None and errors are as in `CentreLine.ahead`.
        """
        check_kind("pose", pose, Pose)
        length_m, error_bound_m = checked_ahead(length_m, error_bound_m)
        is_level = is_on_road or not self.has_heights
        feet = self._feet(pose, knows_height=not is_level)
        if not feet:
            return None
        foot, number = min(feet, key=lambda candidate: candidate[0].distance_m)
        line = self.lines[number]
        left_m = foot.way_m if foot.is_against else line.length_m - foot.way_m
        joined = self._joined(number, foot.is_against, length_m - left_m)
        return joined.ahead(pose, length_m, error_bound_m, is_on_road=is_level)

    def hindrance(self, pose: Pose, *, is_on_road: bool = False) -> Literal["heading", "height"] | None:
        """What keeps a vehicle off the roads that are near; None if none is near, or it drives on one.

        Raises:
            ValueError: If the pose is none.
        """
        check_kind("pose", pose, Pose)
        knows_height = self.has_heights and not is_on_road
        if self._feet(pose, knows_height=knows_height):
            return None
        if self._feet(pose, knows_height=knows_height, knows_heading=False):
            return "heading"
        return "height" if self._feet(pose, knows_height=False) else None

    def _feet(self, pose: Pose, *, knows_height: bool, knows_heading: bool = True) -> list[tuple[Foot, int]]:
        """The nearest points of the roads that a vehicle drives on, with the roads' numbers; as `CentreLine.foot`."""
        near = np.flatnonzero(self._distances_to_boxes_m(pose.position_m[:2]) <= MAX_OFFSET_M)
        feet = (
            (self.lines[k].foot(pose, knows_height=knows_height, knows_heading=knows_heading), int(k)) for k in near
        )
        return [(foot, number) for foot, number in feet if foot is not None]

    def distance_m(self, position_m: Floats) -> float:
        """Rough horizontal distance of a position, shape (2,) or (3,), from the nearest line; for messages."""
        return min(float(np.hypot(*(line.points_m[:, :2] - position_m[:2]).T).min()) for line in self.lines)

    def _distances_to_boxes_m(self, position_m: Floats) -> Floats:
        """Distance of a position from the box around each line, shape (L,)."""
        away = np.maximum(np.maximum(self._lows - position_m, position_m - self._highs), 0.0)
        return np.asarray(np.linalg.norm(away, axis=1))

    def _joined(self, number: int, is_against: bool, missing_m: float) -> CentreLine:
        """The line `number` as it is driven, with its continuation for at least `missing_m`."""
        line = self._driven(2 * number + is_against)
        points, slopes, seen = [line.points_m], [line.cross_slopes], {number}
        while missing_m > 0 and (row := self._next(line, seen)) is not None:
            step = line.points_m[-1] - line.points_m[-2]
            line = self._driven(row)
            # Where the ends overlap, the line would lead back a little.
            begin = int(np.argmax((line.points_m - points[-1][-1])[:, :2] @ step[:2] > 1e-3 * np.hypot(*step[:2])))
            points.append(line.points_m[begin:])
            slopes.append(line.cross_slopes[begin:])
            seen.add(row // 2)
            missing_m -= line.length_m
        return CentreLine(np.concatenate(points), self.lines[number].half_width_m, np.concatenate(slopes))

    def _driven(self, row: int) -> CentreLine:
        line = self.lines[row // 2]
        return line.reversed() if row % 2 else line

    def _next(self, line: CentreLine, seen: set[int]) -> int | None:
        """Row of the straightest line that begins at the end of `line`; None if the map ends there."""
        before, end = line.points_m[-2:, :2]
        step = end - before
        turns = self._directions @ (step / np.linalg.norm(step))
        is_next = (np.linalg.norm(self._begins - end, axis=1) <= JOIN_M) & (turns >= MIN_GOING_ON)
        is_next[[row for number in seen for row in (2 * number, 2 * number + 1)]] = False
        return int(np.argmax(np.where(is_next, turns, -np.inf))) if is_next.any() else None
