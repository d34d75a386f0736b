"""A frame and its result as messages for Foxglove's panels: calibration, boxes in the image, and the 3D scene."""

from __future__ import annotations

import math

import numpy as np
from foxglove.messages import (
    CameraCalibration,
    Color,
    CubePrimitive,
    FrameTransform,
    ImageAnnotations,
    LinePrimitive,
    LinePrimitiveLineType,
    Point2,
    Point3,
    PointsAnnotation,
    PointsAnnotationType,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextAnnotation,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from scipy.spatial.transform import Rotation

from foreglow.geometry import Camera, Floats
from foreglow.runtime.mcap.channels import CAMERA_FRAME, VEHICLE_FRAME
from foreglow.types import BeamCommand, Detections, Frame, FrameResult, RoadAhead, Tracks, TrackState
from foreglow.types.kinds import KIND_WORDS, told_kinds

HALF_PIXEL_PX = 0.5
"""In Foxglove the centre of the upper left pixel is (0, 0); here it is (0.5, 0.5)."""

GAP_RANGE_M = 100.0
"""A gap of unknown range is drawn with this length."""

ROAD_COLOUR = Color(r=0.5, g=0.5, b=0.5, a=1.0)
GAP_COLOUR = Color(r=0.2, g=0.5, b=1.0, a=1.0)
PROPOSAL_COLOUR = Color(r=0.6, g=0.6, b=0.6, a=0.7)
TRACK_COLOURS = {
    TrackState.TENTATIVE: Color(r=0.7, g=0.7, b=0.7, a=1.0),
    TrackState.CONFIRMED: Color(r=0.2, g=1.0, b=0.3, a=1.0),
    TrackState.COASTING: Color(r=1.0, g=0.7, b=0.1, a=1.0),
}

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""camera_from_optical: the axes of Foxglove's camera (right, down, forward) in ours (forward, left, up)."""


def calibration_message(camera: Camera, stamp: Timestamp) -> CameraCalibration:
    """The intrinsics."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    cx, cy = cx - HALF_PIXEL_PX, cy - HALF_PIXEL_PX
    return CameraCalibration(
        timestamp=stamp,
        frame_id=CAMERA_FRAME,
        width=camera.width_px,
        height=camera.height_px,
        distortion_model="plumb_bob",
        D=list(camera.distortion),
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def transform_message(camera: Camera, stamp: Timestamp) -> FrameTransform:
    """The camera's pose in the vehicle."""
    pose = camera.vehicle_from_camera
    x, y, z = pose.position_m.tolist()
    qx, qy, qz, qw = Rotation.from_matrix(pose.rotation @ _OPTICAL).as_quat().tolist()
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=VEHICLE_FRAME,
        child_frame_id=CAMERA_FRAME,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def boxes_message(result: FrameResult, stamp: Timestamp) -> ImageAnnotations:
    """Proposals in thin grey, detections coloured by score, tracks with id, confidence, kind and range."""
    points = [_box_lines(result.proposals.boxes_xyxy_px, PROPOSAL_COLOUR, 1.0, stamp)]
    texts: list[TextAnnotation] = []
    if result.detections is not None:
        points += _detection_boxes(result.detections, stamp)
    if result.tracks is not None:
        for index, state in enumerate(result.tracks.states.tolist()):
            box, colour = result.tracks.boxes_xyxy_px[index], TRACK_COLOURS[TrackState(state)]
            points.append(_box_lines(box[None], colour, 2.0, stamp))
            texts.append(
                TextAnnotation(
                    timestamp=stamp,
                    position=Point2(x=float(box[0]), y=float(box[1]) - 2.0),
                    text=_track_label(result.tracks, index),
                    font_size=14.0,
                    text_color=colour,
                    background_color=Color(r=0.0, g=0.0, b=0.0, a=0.5),
                )
            )
    return ImageAnnotations(timestamp=stamp, points=points, texts=texts)


def scene_message(frame: Frame, result: FrameResult, stamp: Timestamp) -> SceneUpdate:
    """The road, the tracks that have a range, and the dark gaps, in the vehicle's frame."""
    tracks = SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id="tracks")
    if result.tracks is not None and frame.camera is not None:
        tracks = _track_entity(frame.camera, result.tracks, stamp)
    lines = _road_lines(frame.road)
    road = SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id="road", lines=lines)
    gaps = SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id="gaps", lines=_gap_lines(result.beam))
    return SceneUpdate(entities=[tracks, road, gaps])


