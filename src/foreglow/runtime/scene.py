"""What a 3D view shows of a frame, as points in the vehicle's frame: for every program that draws them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from foreglow.geometry import Camera, Floats
from foreglow.types import BeamCommand, RoadAhead, Tracks, TrackState
from foreglow.types.kinds import KIND_WORDS, told_kinds

GAP_RANGE_M = 100.0
"""A gap of unknown range is drawn with this length."""

TRACK_RGB = {
    TrackState.TENTATIVE: (0.7, 0.7, 0.7),
    TrackState.CONFIRMED: (0.2, 1.0, 0.3),
    TrackState.COASTING: (1.0, 0.7, 0.1),
}
ROAD_RGB = (0.5, 0.5, 0.5)
GAP_RGB = (0.2, 0.5, 1.0)


class TrackInView(NamedTuple):
    """A track that has a range.

    Attributes:
        row: Its index in the tracks.
        position_m: Shape (3,).
        reach_m: Shape (2, 3), one standard deviation nearer and farther; None where it is infinite.
    """

    row: int
    position_m: Floats
    reach_m: Floats | None


def tracks_in_view(camera: Camera, tracks: Tracks) -> Iterator[TrackInView]:
    """The tracks that have a range, along the viewing rays of their boxes' middles."""
    boxes = tracks.boxes_xyxy_px
    rays = camera.rays(0.5 * (boxes[:, :2] + boxes[:, 2:]))
    for row in np.flatnonzero(np.isfinite(tracks.ranges_m)).tolist():
        range_m, sigma_m = float(tracks.ranges_m[row]), float(tracks.sigmas_m[row])
        reach_m = [max(0.0, range_m - sigma_m), range_m + sigma_m] if math.isfinite(sigma_m) else []
        points = camera.vehicle_from_camera.to_outer(np.array([[range_m], *([each] for each in reach_m)]) * rays[row])
        yield TrackInView(row, points[0], points[1:] if reach_m else None)


def track_label(tracks: Tracks, index: int) -> str:
    """Number, confidence, kind of light and range."""
    range_m, sigma_m = float(tracks.ranges_m[index]), float(tracks.sigmas_m[index])
    label, kind = f"{tracks.ids[index]}: {tracks.confidences[index]:.2f}", told_kinds(tracks.light_kinds)[index]
    if kind is not None:
        label = f"{label}, {KIND_WORDS[kind]}"
    if math.isnan(range_m):
        return label
    return f"{label}, {range_m:.0f} m" + (f" ± {sigma_m:.0f}" if math.isfinite(sigma_m) else "")


def road_lines(road: RoadAhead | None) -> list[Floats]:
    """Right border, middle and left border of the road, each of shape (N, 3); none without a road."""
    if road is None:
        return []
    points = road.points_m
    along = np.gradient(points[:, :2], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    left = np.stack([-along[:, 1], along[:, 0], road.cross_slopes], -1) * road.half_width_m
    return [points - left, points, points + left]


def gap_lines(beam: BeamCommand | None) -> list[Floats]:
    """Each gap as a triangle from the vehicle's origin to the gap's range, shape (4, 3)."""
    if beam is None:
        return []
    lines = []
    for borders_rad, range_m in zip(beam.gaps_rad, beam.gap_ranges_m.tolist(), strict=True):
        reach_m = GAP_RANGE_M if math.isnan(range_m) else range_m
        ends = reach_m * np.stack([np.cos(borders_rad), np.sin(borders_rad), np.zeros(2)], -1)
        lines.append(np.stack([np.zeros(3), ends[0], ends[1], np.zeros(3)]))
    return lines
