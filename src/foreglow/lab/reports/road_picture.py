"""The road ahead by the car's street data: in the image, and in the vehicle's coordinates, as the paper draws it."""

from __future__ import annotations

from typing import Any

import numpy as np

from foreglow.display.calibration_check import seen_px
from foreglow.geometry import Camera, Floats
from foreglow.lab.reports.figures import AMBER, INK, png, show_image
from foreglow.types import Frame, Image, RoadAhead

NEAREST_M = 1.0
"""Points of the road that are less far in front of the camera are not drawn in the image."""

LEAST_HEIGHT_M = 5.0
"""The height above and below us that is drawn at least, so that a flat road looks flat."""

ROAD = "#4fc3f7"


def road_picture(frame: Frame) -> bytes:
    """A PNG: the road ahead in the image of `frame`, and beside it in space.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        ValueError: If the frame has no camera, or no road.
    """
    from matplotlib.figure import Figure

    camera, road = frame.camera, frame.road
    if camera is None or road is None:
        raise ValueError(f"{frame.path}: expected a frame with a calibration and the road ahead, found none")
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    show_road(figure.add_subplot(1, 2, 1), frame.image, camera, road)
    axes = figure.add_subplot(1, 2, 2, projection="3d")
    for edge_m in edges_m(road):
        axes.plot(*edge_m.T, color=ROAD, linewidth=1.2)
    axes.plot(*road.points_m.T, ".", color=AMBER, markersize=2.0, label=f"centre line, {len(road.points_m)} points")
    axes.plot([0], [0], [0], "s", color=INK, label="our car")
    axes.set(xlabel="x ahead, m", ylabel="y left, m", zlabel="z up, m")
    lowest_m, highest_m = road.points_m[:, 2].min(), road.points_m[:, 2].max()
    axes.set_zlim(min(lowest_m, -LEAST_HEIGHT_M), max(highest_m, LEAST_HEIGHT_M))
    axes.set_title("in the vehicle's coordinates", fontsize=10)
    axes.set_box_aspect((3.0, 2.0, 1.0))
    axes.view_init(elev=28.0, azim=-120.0)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    return png(figure)


def show_road(axes: Any, image: Image, camera: Camera, road: RoadAhead) -> None:
    """Shows `image` with the edges of the road."""
    show_image(axes, image, "the road ahead, by the car's street data", norm="asinh")
    for edge_px in road_px(camera, road):
        axes.plot(edge_px[:, 0] - 0.5, edge_px[:, 1] - 0.5, color=ROAD, linewidth=1.2)


def edges_m(road: RoadAhead) -> tuple[Floats, Floats]:
    """Left and right edge of the road, each of shape (N, 3), in the vehicle's coordinates."""
    along = np.gradient(road.points_m, axis=0)
    left = np.stack([-along[:, 1], along[:, 0]], -1) / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    offsets_m = (side * road.half_width_m for side in (1.0, -1.0))
    first, second = (
        road.points_m + np.column_stack([offset_m * left, offset_m * road.cross_slopes]) for offset_m in offsets_m
    )
    return first, second


def road_px(camera: Camera, road: RoadAhead) -> tuple[Floats, Floats]:
    """Left and right edge of the road in the image, each of shape (N, 2), full-frame pixels; NaN where out of sight."""
    edges = []
    for edge_m in edges_m(road):
        points = camera.vehicle_from_camera.to_body(edge_m)
        pixels = np.full((len(points), 2), np.nan)
        is_ahead = points[:, 0] >= NEAREST_M
        pixels[is_ahead] = seen_px(camera, points[is_ahead])
        pixels[np.asarray(((pixels < 0) | (pixels >= [camera.width_px, camera.height_px])).any(axis=1))] = np.nan
        edges.append(pixels)
    return edges[0], edges[1]