def _detection_boxes(detections: Detections, stamp: Timestamp) -> list[PointsAnnotation]:
    """The accepted boxes, from orange to yellow."""
    is_accepted = detections.is_accepted
    boxes, scores = detections.accepted_boxes_xyxy_px, detections.scores[is_accepted].tolist()
    return [
        _box_lines(box[None], Color(r=1.0, g=0.3 + 0.7 * score, b=0.0, a=1.0), 1.5, stamp)
        for box, score in zip(boxes, scores, strict=True)
    ]


def _box_lines(boxes: np.ndarray, colour: Color, thickness: float, stamp: Timestamp) -> PointsAnnotation:
    """The edges of boxes of shape (N, 4), `xyxy`."""
    corners = boxes[:, [0, 1, 2, 1, 2, 1, 2, 3, 2, 3, 0, 3, 0, 3, 0, 1]].reshape(-1, 2).tolist()
    return PointsAnnotation(
        timestamp=stamp,
        type=PointsAnnotationType.LineList,
        points=[Point2(x=float(x), y=float(y)) for x, y in corners],
        outline_color=colour,
        thickness=thickness,
    )


def _track_label(tracks: Tracks, index: int) -> str:
    range_m, sigma_m = float(tracks.ranges_m[index]), float(tracks.sigmas_m[index])
    label, kind = f"{tracks.ids[index]}: {tracks.confidences[index]:.2f}", told_kinds(tracks.light_kinds)[index]
    if kind is not None:
        label = f"{label}, {KIND_WORDS[kind]}"
    if math.isnan(range_m):
        return label
    return f"{label}, {range_m:.0f} m" + (f" ± {sigma_m:.0f}" if math.isfinite(sigma_m) else "")


def _track_entity(camera: Camera, tracks: Tracks, stamp: Timestamp) -> SceneEntity:
    """For each track a cube at its range, a line of plus and minus one sigma along the viewing ray, and a label."""
    cubes, lines, texts = [], [], []
    boxes = tracks.boxes_xyxy_px
    rays = camera.rays(0.5 * (boxes[:, :2] + boxes[:, 2:]))
    for index in np.flatnonzero(np.isfinite(tracks.ranges_m)).tolist():
        range_m, sigma_m = float(tracks.ranges_m[index]), float(tracks.sigmas_m[index])
        reach = np.array([range_m, max(0.0, range_m - sigma_m), range_m + sigma_m])
        points = camera.vehicle_from_camera.to_outer(reach[:, None] * rays[index])
        colour = TRACK_COLOURS[TrackState(int(tracks.states[index]))]
        x, y, z = points[0].tolist()
        at = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
        cubes.append(CubePrimitive(pose=at, size=Vector3(x=1.0, y=1.0, z=1.0), color=colour))
        if math.isfinite(sigma_m):
            lines.append(_line(points[1:], colour))
        texts.append(
            TextPrimitive(
                pose=at,
                billboard=True,
                font_size=14.0,
                scale_invariant=True,
                color=colour,
                text=_track_label(tracks, index),
            )
        )
    return SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id="tracks", cubes=cubes, lines=lines, texts=texts)


def _road_lines(road: RoadAhead | None) -> list[LinePrimitive]:
    if road is None:
        return []
    points = road.points_m
    along = np.gradient(points[:, :2], axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    left = np.stack([-along[:, 1], along[:, 0], road.cross_slopes], -1) * road.half_width_m
    return [_line(line, ROAD_COLOUR) for line in (points - left, points, points + left)]


def _gap_lines(beam: BeamCommand | None) -> list[LinePrimitive]:
    """Each gap as a triangle from the vehicle's origin to the gap's range."""
    if beam is None:
        return []
    lines = []
    for borders_rad, range_m in zip(beam.gaps_rad, beam.gap_ranges_m.tolist(), strict=True):
        reach_m = GAP_RANGE_M if math.isnan(range_m) else range_m
        ends = reach_m * np.stack([np.cos(borders_rad), np.sin(borders_rad), np.zeros(2)], -1)
        lines.append(_line(np.stack([np.zeros(3), ends[0], ends[1], np.zeros(3)]), GAP_COLOUR))
    return lines


def _line(points: Floats, colour: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        thickness=2.0,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points.tolist()],
        color=colour,
    )
