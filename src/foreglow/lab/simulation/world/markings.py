"""Lines on a road with several lanes in either direction."""

from __future__ import annotations

from dataclasses import dataclass

from foreglow.lab.simulation.scenes.scene import RoadSpec

NARROW_M, WIDE_M = 0.15, 0.30
"""Widths of the lines between lanes and at the edges of motorways; in towns both are narrow."""

MOTORWAY_DASH_M, MOTORWAY_PERIOD_M = 6.0, 18.0
TOWN_DASH_M, TOWN_PERIOD_M = 3.0, 9.0
"""Dashes and their periods between the lanes of motorways and town streets. Source: German guidelines RMS-1, 1993."""

BESIDE_MIDDLE_M = 0.12
"""Distance from the centre line to each of the two lines between the directions, where there is no median."""


@dataclass(frozen=True, slots=True)
class Line:
    """A line on either side of the road.

    Attributes:
        offset_m: From the centre line of the road to the middle of the line.
        width_m: Width of the line.
        dash_m: Length of a dash; equal to the period for a solid line.
        period_m: From the begin of a dash to the begin of the next.
    """

    offset_m: float
    width_m: float
    dash_m: float
    period_m: float


def has_several_lanes(road: RoadSpec) -> bool:
    """Whether the road needs `lane_lines`, and not just the centre and edge lines of a two-lane road."""
    return road.num_lanes > 1 or road.median_m > 0


def lane_lines(road: RoadSpec) -> tuple[Line, ...]:
    """The lines on either half of the road, from the middle outwards.

    >>> road = RoadSpec(num_lanes=2, lane_width_m=3.5, median_m=3, shoulders_m=(0.5, 2))
    >>> [line.offset_m for line in lane_lines(road)]
    [1.75, 5.5, 9.25]
    """
    is_motorway = road.median_m > 0
    edge_m = WIDE_M if is_motorway else NARROW_M
    dash_m, period_m = (MOTORWAY_DASH_M, MOTORWAY_PERIOD_M) if is_motorway else (TOWN_DASH_M, TOWN_PERIOD_M)
    first_m = road.median_m / 2 + road.shoulders_m[0]
    inner_m = first_m - edge_m / 2 - 0.1 if is_motorway else BESIDE_MIDDLE_M
    last_m = first_m + road.num_lanes * road.lane_width_m
    lines = [Line(inner_m, edge_m if is_motorway else NARROW_M, period_m, period_m)]
    lines += [
        Line(first_m + number * road.lane_width_m, NARROW_M, dash_m, period_m) for number in range(1, road.num_lanes)
    ]
    if road.has_edge_marking:
        beside_m = 0.1 if road.shoulders_m[1] >= edge_m + 0.1 else -edge_m - 0.1
        lines.append(Line(last_m + beside_m + edge_m / 2, edge_m, period_m, period_m))
    return tuple(lines)
