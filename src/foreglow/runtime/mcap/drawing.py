"""A frame and its result as messages for Foxglove's panels: calibration, boxes in the image, and the 3D scene."""

from __future__ import annotations

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
from foreglow.runtime.scene import (
    GAP_RGB,
    ROAD_RGB,
    TRACK_RGB,
    gap_lines,
    road_lines,
    track_label,
    tracks_in_view,
)
from foreglow.types import Detections, Frame, FrameResult, Tracks, TrackState

HALF_PIXEL_PX = 0.5
"""In Foxglove the centre of the upper left pixel is (0, 0); here it is (0.5, 0.5)."""

PROPOSAL_COLOUR = Color(r=0.6, g=0.6, b=0.6, a=0.7)

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
            box, colour = result.tracks.boxes_xyxy_px[index], _colour(TRACK_RGB[TrackState(state)])
            points.append(_box_lines(box[None], colour, 2.0, stamp))
            texts.append(
                TextAnnotation(
                    timestamp=stamp,
                    position=Point2(x=float(box[0]), y=float(box[1]) - 2.0),
                    text=track_label(result.tracks, index),
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
    entities = [tracks]
    for name, lines, colour in (("road", road_lines(frame.road), ROAD_RGB), ("gaps", gap_lines(result.beam), GAP_RGB)):
        drawn = [_line(points, _colour(colour)) for points in lines]
        entities.append(SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id=name, lines=drawn))
    return SceneUpdate(entities=entities)


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


def _track_entity(camera: Camera, tracks: Tracks, stamp: Timestamp) -> SceneEntity:
    """For each track a cube at its range, a line of plus and minus one sigma along the viewing ray, and a label."""
    cubes, lines, texts = [], [], []
    for index, position_m, reach_m in tracks_in_view(camera, tracks):
        colour = _colour(TRACK_RGB[TrackState(int(tracks.states[index]))])
        x, y, z = position_m.tolist()
        at = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
        cubes.append(CubePrimitive(pose=at, size=Vector3(x=1.0, y=1.0, z=1.0), color=colour))
        if reach_m is not None:
            lines.append(_line(reach_m, colour))
        texts.append(
            TextPrimitive(
                pose=at,
                billboard=True,
                font_size=14.0,
                scale_invariant=True,
                color=colour,
                text=track_label(tracks, index),
            )
        )
    return SceneEntity(timestamp=stamp, frame_id=VEHICLE_FRAME, id="tracks", cubes=cubes, lines=lines, texts=texts)


def _colour(rgb: tuple[float, float, float]) -> Color:
    red, green, blue = rgb
    return Color(r=red, g=green, b=blue, a=1.0)


def _line(points: Floats, colour: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        thickness=2.0,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points.tolist()],
        color=colour,
    )
