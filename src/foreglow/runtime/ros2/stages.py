"""The compute nodes: each wraps one stage of the pipeline, or all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from foreglow.config import PipelineConfig
from foreglow.datasets.vehicle_data import VehicleData
from foreglow.pipeline import Pipeline, Stages, estimated, tracked
from foreglow.runtime.can_output import CanBus
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.frame_reader import FrameReader, motion_of
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.input_messages import read_image
from foreglow.runtime.ros2.join import Joined
from foreglow.runtime.ros2.node import BAD_MESSAGE, INPUT_MISSING, FrameNode, Inputs
from foreglow.runtime.ros2.output import BeamOutput
from foreglow.runtime.ros2.results import (
    detections_message,
    proposals_message,
    read_detections,
    read_proposals,
    read_ranges,
    read_tracks,
    tracks_message,
)
from foreglow.stopwatch import Stopwatch
from foreglow.types import Detections, Frame, FrameResult, Proposals, Ranges, Tracks
from foreglow.types.white import full_scale

Stage = TypeVar("Stage")


class Setting(NamedTuple):
    """The settings of a compute node.

    Attributes:
        config: The pipeline's configuration, the same for all nodes.
        calibration: Knows the camera by the size of its image; None where `CameraInfo` and mount come as messages.
        can: The bus for beam commands; None without one.
        deadline_s: Longest time without input before low beam; None for just under two frames.
        patience_s: How long a frame waits for the vehicle's data that belong to it; None for `Join.PATIENCE_NS`.
        ros_arguments: The command line from `--ros-args` on.
    """

    config: PipelineConfig
    calibration: VehicleData | None = None
    can: CanBus | None = None
    deadline_s: float | None = None
    patience_s: float | None = None
    ros_arguments: Sequence[str] = ()

    @property
    def camera_topics(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The topics by which the camera is known: exact ones, and sampled ones."""
        return ((topics.CAMERA_INFO,), (topics.MOUNT,)) if self.calibration is None else ((topics.IMAGE,), ())


def needed(field: str, stage: Stage | None) -> Stage:
    """The stage of a node that has no other work.

    Raises:
        ValueError: If it is switched off; the message has the configuration's field.
    """
    if stage is None:
        raise ValueError(f"{field}: expected one for this node to run, got none")
    return stage


MOTION = (topics.TWIST, topics.ATTITUDE)
"""What is read as one `EgoMotion`, in which a car that cannot move so is known by all of its parts."""


def read_pixels(joined: Joined, white_level: int | None) -> Frame:
    """The frame with its image at full scale, and our motion if that is there: the first two stages need no more."""
    image, header = read_image(joined.messages[topics.IMAGE], topics.IMAGE), joined.header
    motion = motion_of(joined.messages)
    frame = Frame(image, header.timestamp_ns, sequence=header.sequence, path=topics.IMAGE, motion=motion)
    return full_scale(frame, white_level)


class ProposalNode(FrameNode[Frame]):
    """Images to boxes that may hold light; the paper's proposal generation (PG)."""

    def __init__(self, setting: Setting) -> None:
        stages = Stages(setting.config)
        self._proposer, self._standing = stages.proposer, stages.standing
        self._white_level = setting.config.guard.white_level
        sampled = () if self._standing is None else MOTION
        arguments, patience_s = setting.ros_arguments, setting.patience_s
        super().__init__("proposals", (topics.IMAGE,), sampled, ros_arguments=arguments, patience_s=patience_s)
        self._output = self.publisher(topics.PROPOSALS)

    def reset(self) -> None:
        """Forgets earlier frames."""
        if self._standing is not None:
            self._standing.reset()

    def read(self, joined: Joined) -> Frame:
        """The image, and our motion where the second step needs it."""
        return read_pixels(joined, self._white_level)

    def step(self, header: Header, inputs: Frame, stopwatch: Stopwatch) -> None:
        """Publishes the boxes of an image."""
        stopwatch.begin("proposals")
        proposals = self._proposer.propose(inputs.image)
        if self._standing is not None:
            stopwatch.begin("standing")
            proposals = self._standing.leave_out(inputs, proposals)
        stopwatch.begin("send")
        self._output.publish(proposals_message(header, proposals))


