"""What the bird's-eye view shows, as points on the road in the vehicle's frame: x ahead and y to the left, metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.display.beam_view import road_edge
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster
from foreglow.types import RoadAhead, Tracks

FARTHEST_M = 200.0
"""Where directions without a range end, from the vehicle's origin."""

DISTANCES_M = (25.0, 50.0, 100.0, 150.0, 200.0)
"""Of the arcs that show how far away something is."""

ARC_STEP_RAD = math.radians(1.0)
"""Between the corners of an arc, at most."""

ARC_HALF_RAD = math.radians(12.0)
"""How far the arcs of distance reach to either side: so far that they are whole where the viewer opens."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackBars:
    """Where M tracks are, seen from above.

    Attributes:
        places_m: Shape (M, 2), the middle of the box at the track's range; NaN where the range is unknown.
        bars_m: For each track a closed line, shape (5, 2): its standard deviation to either side along the viewing
            ray, and the width of its box across; where the range is unknown, the two borders of where it is from the
            camera to `FARTHEST_M`. A range without a standard deviation is a line across, shape (2, 2).
    """

    places_m: Floats
    bars_m: tuple[Floats, ...]


def road_lines_m(road: RoadAhead) -> tuple[Floats, Floats, Floats]:
    """Centre line, left and right edge from above, shape (N, 2) each."""
    return road_edge(road, 0.0), road_edge(road, 1.0), road_edge(road, -1.0)


def arc_m(distance_m: float, from_rad: float, until_rad: float) -> Floats:
    """Points at a distance from the vehicle's origin, shape (N, 2), from one azimuth to another.

    >>> arc_m(10.0, 0.0, 0.01).round(2).tolist()
    [[10.0, 0.0], [10.0, 0.1]]
    """
    num = 2 + int(abs(until_rad - from_rad) / ARC_STEP_RAD)
    azimuths = np.linspace(from_rad, until_rad, num)
    return distance_m * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)


def gap_sector_m(borders_rad: Floats, range_m: float) -> Floats:
    """The corners of a dark gap from above, shape (N, 2): the vehicle's origin, then an arc from right to left.

    Args:
        borders_rad: Shape (2,), right and left azimuth, as in `BeamCommand.gaps_rad`.
        range_m: To what the gap is for; NaN, where unknown, makes it reach `FARTHEST_M`.
    """
    right, left = borders_rad.tolist()
    return np.vstack([np.zeros((1, 2)), arc_m(FARTHEST_M if math.isnan(range_m) else range_m, right, left)])


def fan_triangles(num_corners: int) -> NDArray[np.uint32]:
    """The triangles that fill a sector of so many corners, shape (N, 3), all from the first corner.

    >>> fan_triangles(4).tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    seconds = np.arange(1, num_corners - 1, dtype=np.uint32)
    return np.stack([np.zeros_like(seconds), seconds, seconds + 1], axis=1)


def track_bars(camera: Camera, tracks: Tracks, caster: RayCaster) -> TrackBars:
    """Where the tracks are.

    Raises:
        ValueError: If the camera's distortion cannot be undone.
    """
    boxes, count = tracks.boxes_xyxy_px, len(tracks)
    pixels = np.empty((3, count, 2))
    pixels[0, :, 0], pixels[1, :, 0], pixels[2, :, 0] = boxes[:, 0], 0.5 * (boxes[:, 0] + boxes[:, 2]), boxes[:, 2]
    pixels[..., 1] = 0.5 * (boxes[:, 1] + boxes[:, 3])
    rays = caster.cast(camera, pixels.reshape(-1, 2))
    origin, directions = rays.origin_m[:2], rays.directions[:, :2].reshape(3, count, 2)
    middles_m = origin + tracks.ranges_m[:, np.newaxis] * directions[1]
    bars = tuple(
        _bar(origin, directions[0, index], directions[2, index], range_m, sigma_m)
        for index, (range_m, sigma_m) in enumerate(zip(tracks.ranges_m.tolist(), tracks.sigmas_m.tolist(), strict=True))
    )
    return TrackBars(middles_m, bars)


def _bar(origin: Floats, left: Floats, right: Floats, range_m: float, sigma_m: float) -> Floats:
    """The bar of one track between the rays through its box's left and right border."""
    if math.isnan(range_m):
        return np.stack([origin + FARTHEST_M * left, origin, origin + FARTHEST_M * right])
    if math.isinf(sigma_m):
        return np.stack([origin + range_m * left, origin + range_m * right])
    near_m, far_m = max(0.0, range_m - sigma_m), range_m + sigma_m
    corners = [near_m * left, far_m * left, far_m * right, near_m * right, near_m * left]
    return np.stack([origin + corner for corner in corners])
