"""The topics of our recordings, and the schemas of those in JSON."""

from __future__ import annotations

from typing import Any

from foreglow.datasets.bags import FRAME_TYPE

IMAGE_TOPIC = "/camera/image"
CALIBRATION_TOPIC = "/camera/calibration"
BOXES_TOPIC = "/camera/boxes"
TRANSFORM_TOPIC = "/tf"
SCENE_TOPIC = "/scene"
RESULT_TOPIC = "/result"
HEALTH_TOPIC = "/health"
LOG_TOPIC = "/log"

CAMERA_FRAME = "camera"
"""Coordinates as in OpenCV and ROS: x to the right, y downwards, z along the axis."""

VEHICLE_FRAME = "vehicle"
"""Coordinates of `foreglow.geometry`: x forward, y to the left, z up, the origin on the road under the rear axle."""


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _TEXT, _INTEGER = {"type": "number"}, {"type": "string"}, {"type": "integer"}

FRAME_SCHEMA = {
    "title": FRAME_TYPE,
    **_object(
        frame=_INTEGER,
        sequence=_TEXT,
        timestamp_ns=_INTEGER,
        camera=_object(
            width=_INTEGER,
            height=_INTEGER,
            focal_px=_array(_NUMBER),
            centre_px=_array(_NUMBER),
            distortion=_array(_NUMBER),
            position_m=_array(_NUMBER),
            rotation=_array(_array(_NUMBER)),
        ),
        motion=_object(speed_mps=_NUMBER, yaw_rate_radps=_NUMBER, pitch_rad=_NUMBER),
        road=_object(
            points_m=_array(_array(_NUMBER)),
            half_width_m=_NUMBER,
            cross_slopes=_array(_NUMBER),
            error_bound_m=_NUMBER,
        ),
        is_damaged={"type": "boolean"},
    ),
}
"""A frame without its image: `datasets.bags.FrameMessage`."""

RESULT_SCHEMA = {
    "title": "foreglow.Result",
    **_object(
        frame=_INTEGER,
        sequence=_TEXT,
        timestamp_ns=_INTEGER,
        proposals_xyxy_px=_array(_array(_INTEGER)),
        scores=_array(_NUMBER),
        direct=_array(_NUMBER),
        detections_xyxy_px=_array(_array(_INTEGER)),
        ranges_m=_array(_NUMBER),
        range_sigmas_m=_array(_NUMBER),
        tracks=_array(
            _object(
                id=_INTEGER,
                state=_TEXT,
                box_xyxy_px=_array(_NUMBER),
                confidence=_NUMBER,
                num_hits=_INTEGER,
                num_misses=_INTEGER,
                age_s=_NUMBER,
                range_m=_NUMBER,
                range_sigma_m=_NUMBER,
                detection=_INTEGER,
                direct=_NUMBER,
            )
        ),
        beam=_object(
            mode=_TEXT,
            gaps=_array(_object(right_deg=_NUMBER, left_deg=_NUMBER, range_m=_NUMBER)),
            faults=_array(_TEXT),
            levels=_array(_array(_INTEGER)),
        ),
        stage_ms=_object(
            **dict.fromkeys(
                ("proposals", "classifier", "distance", "tracking", "beam", "capture", "queue", "send"), _NUMBER
            )
        ),
    ),
}
"""A line of `frames.jsonl`, `runs.frames_file.FrameLine`, with the times of `times.jsonl`."""

HEALTH_SCHEMA = {
    "title": "foreglow.Health",
    **_object(
        timestamp_ns=_INTEGER,
        faults=_array(_TEXT),
        num_frames=_INTEGER,
        num_dropped=_INTEGER,
        num_late=_INTEGER,
        beam=_TEXT,
    ),
}
"""`runtime.health.Health`; of the current beam command only the mode."""