class ClassifierNode(FrameNode[tuple[Frame, Proposals]]):
    """Boxes that may hold light to scored ones; the paper's proposal classification (PC)."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("classifier", (topics.PROPOSALS, topics.IMAGE), ros_arguments=setting.ros_arguments)
        self._classifier = needed("classifier.model", Stages(setting.config).classifier)
        self._white_level = setting.config.guard.white_level
        self._output = self.publisher(topics.DETECTIONS)

    def reset(self) -> None:
        """Forgets earlier frames."""
        self._classifier.reset()

    def read(self, joined: Joined) -> tuple[Frame, Proposals]:
        """The image and its boxes."""
        frame = read_pixels(joined, self._white_level)
        return frame, read_proposals(joined.messages[topics.PROPOSALS], topics.PROPOSALS)[1]

    def step(self, header: Header, inputs: tuple[Frame, Proposals], stopwatch: Stopwatch) -> None:
        """Publishes the scored boxes of an image."""
        stopwatch.begin("classifier")
        detections = self._classifier.classify(*inputs)
        stopwatch.begin("send")
        self._output.publish(detections_message(header, detections))


class DistanceNode(FrameNode[tuple[Frame, Detections]]):
    """Estimates the ranges of boxes; passes boxes on without ranges where no estimator or camera is known."""

    def __init__(self, setting: Setting) -> None:
        exact, sampled = setting.camera_topics
        super().__init__(
            "distance",
            (topics.DETECTIONS, topics.IMAGE, *exact),
            (*sampled, *MOTION, topics.ROAD),
            ros_arguments=setting.ros_arguments,
            patience_s=setting.patience_s,
        )
        self._threshold = setting.config.classifier.score_threshold
        self._estimator = Stages(setting.config).estimator
        self._white_level = setting.config.guard.white_level
        self._reader = FrameReader(setting.calibration)
        self._output = self.publisher(topics.RANGES)

    def reset(self) -> None:
        """Forgets earlier frames."""
        if self._estimator is not None:
            self._estimator.reset()

    def read(self, joined: Joined) -> tuple[Frame, Detections]:
        """The frame and its boxes."""
        message = joined.messages[topics.DETECTIONS]
        frame = full_scale(self._reader.read(joined), self._white_level)
        return frame, read_detections(message, topics.DETECTIONS, self._threshold)[1]

    def step(self, header: Header, inputs: tuple[Frame, Detections], stopwatch: Stopwatch) -> None:
        """Publishes the ranges of a frame's boxes."""
        frame, detections = inputs
        ranges: Ranges | None = None
        stopwatch.begin("distance")
        if self._estimator is not None and frame.camera is not None:
            ranges = estimated(self._estimator, frame, detections)
        stopwatch.begin("send")
        self._output.publish(detections_message(header, detections, ranges))


class TrackingNode(FrameNode[tuple[Frame, Detections, Ranges | None]]):
    """Follows the boxes from frame to frame; needs no image."""

    def __init__(self, setting: Setting) -> None:
        exact, sampled = setting.camera_topics
        super().__init__(
            "tracking",
            (topics.RANGES, *exact),
            (*sampled, *MOTION),
            ros_arguments=setting.ros_arguments,
            patience_s=setting.patience_s,
        )
        self._threshold = setting.config.classifier.score_threshold
        self._tracker = needed("tracker.method", Stages(setting.config).tracker)
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

    def step(self, header: Header, inputs: tuple[Frame, Detections, Ranges | None], stopwatch: Stopwatch) -> None:
        """Publishes the tracks after a frame."""
        stopwatch.begin("tracking")
        tracks = tracked(self._tracker, *inputs)
        stopwatch.begin("send")
        self._output.publish(tracks_message(header, tracks))


BEAM_SAMPLED = (*MOTION, topics.ROAD, topics.DAMAGE, topics.REPORTED)
"""What policy and guard go by, beside tracks, image and camera."""


