"""The source node: publishes the frames of a camera, or of a data set, recording or video at their own rate."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from foreglow.plugins import words_of
from foreglow.runtime.live import LiveSource
from foreglow.runtime.live.sources import has_jumped
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.input_messages import (
    attitude_message,
    camera_info_message,
    damage_message,
    image_message,
    mount_message,
    reported_message,
    road_message,
    twist_message,
)
from foreglow.runtime.ros2.node import make_ros_node
from foreglow.types import Frame

FRAME_ID = "camera"
"""The frame_id of a sequence without a name, as a message needs one."""

PAUSE_NS = 500_000_000
"""Pause between two sequences, and before the first frame."""

RETRY_S = 1.0
"""Pause between two attempts to open a camera."""

CLOCK_STEP_NS = 1_000_000_000
"""A network's clock that gains or loses more on this machine's steady clock, between two frames, was set."""

OF_THE_CAR = frozenset((topics.TWIST, topics.ATTITUDE, topics.ROAD))
"""What a camera knows nothing of. That it is unknown would count in place of what the car's own nodes tell."""


class Due(NamedTuple):
    """A frame, and the header of its messages, whose time is when the frame is due."""

    frame: Frame
    header: Header


class FramePublisher:
    """Publishes frames: what goes with an image first, then the image."""

    def __init__(self, ros: Any) -> None:
        """Makes the publishers of an rclpy node."""
        self._publishers = {
            name: ros.create_publisher(topics.TYPES[name], name, topics.publisher_quality(name))
            for name in topics.INPUTS
        }

    @staticmethod
    def messages(due: Due) -> list[tuple[str, Any]]:
        """The frame's messages with their topics, in the order of publishing."""
        frame, header = due
        size_px = (frame.width_px, frame.height_px)
        sent: list[tuple[str, Any]] = [(topics.CAMERA_INFO, camera_info_message(header, size_px, frame.camera))]
        if frame.camera is not None:
            sent.append((topics.MOUNT, mount_message(header, frame.camera)))
        sent += [
            (topics.TWIST, twist_message(header, frame.motion)),
            (topics.ATTITUDE, attitude_message(header, frame.motion)),
            (topics.ROAD, road_message(header, frame.road)),
            (topics.DAMAGE, damage_message(header, frame.is_damaged)),
        ]
        if frame.is_reported is not None:
            sent.append((topics.REPORTED, reported_message(header, frame.is_reported)))
        return [*sent, (topics.IMAGE, image_message(header, frame.image))]

    def publish(self, messages: Iterable[tuple[str, Any]]) -> None:
        """Publishes messages on their topics."""
        for topic, message in messages:
            self._publishers[topic].publish(message)


class NetworkClock:
    """The network's clock, and whether it was set."""

    def __init__(self, now_ns: Callable[[], int], steady_ns: Callable[[], int] = time.monotonic_ns) -> None:
        """Begins to compare the clock with a steady one."""
        self.now_ns = now_ns
        self.steady_ns = steady_ns
        self.accept()

    def was_set(self) -> bool:
        """Whether it was set since the last `accept`."""
        return abs(self.now_ns() - self.steady_ns() - self._ahead_ns) > CLOCK_STEP_NS

    def accept(self) -> None:
        """Goes on from the time that it has now."""
        self._ahead_ns = self.now_ns() - self.steady_ns()


def timed(frames: Iterable[Frame], clock: NetworkClock, *, speed: float = 1.0) -> Iterator[Due]:
    """Each frame with a new timestamp, as if it were taken now.

    All timestamps of a sequence are shifted by the same amount, so that the intervals between frames, and with them all
    results, stay the same. A sequence begins `PAUSE_NS` after the previous one, or after it is asked for; so does
    a frame at which time `has_jumped`, as in `live`, and the next frame after the clock was set.

    Args:
        frames: The frames, in order of time within each sequence.
        clock: The network's.
        speed: Replay so many times as fast; other than 1 it also shortens the intervals between timestamps.
    """
    latest_ns = clock.now_ns()
    for number, (_, sequence) in enumerate(itertools.groupby(frames, key=lambda frame: frame.sequence)):
        zero_ns: tuple[int, int] | None = None  # the same moment by the frames' times, and by the network's
        before_ns = 0
        for frame in sequence:
            if clock.was_set():
                clock.accept()
                zero_ns, latest_ns = None, clock.now_ns()
            if zero_ns is None or has_jumped(frame.timestamp_ns - before_ns):
                zero_ns = frame.timestamp_ns, max(latest_ns, clock.now_ns()) + PAUSE_NS
            (first_ns, begin_ns), before_ns = zero_ns, frame.timestamp_ns
            passed_ns = frame.timestamp_ns - first_ns
            latest_ns = begin_ns + (passed_ns if speed == 1.0 else round(passed_ns / speed))
            yield Due(frame, Header(latest_ns, sequence_name(frame.sequence, number)))


