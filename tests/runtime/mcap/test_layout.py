"""The layout in docs/ is the one that the code makes, of topics that there are."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("foxglove")

from foreglow.datasets.bags import FRAME_TOPIC
from foreglow.runtime.mcap.channels import (
    FRAME_SCHEMA,
    HEALTH_SCHEMA,
    HEALTH_TOPIC,
    RESULT_SCHEMA,
    RESULT_TOPIC,
)
from foreglow.runtime.mcap.layout import foxglove_layout

LAYOUT = Path(__file__).parents[3] / "docs" / "foxglove_layout.json"


def test_the_layout_in_the_guide_is_up_to_date() -> None:
    assert LAYOUT.read_text() == foxglove_layout(), "write what foxglove_layout() says to docs/foxglove_layout.json"


def test_every_plotted_value_is_in_a_schema() -> None:
    schemas: dict[str, Any] = {FRAME_TOPIC: FRAME_SCHEMA, RESULT_TOPIC: RESULT_SCHEMA, HEALTH_TOPIC: HEALTH_SCHEMA}
    values = re.findall(r'"value": "([^"]+)"', json.dumps(json.loads(foxglove_layout())))
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
