"""The topics of our recordings, and the schemas of those in JSON: made from the types of their messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from foreglow.datasets.bags import FRAME_TYPE, FrameMessage
from foreglow.runs.frame_line import FrameLine

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


def _plain(schema: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """A schema of pydantic in the few words that Foxglove knows: no references, choices, tuples or limits."""
    while "$ref" in schema or "anyOf" in schema:
        schema = known[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema["anyOf"][0]
    if schema["type"] == "array":
        items = schema.get("items") or schema["prefixItems"][0]
        return {"type": "array", "items": _plain(items, known)}
    if schema["type"] == "object":
        parts = schema.get("properties", {})
        return {"type": "object", "properties": {name: _plain(part, known) for name, part in parts.items()}}
    return {"type": schema["type"]}


def _described(title: str, kind: type) -> dict[str, Any]:
    schema = TypeAdapter(kind).json_schema(mode="serialization")
    return {"title": title, **_plain(schema, schema.get("$defs", {}))}


FRAME_SCHEMA = _described(FRAME_TYPE, FrameMessage)
"""A frame without its image."""

RESULT_SCHEMA = _described("foreglow.Result", FrameLine)
"""A line of `frames.jsonl`, with the times of `times.jsonl`."""

_STAGES = ("proposals", "standing", "classifier", "distance", "tracking", "beam", "capture", "queue", "send")
RESULT_SCHEMA["properties"]["stage_ms"] = {
    "type": "object",
    "properties": {name: {"type": "number"} for name in _STAGES},
}


class HealthLine(TypedDict):
    """A `runtime.health.Health`, with nothing but the mode of its beam command."""

    timestamp_ns: int
    faults: list[str]
    num_frames: int
    num_dropped: int
    num_late: int
    details: str
    beam: str | None


HEALTH_SCHEMA = _described("foreglow.Health", HealthLine)