def sequence_name(sequence: str, number: int) -> str:
    """The frame_id of the `number`-th sequence; it always differs from the previous one, also when it is repeated.

    >>> sequence_name("S00003", 0), sequence_name("S00003", 1)
    ('S00003', 'S00003#1')
    """
    return (sequence or FRAME_ID) + (f"#{number}" if number else "")


def repeated(frames: Iterable[Frame], limit: int | None = None, *, is_endless: bool = False) -> Iterator[Frame]:
    """The first `limit` frames, repeated for ever if `is_endless`, each time under new names of sequences."""
    for number in itertools.count():
        num_frames = 0
        for frame in itertools.islice(frames, limit):
            num_frames += 1
            yield dataclasses.replace(frame, sequence=f"{frame.sequence}+{number}") if number else frame
        if not (is_endless and num_frames):
            return


class Player:
    """The node `source`."""

    def __init__(self, should_stop: Callable[[], bool], ros_arguments: Sequence[str] = ()) -> None:
        """Joins the network, until `play` or `stream` returns.

        Raises:
            ValueError: If ROS time is that of a simulation, by which no frame would ever be due.
        """
        self.ros = make_ros_node("source", ros_arguments)
        if self.ros.get_parameter("use_sim_time").value:
            self.ros.destroy_node()
            raise ValueError("use_sim_time: expected false for a source, which plays by this machine's clock, got true")
        self._publisher = FramePublisher(self.ros)
        self._should_stop = should_stop

    def wait(self) -> None:
        """Waits until the network is complete: a node publishes beam commands, and every stage has a subscriber."""
        while not (self._should_stop() or self._is_listened_to()):
            time.sleep(0.05)
        time.sleep(PAUSE_NS / 1e9)  # discovered nodes still have to be connected

    def play(self, frames: Iterable[Frame], *, speed: float = 1.0) -> int:
        """Publishes `frames` when they are due, or at once if they are late; returns how many.

        The frame that waits while the network's clock is set is left out, as its time is of the clock before.
        """
        num_frames = 0
        clock = NetworkClock(self.clock_ns)
        try:
            for due in timed(frames, clock, speed=speed):
                messages = self._publisher.messages(due)
                due_ns = clock.steady_ns() + due.header.timestamp_ns - clock.now_ns()
                while not self._should_stop() and (left_ns := due_ns - clock.steady_ns()) > 0:
                    time.sleep(min(left_ns / 1e9, 0.05))
                if self._should_stop():
                    break
                if clock.was_set():
                    continue
                self._publisher.publish(messages)
                num_frames += 1
        finally:
            self.ros.destroy_node()
        return num_frames

    def stream(self, camera: LiveSource, *, limit: int | None = None) -> int:
        """Publishes the frames of a live camera as they arrive, stamped with their exposure; returns how many.

        Nothing `OF_THE_CAR` is published with them. A camera that is lost is opened again, as often as necessary.
        """
        num_frames = 0
        try:
            while not (self._should_stop() or num_frames == limit):
                try:
                    for frame in camera:
                        stamp_ns = self.clock_ns() - (camera.now_ns() - frame.timestamp_ns)
                        due = Due(frame, Header(stamp_ns, sequence_name(frame.sequence, 0)))
                        messages = self._publisher.messages(due)
                        self._publisher.publish(one for one in messages if one[0] not in OF_THE_CAR)
                        num_frames += 1
                        if self._should_stop() or num_frames == limit:
                            return num_frames
                    reason = "it has ended"
                except Exception as error:  # a camera's driver raises what it likes
                    reason = words_of(error) or type(error).__name__
                self.ros.get_logger().error(f"camera_gone: {reason}", throttle_duration_sec=1.0)
                time.sleep(RETRY_S)
        finally:
            self.ros.destroy_node()
        return num_frames

    def clock_ns(self) -> int:
        """The network's clock."""
        return int(self.ros.get_clock().now().nanoseconds)

    def _is_listened_to(self) -> bool:
        has_network = all(
            self._num_subscribers(topic) and self._num_publishers(topic)
            for topic in (topics.PROPOSALS, topics.DETECTIONS, topics.RANGES, topics.TRACKS)
        )
        is_whole = self._num_publishers(topics.DETECTIONS) and not self._num_subscribers(topics.TRACKS)
        return bool(self._num_publishers(topics.BEAM) and (has_network or is_whole))

    def _num_publishers(self, topic: str) -> int:
        return int(self.ros.count_publishers(self.ros.resolve_topic_name(topic)))  # rclpy does not remap what it counts

    def _num_subscribers(self, topic: str) -> int:
        return int(self.ros.count_subscribers(self.ros.resolve_topic_name(topic)))
