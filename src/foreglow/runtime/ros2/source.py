"""The source: frames of a camera, or of a data set, a recording or a video at their own rate, as a driver does it."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from foreglow.runtime.live import LiveSource
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.messages import (
    attitude_message,
    camera_info_message,
    image_message,
    mount_message,
    road_message,
    twist_message,
)
from foreglow.runtime.ros2.node import make_ros_node
from foreglow.types import Frame

FRAME_ID = "camera"
"""Name of a sequence that has none: a frame_id has to be there."""

PAUSE_NS = 500_000_000
"""Between two sequences, and before the first frame."""

RETRY_S = 1.0
"""Between two attempts to open a camera."""


class Due(NamedTuple):
    """A frame, when it is to be sent, and the header under which."""

    frame: Frame
    header: Header


class FramePublisher:
    """Publishes frames: all that the car knew first, then the image."""

    def __init__(self, ros: Any) -> None:
        """Takes the node of rclpy."""
        names = (topics.CAMERA_INFO, topics.MOUNT, topics.TWIST, topics.ATTITUDE, topics.ROAD, topics.IMAGE)
        self._publishers = {
            name: ros.create_publisher(topics.TYPES[name], name, topics.publisher_quality(name)) for name in names
        }

    def messages(self, due: Due) -> list[tuple[str, Any]]:
        """What is to be sent, by topic, in order."""
        frame, header = due
        size_px = (frame.width_px, frame.height_px)
        sent: list[tuple[str, Any]] = [(topics.CAMERA_INFO, camera_info_message(header, size_px, frame.camera))]
        if frame.camera is not None:
            sent.append((topics.MOUNT, mount_message(header, frame.camera.vehicle_from_camera)))
        sent += [
            (topics.TWIST, twist_message(header, frame.motion)),
            (topics.ATTITUDE, attitude_message(header, frame.motion)),
            (topics.ROAD, road_message(header, frame.road)),
            (topics.IMAGE, image_message(header, frame.image)),
        ]
        return sent

    def publish(self, messages: Iterable[tuple[str, Any]]) -> None:
        """Sends them."""
        for topic, message in messages:
            self._publishers[topic].publish(message)


def timed(frames: Iterable[Frame], clock_ns: Callable[[], int], *, speed: float = 1.0) -> Iterator[Due]:
    """Each frame with the time at which it is due, which is its stamp: as if it were taken now.

    All times of a sequence are moved by the same amount, so that the time between two frames stays what it was to the
    nanosecond, and with it every result. A sequence begins `PAUSE_NS` after the one before, or after it is asked for.

    Args:
        frames: In the order of time within each sequence.
        clock_ns: The network's clock.
        speed: How many times quicker than they were taken; with another than 1 the stamps are nearer, too.
    """
    latest_ns = clock_ns()
    for number, (_, sequence) in enumerate(itertools.groupby(frames, key=lambda frame: frame.sequence)):
        first_ns: int | None = None
        begin_ns = max(latest_ns, clock_ns()) + PAUSE_NS
        for frame in sequence:
            first_ns = frame.timestamp_ns if first_ns is None else first_ns
            passed_ns = frame.timestamp_ns - first_ns
            latest_ns = begin_ns + (passed_ns if speed == 1.0 else round(passed_ns / speed))
            yield Due(frame, Header(latest_ns, sequence_name(frame.sequence, number)))


def sequence_name(sequence: str, number: int) -> str:
    """The frame_id of the `number`-th sequence: unlike that of the one before, also where it is played again.

    >>> sequence_name("S00003", 0), sequence_name("S00003", 1)
    ('S00003', 'S00003#1')
    """
    return (sequence or FRAME_ID) + (f"#{number}" if number else "")


def repeated(frames: Iterable[Frame], limit: int | None = None, *, is_endless: bool = False) -> Iterator[Frame]:
    """The first `limit` frames; again and again where that is wanted, each time as sequences of their own."""
    for number in itertools.count():
        num_frames = 0
        for frame in itertools.islice(frames, limit):
            num_frames += 1
            yield dataclasses.replace(frame, sequence=f"{frame.sequence}+{number}") if number else frame
        if not (is_endless and num_frames):
            return


class Player:
    """The node `source`: publishes frames at their own rate."""

    def __init__(self, should_stop: Callable[[], bool], ros_arguments: Sequence[str] = ()) -> None:
        """Joins the network, and leaves it after `play`."""
        self.ros = make_ros_node("source", ros_arguments)
        self._publisher = FramePublisher(self.ros)
        self._should_stop = should_stop

    def wait(self) -> None:
        """Waits until somebody makes beam commands, and every stage before has somebody to publish for."""
        while not (self._should_stop() or self._is_listened_to()):
            time.sleep(0.05)
        time.sleep(PAUSE_NS / 1e9)  # who is known has still to be connected

    def play(self, frames: Iterable[Frame], *, speed: float = 1.0) -> int:
        """Publishes `frames`; returns how many.

        A frame whose messages are ready late is sent at once: its stamp says when it was due.
        """
        num_frames = 0
        try:
            for due in timed(frames, self.clock_ns, speed=speed):
                messages = self._publisher.messages(due)
                while not self._should_stop() and (left_ns := due.header.timestamp_ns - self.clock_ns()) > 0:
                    time.sleep(min(left_ns / 1e9, 0.05))
                if self._should_stop():
                    break
                self._publisher.publish(messages)
                num_frames += 1
        finally:
            self.ros.destroy_node()
        return num_frames

    def stream(self, camera: LiveSource, *, limit: int | None = None) -> int:
        """Publishes the frames of a live camera as they come, stamped with their exposure; returns how many.

        A camera that is lost is opened anew, as often as need be.
        """
        num_frames = 0
        try:
            while not (self._should_stop() or num_frames == limit):
                try:
                    for frame in camera:
                        stamp_ns = self.clock_ns() - (camera.now_ns() - frame.timestamp_ns)
                        due = Due(frame, Header(stamp_ns, sequence_name(frame.sequence, 0)))
                        self._publisher.publish(self._publisher.messages(due))
                        num_frames += 1
                        if self._should_stop() or num_frames == limit:
                            break
                except (OSError, ValueError) as error:
                    self.ros.get_logger().error(f"camera_gone: {error}", throttle_duration_sec=1.0)
                    time.sleep(RETRY_S)
        finally:
            self.ros.destroy_node()
        return num_frames

    def clock_ns(self) -> int:
        """The network's clock."""
        return int(self.ros.get_clock().now().nanoseconds)

    def _is_listened_to(self) -> bool:
        has_network = all(
            self.ros.count_subscribers(topic) and self.ros.count_publishers(topic)
            for topic in (topics.DETECTIONS, topics.RANGES, topics.TRACKS)
        )
        is_whole = self.ros.count_publishers(topics.DETECTIONS) and not self.ros.count_subscribers(topics.TRACKS)
        return bool(self.ros.count_publishers(topics.BEAM) and (has_network or is_whole))
