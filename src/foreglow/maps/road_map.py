"""The roads of a map together: which of them is ours, and how it goes on where its line ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from foreglow.geometry import Floats, Pose
from foreglow.maps.centre_line import MAX_OFFSET_M, CentreLine
from foreglow.maps.geographic import GeographicOrigin
from foreglow.types import RoadAhead

JOIN_M = 2.5
"""Ends of two lines that are this near are one place: through a junction a map may have single lanes, whose middle is
half a lane beside the road's.
"""

MIN_GOING_ON = 0.5
"""A road goes on in another one only if it turns by less than 60 degrees there; the cosine of it."""


class RoadMap:
    """Roads in one frame: x east, y north, z up, metres.

    Attributes:
        lines: The roads.
        origin: Where on earth the frame's zero is; None for a map in metres of its own.
        has_heights: Whether its z means anything; otherwise it is 0.
    """

    def __init__(
        self, lines: Sequence[CentreLine], origin: GeographicOrigin | None = None, *, has_heights: bool = True
    ) -> None:
        """Takes the roads.

        Raises:
            ValueError: If there is none.
        """
        if not lines:
            raise ValueError("RoadMap.lines: expected at least one road, got none")
        self.lines = tuple(lines)
        self.origin = origin
        self.has_heights = has_heights
        level = [line.points_m[:, :2] for line in lines]
        self._lows, self._highs = np.array([one.min(0) for one in level]), np.array([one.max(0) for one in level])
        # Two rows a line: run as its points are, and run the other way.
        begins = np.array([[one[0], one[-1]] for one in level]).reshape(-1, 2)
        steps = np.array([[one[1] - one[0], one[-2] - one[-1]] for one in level]).reshape(-1, 2)
        self._begins, self._directions = begins, steps / np.linalg.norm(steps, axis=1, keepdims=True)

    def ahead(
        self, pose: Pose, length_m: float = 400.0, error_bound_m: float = math.inf, *, is_on_road: bool = False
    ) -> RoadAhead | None:
        """The road ahead on the nearest road with our heading; where its line ends, it goes on in the straightest.

        Width as of the nearest road. None as in `CentreLine.ahead`, whose arguments these are.
        """
        is_level = is_on_road or not self.has_heights
        near = np.flatnonzero(self._distances_to_boxes_m(pose.position_m[:2]) <= MAX_OFFSET_M)
        feet = [(foot, int(k)) for k in near if (foot := self.lines[k].foot(pose, knows_height=not is_level))]
        if not feet:
            return None
        foot, number = min(feet, key=lambda one: one[0].distance_m)
        line = self.lines[number]
        left_m = foot.way_m if foot.is_against else line.length_m - foot.way_m
        joined = self._joined(number, foot.is_against, length_m - left_m)
        return joined.ahead(pose, length_m, error_bound_m, is_on_road=is_level)

    def distance_m(self, position_m: Floats) -> float:
        """Horizontal distance of a place, shape (2,) or (3,), from the nearest point of a line; rough, for messages."""
        return min(float(np.hypot(*(line.points_m[:, :2] - position_m[:2]).T).min()) for line in self.lines)

    def _distances_to_boxes_m(self, place: Floats) -> Floats:
        """Distance of a place from the box around each line, shape (L,)."""
        away = np.maximum(np.maximum(self._lows - place, place - self._highs), 0.0)
        return np.asarray(np.linalg.norm(away, axis=1))

    def _joined(self, number: int, is_against: bool, missing_m: float) -> CentreLine:
        """The line `number` as it is driven, and those that it goes on in for at least `missing_m` more."""
        line = self._driven(2 * number + is_against)
        points, slopes, seen = [line.points_m], [line.cross_slopes], {number}
        while missing_m > 0 and (row := self._next(line, seen)) is not None:
            step = line.points_m[-1] - line.points_m[-2]
            line = self._driven(row)
            # Ends that overlap would lead back a little.
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
        """Row of the straightest line that begins where `line` ends; None where the map ends."""
        before, end = line.points_m[-2:, :2]
        step = end - before
        turns = self._directions @ (step / np.linalg.norm(step))
        is_next = (np.linalg.norm(self._begins - end, axis=1) <= JOIN_M) & (turns >= MIN_GOING_ON)
        is_next[[row for number in seen for row in (2 * number, 2 * number + 1)]] = False
        return int(np.argmax(np.where(is_next, turns, -np.inf))) if is_next.any() else None