class CommandingNode(FrameNode[Inputs]):
    """A node that commands the beam: low beam where a frame failed, a message has no frame, or input is overdue."""

    def __init__(self, name: str, setting: Setting, exact: Sequence[str], sampled: Sequence[str]) -> None:
        """Joins the network; subscribes to the camera's topics, too."""
        camera_exact, camera_sampled = setting.camera_topics
        exact, sampled = (*exact, *camera_exact), (*camera_sampled, *sampled)
        super().__init__(name, exact, sampled, ros_arguments=setting.ros_arguments, patience_s=setting.patience_s)
        self._reader = FrameReader(setting.calibration)
        self._output = BeamOutput(self, setting.config, can=setting.can, deadline_s=setting.deadline_s)

    def failed(self, header: Header, fault: str) -> None:
        """Commands low beam; the next frame begins anew, so with low beam, from which light returns slowly."""
        self._output.arrived()
        self._output.low(header, fault)

    def refused(self) -> None:
        """Commands low beam at once, and the next frame begins anew; the deadline runs on."""
        self._has_failed = True
        self._output.low(Header(self.clock_ns()), BAD_MESSAGE)

    def idle(self, now_ns: int) -> None:
        """Commands low beam if input is overdue."""
        self._output.update(now_ns)

    def close(self) -> None:
        """Commands low beam and leaves the network."""
        self._output.close()
        super().close()


class BeamNode(CommandingNode[tuple[Frame, Tracks]]):
    """Tracks to beam commands that the guard has checked; low beam when no tracks come."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("beam", setting, (topics.TRACKS, topics.IMAGE), BEAM_SAMPLED)
        self._stage = needed("beam.policy", Stages(setting.config).beam)

    def reset(self) -> None:
        """Forgets earlier frames: begins with low beam."""
        self._stage.reset()

    def resume(self) -> None:
        """Begins with low beam, but does not forget what is known of the camera."""
        self._stage.resume()

    def idle(self, now_ns: int) -> None:
        """As of every such node; the next frame begins anew: a new process may give its tracks numbers of old ones."""
        super().idle(now_ns)
        self._has_failed |= INPUT_MISSING in self.faults

    def read(self, joined: Joined) -> tuple[Frame, Tracks]:
        """The frame and its tracks."""
        return self._reader.read(joined), read_tracks(joined.messages[topics.TRACKS], topics.TRACKS)[1]

    def step(self, header: Header, inputs: tuple[Frame, Tracks], stopwatch: Stopwatch) -> None:
        """Commands the beam that follows from a frame."""
        stopwatch.begin("beam")
        command = self._stage.command(*inputs, now_ns=self.clock_ns, faults=self._output.arrived())
        stopwatch.begin("send")
        self._output.send(header, command)


class PipelineNode(CommandingNode[Frame]):
    """All stages in one node; publishes the same as the network of them."""

    def __init__(self, setting: Setting) -> None:
        super().__init__("pipeline", setting, (topics.IMAGE,), BEAM_SAMPLED)
        self._pipeline = Pipeline(setting.config)
        self._proposals = self.publisher(topics.PROPOSALS)
        self._detections = self.publisher(topics.DETECTIONS)
        self._ranges = self.publisher(topics.RANGES)
        self._tracks = self.publisher(topics.TRACKS)

    @property
    def stage(self) -> str:
        """As of every node, the pipeline's own stages included."""
        return self._pipeline.stage or super().stage

    def reset(self) -> None:
        """Forgets earlier frames."""
        self._pipeline.reset()

    def resume(self) -> None:
        """Begins with low beam, but does not forget what is known of the camera."""
        self._pipeline.resume()

    def read(self, joined: Joined) -> Frame:
        """The frame."""
        return self._reader.read(joined)

    def step(self, header: Header, inputs: Frame, stopwatch: Stopwatch) -> None:
        """Commands the beam that follows from a frame, then publishes what led to it."""
        result = self._pipeline.step(inputs, now_ns=self.clock_ns, faults=self._output.arrived())
        stopwatch.times_ms.update(result.stage_ms)
        stopwatch.begin("send")
        if result.beam is not None:
            self._output.send(header, result.beam)
        self._publish(header, result)

    def _publish(self, header: Header, result: FrameResult) -> None:
        self._proposals.publish(proposals_message(header, result.proposals))
        if result.detections is not None:
            self._detections.publish(detections_message(header, result.detections))
            self._ranges.publish(detections_message(header, result.detections, result.ranges))
        if result.tracks is not None:
            self._tracks.publish(tracks_message(header, result.tracks))


NODES: Mapping[str, Callable[[Setting], FrameNode[Any]]] = {
    "proposals": ProposalNode,
    "classifier": ClassifierNode,
    "distance": DistanceNode,
    "tracking": TrackingNode,
    "beam": BeamNode,
    "pipeline": PipelineNode,
}
"""The compute nodes by name, in the order in which a frame passes them; `pipeline` replaces those before it."""
