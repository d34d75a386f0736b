"""The compute nodes: each wraps one stage of the pipeline, or all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from foreglow.beam import BeamStage
from foreglow.classifier import OnnxClassifier
from foreglow.config import PipelineConfig
from foreglow.distance import make_estimator
from foreglow.geometry import Camera
from foreglow.pipeline import Pipeline
from foreglow.proposals import make_proposer
from foreglow.runtime.can_output import CanBus
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.frame_reader import FrameReader
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.join import Joined
from foreglow.runtime.ros2.messages import read_image
from foreglow.runtime.ros2.node import FrameNode, Inputs, Laps
from foreglow.runtime.ros2.output import BeamOutput
from foreglow.runtime.ros2.results import (
    detections_message,
    read_detections,
    read_ranges,
    read_tracks,
    tracks_message,
)
from foreglow.tracking import make_tracker
from foreglow.types import Detections, Frame, FrameResult, Ranges, Tracks


class Setting(NamedTuple):
    """What a compute node is told.

    Attributes:
        config: The pipeline's, the same for all nodes.
        calibration: The camera; None where `CameraInfo` and mount come by topic.
        can: The bus for commands; None without one.
        deadline_s: Longest time without input before low beam; None for just under two frames.
        ros_arguments: Of the command line, from `--ros-args` on.
    """

    config: PipelineConfig
    calibration: Camera | None = None
    can: CanBus | None = None
    deadline_s: float | None = None
    ros_arguments: Sequence[str] = ()

    @property
    def camera_topics(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Topics, exact and sampled, that tell of the camera."""
        return ((topics.CAMERA_INFO,), (topics.MOUNT,)) if self.calibration is None else ((), ())


class DetectorNode(FrameNode[Frame]):
    """Images to scored boxes: proposals and classification."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("detector", (topics.IMAGE,), ros_arguments=setting.ros_arguments)
        self._proposer = make_proposer(setting.config.proposals)
        self._classifier = OnnxClassifier(setting.config.classifier)
        self._output = self.publisher(topics.DETECTIONS)

    def reset(self) -> None:
        """Forgets earlier frames."""
        self._classifier.reset()

    def read(self, joined: Joined) -> Frame:
        """The image, of which alone boxes and scores are made."""
        image = read_image(joined.messages[topics.IMAGE], topics.IMAGE)
        return Frame(image, joined.header.timestamp_ns, sequence=joined.header.sequence, path=topics.IMAGE)

    def step(self, header: Header, inputs: Frame, laps: Laps) -> None:
        """Publishes the boxes of an image."""
        proposals = self._proposer.propose(inputs.image)
        laps.took("proposals")
        detections = self._classifier.classify(inputs, proposals)
        laps.took("classifier")
        self._output.publish(detections_message(header, detections))
        laps.took("send")


class DistanceNode(FrameNode[tuple[Frame, Detections]]):
    """Gives the boxes ranges; passes them on as they are where nothing is to estimate any."""

    def __init__(self, setting: Setting) -> None:
        exact, sampled = setting.camera_topics
        super().__init__(
            "distance",
            (topics.DETECTIONS, topics.IMAGE, *exact),
            (*sampled, topics.TWIST, topics.ATTITUDE, topics.ROAD),
            ros_arguments=setting.ros_arguments,
        )
        self._threshold = setting.config.classifier.score_threshold
        distance = setting.config.distance
        self._estimator = make_estimator(distance) if distance.estimator != "none" else None
        self._reader = FrameReader(setting.calibration)
        self._output = self.publisher(topics.RANGES)

    def reset(self) -> None:
        """Forgets earlier frames."""
        if self._estimator is not None:
            self._estimator.reset()

    def read(self, joined: Joined) -> tuple[Frame, Detections]:
        """The frame and its boxes."""
        message = joined.messages[topics.DETECTIONS]
        return self._reader.read(joined), read_detections(message, topics.DETECTIONS, self._threshold)[1]

    def step(self, header: Header, inputs: tuple[Frame, Detections], laps: Laps) -> None:
        """Publishes the ranges of a frame's boxes."""
        frame, detections = inputs
        ranges: Ranges | None = None
        if self._estimator is not None and frame.camera is not None:
            ranges = self._estimator.estimate(frame, detections)
        laps.took("distance")
        self._output.publish(detections_message(header, detections, ranges))
        laps.took("send")


