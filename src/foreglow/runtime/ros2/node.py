"""The base of all compute nodes: subscribes to a frame's topics, works on the newest frame, reports faults."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.exceptions import ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from foreglow.plugins import words_of
from foreglow.runtime.live import LiveFault
from foreglow.runtime.memory import settled_memory
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header, header_message, read_header
from foreglow.runtime.ros2.join import Join, Joined
from foreglow.runtime.ros2.results import timing_message
from foreglow.runtime.ros2.supervisor import HangWatch
from foreglow.stopwatch import Stopwatch

Inputs = TypeVar("Inputs")
"""What a node needs of a frame, read from the frame's messages."""

BAD_MESSAGE = "bad_message"
"""Fault: a message could not be read."""
INPUT_MISSING = "input_missing"
"""Fault: no input came in time."""
UNHEARD = "unheard_publisher"
"""Fault: someone sends on a topic with best effort where we need reliable messages, or messages of another type, and we
get none of those."""
STAMPED_AHEAD = "stamped_ahead"
"""Fault: a message is stamped later than ROS time, so nobody knows of when it is; it was not used."""

REPORT_NS = 1_000_000_000
"""A node reports its state once in this time, and whenever its faults change."""

IDLE_S, WAITING_S = 0.02, 0.002
"""Longest wait for messages: while nothing is due, and while a complete frame waits for a sample."""


MAX_MESSAGES = 100
"""Taken from one subscription at once."""

MAX_MISSED = 1000
"""More messages than these between two are none that were missed: the two are of different publishers."""


class Receiver:
    """Receives all waiting messages of a node at once, and calls their callbacks, subscription by subscription.

    An executor of rclpy also serves services, timers and guard conditions, takes one message a round, and builds its
    wait set anew for each round. Like `rclpy.wait_for_message`, this waits for subscriptions and nothing else.

    Attributes:
        num_missed: By topic, how many messages were lost, or pushed out of the history by later ones, between two that
            came; 0 where the middleware does not number them.
    """

    def __init__(self, node: Any) -> None:
        """A receiver for an rclpy node that already has all its subscriptions."""
        self._subscriptions = list(node.subscriptions)
        self._numbers: dict[str, int] = {}  # the publisher's, of the latest message of each topic
        self.num_missed: Counter[str] = Counter()
        count = len(self._subscriptions)
        self._waiting = rclpy_implementation.WaitSet(count, 0, 0, 0, 0, 0, node.context.handle)

    def receive(self, timeout_s: float) -> None:
        """Waits for messages, `timeout_s` at most, and calls the callbacks for all that have arrived."""
        waiting = self._waiting
        waiting.clear_entities()
        for subscription in self._subscriptions:
            waiting.add_subscription(subscription.handle)
        waiting.wait(max(0, round(timeout_s * 1e9)))
        ready = set(waiting.get_ready_entities("subscription"))
        for subscription in self._subscriptions:
            if subscription.handle.pointer in ready:
                for _ in range(MAX_MESSAGES):
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                    if taken is None:
                        break
                    message, info = taken
                    self._note_number(subscription.topic_name, info.get("publication_sequence_number"))
                    subscription.callback(message)

    def _note_number(self, topic: str, number: int | None) -> None:
        if number is not None:
            num_missed = number - self._numbers.get(topic, number) - 1
            if 0 < num_missed <= MAX_MISSED:
                self.num_missed[topic] += num_missed
            self._numbers[topic] = number


