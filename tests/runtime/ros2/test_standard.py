"""Tracks as messages of other packages; of `vision_msgs`, a stand-in with the same fields where it is not installed."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.standard import (
    DETECTIONS_2D,
    MARKERS,
    UNKNOWN_KIND,
    VEHICLE_FRAME,
    installed_types,
    standard_messages,
)
from foreglow.types import TrackState
from foreglow.types.kinds import LIGHT_KINDS
from tests.runtime.mcap.drives import full_frame, full_result

pytestmark = pytest.mark.ros

HEADER = Header(1_700_000_000_123_456_789, "S00001")


def stand_in(**defaults: Any) -> Any:
    """A message type with these fields; each is made by calling the default."""

    def make(**values: Any) -> SimpleNamespace:
        unknown = values.keys() - defaults.keys()
        if unknown:
            raise AssertionError(unknown)
        return SimpleNamespace(**{name: default() for name, default in defaults.items()} | values)

    return make


@pytest.fixture
def vision_msgs(monkeypatch: pytest.MonkeyPatch) -> Any:
    if importlib.util.find_spec("vision_msgs") is not None:
        return importlib.import_module("vision_msgs.msg")
    point = stand_in(x=float, y=float)
    hypothesis = stand_in(class_id=str, score=float)
    package, messages = ModuleType("vision_msgs"), ModuleType("vision_msgs.msg")
    package.__spec__ = importlib.util.spec_from_loader("vision_msgs", None)
    for name, kind in {
        "BoundingBox2D": stand_in(center=stand_in(position=point, theta=float), size_x=float, size_y=float),
        "ObjectHypothesisWithPose": stand_in(hypothesis=hypothesis),
        "Detection2D": stand_in(header=object, results=list, bbox=object, id=str),
        "Detection2DArray": stand_in(header=object, detections=list),
    }.items():
        setattr(messages, name, kind)
    monkeypatch.setitem(sys.modules, "vision_msgs", package)
    monkeypatch.setitem(sys.modules, "vision_msgs.msg", messages)
    return messages


@pytest.mark.usefixtures("vision_msgs")
def test_tracks_are_detections_with_kinds() -> None:
    frame = full_frame(3)
    result = full_result(frame)
    assert result.tracks is not None
    message = standard_messages(HEADER, frame, result.tracks, result.beam, installed_types())[DETECTIONS_2D]
    assert (message.header.stamp.sec, message.header.frame_id) == (1_700_000_000, "S00001")
    first, second = message.detections
    assert (first.id, second.id) == ("3", "8")
    assert (first.bbox.center.position.x, first.bbox.center.position.y) == (15.25, 25.0)
    assert (first.bbox.size_x, first.bbox.size_y) == (9.5, 10.0)
    names = [result.hypothesis.class_id for result in first.results]
    scores = [result.hypothesis.score for result in first.results]
    assert (names[0], set(names)) == ("rear_lamp", set(LIGHT_KINDS))
    assert scores == sorted(scores, reverse=True)
    assert sum(scores) == pytest.approx(result.tracks.confidences[0])
    assert [result.hypothesis.class_id for result in second.results] == [UNKNOWN_KIND]


def test_markers_are_where_the_tracks_are() -> None:
    pytest.importorskip("visualization_msgs")
    frame = full_frame(3)
    result = full_result(frame)
    assert result.tracks is not None
    markers = standard_messages(HEADER, frame, result.tracks, result.beam, installed_types())[MARKERS].markers
    assert {marker.header.frame_id for marker in markers} == {VEHICLE_FRAME}
    assert markers[0].action == markers[0].DELETEALL
    named = {(marker.ns, marker.id): marker for marker in markers[1:]}
    assert named.keys() == {("tracks", 3), ("labels", 3), ("reaches", 3), ("gaps", 0), *(("road", n) for n in range(3))}
    assert frame.camera is not None
    at = named["tracks", 3].pose.position
    ray = np.array([at.x, at.y, at.z]) - frame.camera.vehicle_from_camera.position_m
    assert np.linalg.norm(ray) == pytest.approx(result.tracks.ranges_m[0])
    assert result.tracks.states[0] == TrackState.CONFIRMED
    assert named["tracks", 3].color.g == 1.0
    assert "rear lamp" in named["labels", 3].text
    near, far = named["reaches", 3].points
    assert near.x < at.x < far.x


def test_without_a_package_there_is_no_such_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert installed_types() == {}
