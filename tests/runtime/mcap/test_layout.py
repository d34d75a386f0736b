"""The layout of Foxglove's panels in docs/ shows topics and values that there are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove")

from foreglow.datasets.bags import FRAME_TOPIC
from foreglow.runtime.mcap import channels
from foreglow.runtime.mcap.channels import (
    BOXES_TOPIC,
    CALIBRATION_TOPIC,
    FRAME_SCHEMA,
    HEALTH_SCHEMA,
    HEALTH_TOPIC,
    IMAGE_TOPIC,
    LOG_TOPIC,
    RESULT_SCHEMA,
    RESULT_TOPIC,
    SCENE_TOPIC,
)

LAYOUT = Path(__file__).parents[3] / "docs" / "foxglove_layout.json"


def test_every_topic_is_recorded() -> None:
    shown = set(re.findall(r'"(/[a-z/]+)["."]', LAYOUT.read_text()))
    assert {IMAGE_TOPIC, CALIBRATION_TOPIC, BOXES_TOPIC, SCENE_TOPIC, LOG_TOPIC} < shown
    assert shown <= {FRAME_TOPIC} | {value for name, value in vars(channels).items() if name.endswith("_TOPIC")}


def test_every_plotted_value_is_in_a_schema() -> None:
    schemas: dict[str, Any] = {FRAME_TOPIC: FRAME_SCHEMA, RESULT_TOPIC: RESULT_SCHEMA, HEALTH_TOPIC: HEALTH_SCHEMA}
    values = re.findall(r'"value": "([^"]+)"', LAYOUT.read_text())
    assert len(values) > 10
    for value in values:
        topic, *fields = re.sub(r"\[[^]]*\]", "[]", value).split(".")
        schema = schemas[topic]
        for field in fields:
            name, *slices = field.split("[]")
            schema = schema["properties"][name]
            for _ in slices:
                schema = schema["items"]
        assert schema["type"] in ("number", "integer", "string")