def make_ros_node(name: str, ros_arguments: Sequence[str] = ()) -> Any:
    """A plain node of rclpy; initialises rclpy if need be.

    It serves neither parameters, as there are none, nor descriptions of types: each of these services would add half
    a dozen entities to every wait.

    Raises:
        ValueError: If ROS 2 does not begin with these arguments, or in this environment.
    """
    if not rclpy.ok():
        try:
            rclpy.init(args=["foreglow", *ros_arguments], signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # such as of a folder for logs that cannot be made
            raise ValueError(f"ROS 2 cannot begin: {' '.join(str(error).split())}") from error
    no_service = Parameter("start_type_description_service", value=False)
    try:
        return rclpy.create_node(name, start_parameter_services=False, parameter_overrides=[no_service])
    except ParameterException as error:  # such as of `use_sim_time` that is no truth value
        raise ValueError(f"ROS 2 cannot begin: {' '.join(str(error).split())}") from error


class FrameNode(ABC, Generic[Inputs]):
    """A node that works on one frame at a time, always the newest complete one, and goes on after any error.

    Attributes:
        faults: Names of the faults that are present now.
        num_frames: Frames that were worked on without an error.
    """

    def __init__(
        self,
        name: str,
        exact: Sequence[str],
        sampled: Sequence[str] = (),
        *,
        ros_arguments: Sequence[str] = (),
        patience_s: float | None = None,
    ) -> None:
        """Joins the network.

        Args:
            name: Name of the node.
            exact: Topics on which every frame has a message with the frame's own header. The first one is its main
                input, of which only the newest message is kept; one that is there twice counts once.
            sampled: Topics with times of their own; a frame takes the latest message that is not later than itself.
            ros_arguments: The command line from `--ros-args` on: names, namespace, remappings.
            patience_s: How long a frame waits for messages on sampled topics; None for `Join.PATIENCE_NS`.
        """
        self.ros = make_ros_node(name, ros_arguments)
        self.name = name
        self.faults: set[str] = set()
        self.num_frames = 0
        exact = tuple(dict.fromkeys(exact))
        patience_ns = Join.PATIENCE_NS if patience_s is None else round(patience_s * 1e9)
        self._join = Join(exact, sampled, fast=topics.FAST, patience_ns=patience_ns, clock_ns=self.clock_ns)
        self._sequence: str | None = None
        self._has_failed = False
        self._stopwatch = Stopwatch()
        self._reported: tuple[int, tuple[str, ...]] = (0, ())
        self._exact = exact
        self._subscribed: dict[str, tuple[str, bool]] = {}  # resolved topics: type, and whether it is to be reliable
        self._said_ns: dict[str, int] = {}  # when each fault was logged last
        self._looked_ns = 0
        self._slowest_ms: dict[str, float] = {}
        self._timing = self.publisher(topics.TIMING)
        self._diagnostics = self.ros.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, topics.NUM_KEPT)
        for topic in (*sampled, *exact[1:], exact[0]):  # messages that are ready together are taken in this order
            self._subscribe(topic, 1 if topic == exact[0] else topics.NUM_KEPT)
        self._receiver = Receiver(self.ros)

    def publisher(self, topic: str) -> Any:
        """A publisher on one of `topics.TYPES`."""
        return self.ros.create_publisher(topics.TYPES[topic], topic, topics.publisher_quality(topic))

    @abstractmethod
    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""

    def resume(self) -> None:
        """Begins anew after a frame that failed: a stage may have taken in only a part of it."""
        self.reset()

    @abstractmethod
    def read(self, joined: Joined) -> Inputs:
        """The inputs of a frame, from its messages.

        Raises:
            ValueError: If a message cannot be used; the error names topic and field.
        """

    @abstractmethod
    def step(self, header: Header, inputs: Inputs, stopwatch: Stopwatch) -> None:
        """Works on one frame and publishes the results; begins a part of the stopwatch for each stage, then `send`."""

    def failed(self, header: Header, fault: str) -> None:
        """Called when a frame could not be worked on because of `fault`."""

    def refused(self) -> None:
        """Called when a message could not even be given to a frame, as its header cannot be read: `BAD_MESSAGE`."""

    def idle(self, now_ns: int) -> None:
        """Called after every wait for messages; `now_ns` is the steady clock's time."""

    def clock_ns(self) -> int:
        """The frames' clock: ROS time."""
        return int(self.ros.get_clock().now().nanoseconds)

    @property
    def num_dropped(self) -> int:
        """Frames of which something came, or of whose only message we know, but that were not worked on."""
        only = self.ros.resolve_topic_name(self._exact[0]) if len(self._exact) == 1 else ""
        return self._join.num_dropped + self._receiver.num_missed[only]

    @property
    def stage(self) -> str:
        """The part of a frame's work that is under way."""
        return self._stopwatch.part or "between the stages"

    def spin(self, should_stop: Callable[[], bool], limit_s: float = math.inf) -> None:
        """Works until `should_stop` says so, or ROS is shut down; ends the process where a frame takes `limit_s`."""
        try:
            with settled_memory(), HangWatch(limit_s, lambda: f"{self.name}: {self.stage}") as watch:
                while rclpy.ok() and not should_stop():
                    watch.begin()
                    self.spin_once()
        finally:
            self.close()

    def spin_once(self) -> None:
        """Receives messages, and works on a frame if one is complete."""
        is_waiting = self._join.is_waiting
        self._receiver.receive(WAITING_S if is_waiting else IDLE_S)
        joined = self._join.take(time.monotonic_ns())
        self._look_for_ahead(time.monotonic_ns())
        if joined is not None:
            self._work_on(joined)
        self.idle(time.monotonic_ns())
        self._look_for_unheard(time.monotonic_ns())
        self._report()

    def close(self) -> None:
        """Leaves the network."""
        self.ros.destroy_node()

    def _subscribe(self, topic: str, depth: int) -> None:
        def take(message: Any) -> None:
            try:
                header = read_header(message.header, topic)
            except ValueError as error:
                self.note(BAD_MESSAGE, error)
                self.refused()
                return
            self._join.put(topic, header, message, time.monotonic_ns())

        quality = topics.subscriber_quality(topic, depth)
        subscription = self.ros.create_subscription(topics.TYPES[topic], topic, take, quality)
        is_reliable = quality.reliability == ReliabilityPolicy.RELIABLE
        self._subscribed[subscription.topic_name] = topics.type_name(topics.TYPES[topic]), is_reliable

    def _look_for_ahead(self, now_ns: int) -> None:
        """Looks whether messages are stamped ahead of ROS time: what they say, such as damage, is not known in time."""
        ahead_s = self._join.ahead_s(now_ns)
        for topic, by_s in ahead_s.items():
            limit = f"expected at most {Join.AHEAD_NS / 1e9:g} s later than ROS time, got {by_s:.2f} s"
            self.note(STAMPED_AHEAD, ValueError(f"{topic}: header.stamp: {limit}"))
        if not ahead_s:
            self.faults.discard(STAMPED_AHEAD)

    def _look_for_unheard(self, now_ns: int) -> None:
        """Looks once a second whether all that is sent on our topics can reach us: ROS 2 drops the rest silently."""
        if now_ns - self._looked_ns < REPORT_NS:
            return
        self._looked_ns = now_ns
        unheard = next(self._unheard(), None)
        if unheard is not None:
            self.note(UNHEARD, ValueError(unheard))
        else:
            self.faults.discard(UNHEARD)

    def _unheard(self) -> Iterator[str]:
        """What is wrong with each publisher of whose messages none comes here."""
        for topic, (expected, is_reliable) in self._subscribed.items():
            for publisher in self.ros.get_publishers_info_by_topic(topic):
                if publisher.topic_type != expected:
                    yield f"{topic}: expected publishers of {expected}, got {publisher.topic_type}"
                elif is_reliable and publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                    yield f"{topic}: expected publishers of reliable messages, got best effort"

    def _work_on(self, joined: Joined) -> None:
        header = joined.header
        begun_ns = time.monotonic_ns()
        since_exposure_ms = (self.clock_ns() - header.timestamp_ns) / 1e6
        stopwatch, fault = Stopwatch(), str(LiveFault.STAGE_FAILED)
        self._stopwatch = stopwatch
        try:
            if header.sequence != self._sequence:
                self.reset()
                self._sequence = header.sequence
            elif self._has_failed:
                self.resume()
            self._has_failed = False
            stopwatch.begin("decode")
            fault = BAD_MESSAGE
            inputs = self.read(joined)
            stopwatch.end()
            fault = LiveFault.STAGE_FAILED
            self.step(header, inputs, stopwatch)
            stopwatch.end()
        except (Exception, SystemExit) as error:  # whatever a plug-in raises: the node goes on, or commands low beam
            self._has_failed = True
            self.note(fault, error)
            self.failed(header, fault)
            return
        self.faults.difference_update((BAD_MESSAGE, LiveFault.STAGE_FAILED))
        self.num_frames += 1
        times_ms = stopwatch.times_ms
        times_ms["wait"] = (begun_ns - joined.received_ns) / 1e6
        times_ms["received"] = since_exposure_ms - times_ms["wait"]
        times_ms["done"] = since_exposure_ms + (time.monotonic_ns() - begun_ns) / 1e6
        for name, value in times_ms.items():
            self._slowest_ms[name] = max(value, self._slowest_ms.get(name, 0.0))
        self._timing.publish(timing_message(Header(header.timestamp_ns, self.name), times_ms))

    def note(self, fault: str, error: BaseException) -> None:
        """Adds a fault, and logs its cause, at most once a second."""
        self.faults.add(fault)
        now_ns = time.monotonic_ns()
        if now_ns - self._said_ns.get(fault, -REPORT_NS) >= REPORT_NS:  # each for itself: one that lasts hides no other
            self._said_ns[fault] = now_ns
            self.ros.get_logger().error(f"{fault}: {words_of(error) or type(error).__name__}")

    def _report(self) -> None:
        """Publishes the node's state once a second, and whenever its faults change."""
        now_ns, faults = time.monotonic_ns(), tuple(sorted(self.faults))
        reported_ns, reported = self._reported
        if faults == reported and now_ns - reported_ns < REPORT_NS:
            return
        self._reported = now_ns, faults
        values = {
            "faults": " ".join(faults),
            "frames": str(self.num_frames),
            "dropped": str(self.num_dropped),
            "waiting for": " ".join(self._join.missing),
            "stamped ahead": ", ".join(f"{topic} {by_s:.2f} s" for topic, by_s in self._join.ahead_s(now_ns).items()),
            **{f"slowest {name} ms": f"{value:.2f}" for name, value in self._slowest_ms.items()},
        }
        self._slowest_ms.clear()
        self._diagnostics.publish(diagnostics(self.name, Header(self.clock_ns()), faults, values))


def diagnostics(name: str, header: Header, faults: Sequence[str], values: Mapping[str, str]) -> DiagnosticArray:
    """A node's state as a message for ROS's diagnostic tools."""
    status = DiagnosticStatus(
        level=DiagnosticStatus.ERROR if faults else DiagnosticStatus.OK,
        name=f"foreglow: {name}",
        message=", ".join(faults) or "all is well",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=header_message(header), status=[status])
