"""The node for RViz, and the status line, on a network of their own."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("visualization_msgs")

import rclpy

from foreglow.config import preset
from foreglow.datasets.vehicle_logs import VehicleFiles
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.input_messages import image_message
from foreglow.runtime.ros2.markers import MarkerNode
from foreglow.runtime.ros2.node import Receiver, make_ros_node
from foreglow.runtime.ros2.results import tracks_message
from foreglow.runtime.ros2.stages import Setting
from foreglow.runtime.ros2.standard import MARKERS, installed_types
from foreglow.runtime.ros2.status_line import StatusLine
from tests.runtime.mcap.drives import CAMERA, full_frame, full_result
from tests.stand_ins import night_image

pytestmark = [
    pytest.mark.ros,
    pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning"),  # rclpy's own
    pytest.mark.usefixtures("domain"),
]


def test_tracks_become_markers_and_the_status_line_counts_them() -> None:
    tracks = full_result(full_frame(0)).tracks
    assert tracks is not None
    ros = make_ros_node("bench")
    node = MarkerNode(Setting(preset("foreglow"), VehicleFiles(camera=CAMERA.scaled(256, 192))))
    line = StatusLine(["markers"])
    found: list[Any] = []
    ros.create_subscription(installed_types()[MARKERS], MARKERS, found.append, 10)
    publishers = {
        topic: ros.create_publisher(topics.TYPES[topic], topic, topics.publisher_quality(topic))
        for topic in (topics.IMAGE, topics.TRACKS)
    }
    receiver = Receiver(ros)

    def wait(is_done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + 20
        while not is_done():
            assert time.monotonic() < end_s, line.text(time.monotonic())
            header = Header(node.clock_ns(), "S00001")
            publishers[topics.IMAGE].publish(image_message(header, night_image()))
            publishers[topics.TRACKS].publish(tracks_message(header, tracks))
            node.spin_once()
            receiver.receive(0.0)
            line.receive(0.0)

    try:
        wait(lambda: bool(found) and not line.text(time.monotonic()).startswith("0 frames"))
        assert {(marker.ns, marker.id) for marker in found[0].markers} >= {("tracks", 3), ("labels", 3)}
        assert not node.faults
    finally:
        line.close()
        node.close()
        ros.destroy_node()
        rclpy.shutdown()
