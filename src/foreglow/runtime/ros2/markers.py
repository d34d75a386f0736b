"""The node `markers`: tracks for programs that know nothing of Foreglow, such as RViz."""

from __future__ import annotations

from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.frame_reader import FrameReader
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.join import Joined
from foreglow.runtime.ros2.node import FrameNode
from foreglow.runtime.ros2.results import read_tracks
from foreglow.runtime.ros2.stages import Setting
from foreglow.runtime.ros2.standard import installed_types, standard_messages
from foreglow.stopwatch import Stopwatch
from foreglow.types import Frame, Tracks


class MarkerNode(FrameNode[tuple[Frame, Tracks]]):
    """Tracks to markers and to detections of `vision_msgs`, where these packages are installed; nobody waits for it."""

    def __init__(self, setting: Setting) -> None:
        """Joins the network.

        Raises:
            ModuleNotFoundError: If neither package is installed.
        """
        self._types = installed_types()
        if not self._types:
            raise ModuleNotFoundError("markers: expected ROS 2's visualization_msgs or vision_msgs to be installed")
        exact, sampled = setting.camera_topics
        super().__init__(
            "markers",
            (topics.TRACKS, *exact),
            (*sampled, topics.ROAD),
            ros_arguments=setting.ros_arguments,
            patience_s=setting.patience_s,
        )
        self._reader = FrameReader(setting.calibration)
        self._outputs = {
            topic: self.ros.create_publisher(kind, topic, topics.publisher_quality(topic))
            for topic, kind in self._types.items()
        }

    def reset(self) -> None:
        """Has nothing to forget."""

    def read(self, joined: Joined) -> tuple[Frame, Tracks]:
        """The frame without its pixels, and its tracks."""
        return self._reader.read(joined), read_tracks(joined.messages[topics.TRACKS], topics.TRACKS)[1]

    def step(self, header: Header, inputs: tuple[Frame, Tracks], stopwatch: Stopwatch) -> None:
        """Publishes the tracks of a frame."""
        stopwatch.begin("send")
        for topic, message in standard_messages(header, *inputs, None, self._types).items():
            self._outputs[topic].publish(message)
