"""Tracks as other programs read them: `vision_msgs/Detection2DArray`, and `visualization_msgs/MarkerArray` for RViz.

Each is there if its package is installed. RViz's fixed frame is `base_link`: our vehicle's frame, x forward, y to the
left, z up, on the road under the rear axle.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA

from foreglow.geometry import Floats
from foreglow.runtime.ros2.header import Header, header_message
from foreglow.runtime.scene import (
    GAP_RGB,
    ROAD_RGB,
    TRACK_RGB,
    gap_lines,
    road_lines,
    track_label,
    tracks_in_view,
)
from foreglow.types import BeamCommand, Frame, Tracks, TrackState
from foreglow.types.kinds import LIGHT_KINDS

DETECTIONS_2D = "detections_2d"
MARKERS = "markers"

VEHICLE_FRAME = "base_link"

UNKNOWN_KIND = "vehicle_light"
"""The class of light whose kind is not known."""

LIFETIME_S = 1
"""Markers vanish when no new ones come."""

_PACKAGES = {DETECTIONS_2D: ("vision_msgs", "Detection2DArray"), MARKERS: ("visualization_msgs", "MarkerArray")}


def installed_types() -> dict[str, type[Any]]:
    """The topics whose packages are installed, with the types of their messages."""
    return {
        topic: getattr(importlib.import_module(f"{package}.msg"), name)
        for topic, (package, name) in _PACKAGES.items()
        if importlib.util.find_spec(package) is not None
    }


def standard_messages(
    header: Header, frame: Frame, tracks: Tracks, beam: BeamCommand | None, types: Mapping[str, type[Any]]
) -> dict[str, Any]:
    """The messages of a frame by topic, for those of `types`.

    Args:
        header: The frame's header.
        frame: The frame; markers need its camera.
        tracks: The tracks after it.
        beam: The command after it, for its gaps; None if it is not known.
        types: As from `installed_types`.
    """
    messages: dict[str, Any] = {}
    if DETECTIONS_2D in types:
        messages[DETECTIONS_2D] = detections_2d_message(header, tracks)
    if MARKERS in types:
        messages[MARKERS] = markers_message(header, frame, tracks, beam)
    return messages


def detections_2d_message(header: Header, tracks: Tracks) -> Any:
    """The tracks as `vision_msgs/Detection2DArray`.

    A detection's `id` is the track's number. Its hypotheses are the kinds of light, the likeliest first, each with the
    track's confidence times the kind's probability; a track of unknown kind has the one hypothesis `vehicle_light`.
    Poses stay empty: ranges are in `tracks` and `markers`.
    """
    msg = importlib.import_module("vision_msgs.msg")
    detections = []
    for index, (left, top, right, bottom) in enumerate(tracks.boxes_xyxy_px.tolist()):
        box = msg.BoundingBox2D(size_x=right - left, size_y=bottom - top)
        box.center.position.x, box.center.position.y = (left + right) / 2, (top + bottom) / 2
        results = []
        for name, score in _hypotheses(tracks, index):
            result = msg.ObjectHypothesisWithPose()
            result.hypothesis.class_id, result.hypothesis.score = name, score
            results.append(result)
        number = str(int(tracks.ids[index]))
        detections.append(msg.Detection2D(header=header_message(header), results=results, bbox=box, id=number))
    return msg.Detection2DArray(header=header_message(header), detections=detections)


def _hypotheses(tracks: Tracks, index: int) -> list[tuple[str, float]]:
    confidence, kinds = float(tracks.confidences[index]), tracks.light_kinds[index]
    if not np.isfinite(kinds).all():
        return [(UNKNOWN_KIND, confidence)]
    return [(LIGHT_KINDS[kind], confidence * float(kinds[kind])) for kind in np.argsort(-kinds, kind="stable").tolist()]


def markers_message(header: Header, frame: Frame, tracks: Tracks, beam: BeamCommand | None = None) -> Any:
    """Tracks that have a range, each with its reach of one sigma and a label, the road, and the dark gaps."""
    msg = importlib.import_module("visualization_msgs.msg")
    vehicle = dataclasses.replace(header, sequence=VEHICLE_FRAME)
    markers = [msg.Marker(header=header_message(vehicle), action=msg.Marker.DELETEALL)]

    def add(namespace: str, number: int, kind: int, rgb: tuple[float, float, float], **values: Any) -> Any:
        red, green, blue = rgb
        marker = msg.Marker(
            header=header_message(vehicle),
            ns=namespace,
            id=number,
            type=kind,
            action=msg.Marker.ADD,
            color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
            lifetime=Duration(sec=LIFETIME_S),
            **values,
        )
        marker.pose.orientation.w = 1.0
        markers.append(marker)
        return marker

    def add_lines(namespace: str, lines: Sequence[Floats], rgb: tuple[float, float, float], first: int = 0) -> None:
        for number, points in enumerate(lines, first):
            line = add(namespace, number, msg.Marker.LINE_STRIP, rgb, points=_points(points))
            line.scale.x = 0.1

    camera = frame.camera
    for index, position_m, reach_m in () if camera is None else tracks_in_view(camera, tracks):
        rgb, number = TRACK_RGB[TrackState(int(tracks.states[index]))], int(tracks.ids[index])
        (at,) = _points(position_m[None])
        cube = add("tracks", number, msg.Marker.CUBE, rgb)
        cube.pose.position, (cube.scale.x, cube.scale.y, cube.scale.z) = at, (1.0, 1.0, 1.0)
        label = add("labels", number, msg.Marker.TEXT_VIEW_FACING, rgb, text=track_label(tracks, index))
        label.pose.position, label.scale.z = Point(x=at.x, y=at.y, z=at.z + 1.5), 1.0
        if reach_m is not None:
            add_lines("reaches", [reach_m], rgb, number)
    add_lines("road", road_lines(frame.road), ROAD_RGB)
    add_lines("gaps", gap_lines(beam), GAP_RGB)
    return msg.MarkerArray(markers=markers)


def _points(points: Floats) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