class TrackingNode(FrameNode[tuple[Frame, Detections, Ranges | None]]):
    """Follows the boxes from frame to frame; needs no image."""

    def __init__(self, setting: Setting) -> None:
        exact, sampled = setting.camera_topics
        super().__init__(
            "tracking", (topics.RANGES, *exact), (*sampled, topics.TWIST), ros_arguments=setting.ros_arguments
        )
        self._threshold = setting.config.classifier.score_threshold
        self._tracker = make_tracker(setting.config.tracker)
        self._reader = FrameReader(setting.calibration)
        self._output = self.publisher(topics.TRACKS)

    def reset(self) -> None:
        """Forgets all tracks."""
        self._tracker.reset()

    def read(self, joined: Joined) -> tuple[Frame, Detections, Ranges | None]:
        """The frame without its pixels, its boxes and their ranges."""
        message = joined.messages[topics.RANGES]
        _, detections, ranges = read_ranges(message, topics.RANGES, self._threshold)
        return self._reader.read(joined), detections, ranges

    def step(self, header: Header, inputs: tuple[Frame, Detections, Ranges | None], laps: Laps) -> None:
        """Publishes the tracks after a frame."""
        tracks = self._tracker.update(*inputs)
        laps.took("tracking")
        self._output.publish(tracks_message(header, tracks))
        laps.took("send")


class CommandingNode(FrameNode[Inputs]):
    """A node that commands the beam: low beam where a frame failed, or input is overdue."""

    def __init__(self, name: str, setting: Setting, exact: Sequence[str], sampled: Sequence[str]) -> None:
        """Joins the network; takes the topics of the camera, too."""
        camera_exact, camera_sampled = setting.camera_topics
        exact, sampled = (*exact, *camera_exact), (*camera_sampled, *sampled)
        super().__init__(name, exact, sampled, ros_arguments=setting.ros_arguments)
        self._reader = FrameReader(setting.calibration)
        self._output = BeamOutput(self, setting.config, can=setting.can, deadline_s=setting.deadline_s)

    def failed(self, header: Header, fault: str) -> None:
        """Low beam; what the guard believes to shine has gone."""
        self.reset()
        self._output.came()
        self._output.low(header, fault)

    def idle(self, now_ns: int) -> None:
        """Low beam if input is overdue."""
        self._output.look(now_ns)

    def close(self) -> None:
        """Leaves low beam behind."""
        self._output.close()
        super().close()


class BeamNode(CommandingNode[tuple[Frame, Tracks]]):
    """Tracks to beam commands, as far as the guard lets them; low beam when none come."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("beam", setting, (topics.TRACKS, topics.IMAGE), (topics.TWIST, topics.ROAD))
        self._stage = BeamStage(setting.config.beam, setting.config.guard)

    def reset(self) -> None:
        """Forgets earlier frames: begins with low beam."""
        self._stage.reset()

    def read(self, joined: Joined) -> tuple[Frame, Tracks]:
        """The frame and its tracks."""
        return self._reader.read(joined), read_tracks(joined.messages[topics.TRACKS], topics.TRACKS)[1]

    def step(self, header: Header, inputs: tuple[Frame, Tracks], laps: Laps) -> None:
        """Commands the beam that follows from a frame."""
        command = self._stage.command(*inputs, time_ns=self.clock_ns(), faults=self._output.came())
        laps.took("beam")
        self._output.send(header, command)
        laps.took("send")


class PipelineNode(CommandingNode[Frame]):
    """All stages in one node; publishes the same as the network of them."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("pipeline", setting, (topics.IMAGE,), (topics.TWIST, topics.ATTITUDE, topics.ROAD))
        self._pipeline = Pipeline(setting.config)
        self._detections = self.publisher(topics.DETECTIONS)
        self._ranges = self.publisher(topics.RANGES)
        self._tracks = self.publisher(topics.TRACKS)

    def reset(self) -> None:
        """Forgets earlier frames."""
        self._pipeline.reset()

    def read(self, joined: Joined) -> Frame:
        """The frame."""
        return self._reader.read(joined)

    def step(self, header: Header, inputs: Frame, laps: Laps) -> None:
        """Commands the beam that follows from a frame, then publishes what led to it."""
        result = self._pipeline.step(inputs, now_ns=self.clock_ns, faults=self._output.came())
        laps.skip()
        if result.beam is not None:
            self._output.send(header, result.beam)
        self._publish(header, result)
        laps.took("send")
        laps.times_ms.update(result.stage_ms)

    def _publish(self, header: Header, result: FrameResult) -> None:
        if result.detections is not None:
            self._detections.publish(detections_message(header, result.detections))
            self._ranges.publish(detections_message(header, result.detections, result.ranges))
        if result.tracks is not None:
            self._tracks.publish(tracks_message(header, result.tracks))


NODES: Mapping[str, Callable[[Setting], FrameNode[Any]]] = {
    "detector": DetectorNode,
    "distance": DistanceNode,
    "tracking": TrackingNode,
    "beam": BeamNode,
    "pipeline": PipelineNode,
}
"""By name, in the order in which a frame passes them; `pipeline` stands for the four before it."""
