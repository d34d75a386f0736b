"""A node goes on whatever happens, and says what; nothing is heard outside this machine."""

from __future__ import annotations

import dataclasses
import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from foreglow.beam.faults import GuardFault
from foreglow.beam.messages import LEVELS_IDS
from foreglow.config import preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.types import BeamCommand, BeamMode, Frame

pytest.importorskip("rclpy")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import qos_profile_sensor_data

from foreglow.runtime.live import LiveFault
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.environment import NUM_PARTICIPANTS, PARTICIPANT
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.join import Joined
from foreglow.runtime.ros2.node import (
    BAD_MESSAGE,
    INPUT_MISSING,
    STAMPED_AHEAD,
    UNHEARD,
    FrameNode,
    Receiver,
    make_ros_node,
)
from foreglow.runtime.ros2.output import BeamOutput
from foreglow.runtime.ros2.results import read_beam, read_timing, tracks_message
from foreglow.runtime.ros2.source import Due, FramePublisher
from foreglow.runtime.ros2.stages import BeamNode, PipelineNode, ProposalNode, Setting
from tests.linux import needs_processes
from tests.stand_ins import tracks_of

pytestmark = [
    pytest.mark.ros,
    pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning"),  # rclpy's own
    pytest.mark.usefixtures("domain"),
]


class Bench:
    """One node, and those who talk to it and listen, in this process."""

    def __init__(self, make: Callable[[], PipelineNode]) -> None:
        self.ros = make_ros_node("bench")
        self.node = make()
        self.commands: list[BeamCommand] = []
        self.states: list[DiagnosticStatus] = []
        self._publisher = FramePublisher(self.ros)
        self.ros.create_subscription(topics.TYPES[topics.BEAM], topics.BEAM, self._take, 100)
        self.ros.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, lambda message: self.states.extend(message.status), 100
        )
        self._receiver = Receiver(self.ros)

    def _take(self, message: Any) -> None:
        self.commands.append(read_beam(message, topics.BEAM)[1])

    def send(self, frame: Frame, change: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
        messages = self._publisher.messages(Due(frame, Header(self.node.clock_ns(), frame.sequence)))
        change(dict(messages))
        self._publisher.publish(messages)

    def wait(self, is_done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + 20
        while not is_done():
            assert time.monotonic() < end_s, [(one.mode, one.faults) for one in self.commands]
            self.node.spin_once()
            self._receiver.receive(0.0)

    def until(self, fault: str, frame: Frame, change: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
        """Sends frames until a command has this fault; empty for none."""
        count = len(self.commands)

        def is_done() -> bool:
            self.send(frame, change)
            return any(fault in one.faults if fault else not one.faults for one in self.commands[count:])

        self.wait(is_done)


@pytest.fixture
def frame() -> Frame:
    return next(itertools.islice(PVDN(shipped_drive()), 20, 21))


@pytest.fixture
def bench() -> Iterator[Bench]:
    config = preset("foreglow").commanding()
    guard = config.guard.model_copy(update={"max_age_s": 10.0, "max_same_images": 1000, "max_gap_s": 10.0})
    setting = Setting(config.model_copy(update={"guard": guard}), deadline_s=0.5)
    made = Bench(lambda: PipelineNode(setting))
    try:
        yield made
    finally:
        made.node.close()
        made.ros.destroy_node()
        rclpy.shutdown()


def test_what_stands_still_while_we_drive_is_found_by_our_speed(frame: Frame) -> None:
    """Without it, a node takes its own way to tell whether we drive, and the network finds other boxes than a run."""
    config = preset("foreglow").changed("standing", enabled=True)
    node = ProposalNode(Setting(config))
    try:
        header = Header(node.clock_ns())
        messages = dict(FramePublisher.messages(Due(frame, header)))
        for topic in (topics.ATTITUDE, topics.TWIST, topics.IMAGE):
            node._join.put(topic, header, messages[topic], time.monotonic_ns())
        joined = node._join.take(time.monotonic_ns())
        assert joined is not None
        seen = node.read(joined).motion
        assert seen is not None
        assert frame.motion is not None
        assert seen.speed_mps == frame.motion.speed_mps
        timings: list[Any] = []
        node._timing = SimpleNamespace(publish=timings.append)
        node._work_on(joined)
        assert {"proposals", "standing"} < read_timing(timings[0], topics.TIMING)[1].keys()
    finally:
        node.close()
        rclpy.shutdown()


def joined(node: FrameNode[Any], frame: Frame, *more: tuple[str, Callable[[Header], Any]]) -> Joined:
    """What a node is given of a frame that is taken now."""
    header = Header(node.clock_ns(), "S")
    messages = dict(FramePublisher.messages(Due(frame, header))) | {topic: make(header) for topic, make in more}
    return Joined(header, messages, time.monotonic_ns())


@pytest.mark.parametrize("error", [ZeroDivisionError(), SystemExit(2)], ids=["error", "exit"])
def test_a_stage_that_failed_begins_anew(frame: Frame, error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    """It went on with what the frame that failed had left half done; a plug-in that exits ended the network."""
    node = ProposalNode(Setting(preset("foreglow")))
    begun: list[int] = []
    monkeypatch.setattr(node, "reset", lambda: begun.append(node.num_frames))

    def fail(_: Any) -> None:
        raise error

    try:
        node._work_on(joined(node, frame))
        with monkeypatch.context() as patch:
            patch.setattr(node, "_proposer", SimpleNamespace(propose=fail))
            node._work_on(joined(node, frame))
        assert node.faults == {LiveFault.STAGE_FAILED}
        node._work_on(joined(node, frame))
        node._work_on(joined(node, frame))
        assert (begun, node.num_frames) == ([0, 1], 3)
    finally:
        node.close()
        rclpy.shutdown()


def test_images_that_came_while_a_node_was_busy_are_counted(frame: Frame) -> None:
    """Where an image is all of a frame, a later one pushed it out unseen: no node ever counted one as dropped."""
    ros, node = make_ros_node("camera"), ProposalNode(Setting(preset("foreglow")))
    publisher = FramePublisher(ros)

    def send() -> None:
        messages = dict(FramePublisher.messages(Due(frame, Header(node.clock_ns(), "S"))))
        publisher.publish([(topics.IMAGE, messages[topics.IMAGE])])

    try:
        end_s = time.monotonic() + 20
        while not node.num_frames:
            assert time.monotonic() < end_s
            send()
            node.spin_once()
        node._receiver.receive(0.2)  # what was still on its way
        node._join.take(time.monotonic_ns())
        before = node.num_dropped
        for _ in range(4):
            send()
            time.sleep(0.05)
        node.spin_once()
        assert (node.num_dropped - before, node.num_frames) == (3, 2)
    finally:
        node.close()
        ros.destroy_node()
        rclpy.shutdown()


def test_a_fault_that_lasts_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """All shared one line a second: messages stamped ahead, noted all the time, left none for the reason of others."""
    node, lines = ProposalNode(Setting(preset("foreglow"))), list[str]()
    try:
        with monkeypatch.context() as patch:
            patch.setattr(node, "ros", SimpleNamespace(get_logger=lambda: SimpleNamespace(error=lines.append)))
            for _ in range(3):
                node.note(STAMPED_AHEAD, ValueError("a"))
                node.note(BAD_MESSAGE, ValueError("b"))
        assert lines == [f"{STAMPED_AHEAD}: a", f"{BAD_MESSAGE}: b"]
    finally:
        node.close()
        rclpy.shutdown()


def test_a_beam_begins_anew_once_tracks_come_again(frame: Frame, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracker that was started again counts from 0: what was known of an old track was taken for a new one's."""
    node = BeamNode(Setting(preset("foreglow").commanding()))
    begun: list[int] = []
    monkeypatch.setattr(node, "resume", lambda: begun.append(node.num_frames))
    tracks = (topics.TRACKS, lambda header: tracks_message(header, tracks_of([])))
    try:
        for _ in range(2):
            node._work_on(joined(node, frame, tracks))
        node.idle(time.monotonic_ns() + 10**9)
        assert node.faults == {INPUT_MISSING}
        for _ in range(2):
            node._work_on(joined(node, frame, tracks))
        assert (begun, node.faults) == ([2], set())
    finally:
        node.close()
        rclpy.shutdown()


def test_whatever_happens_there_is_low_beam_and_it_recovers(
    bench: Bench, frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.wait(lambda: bool(bench.commands))
    assert bench.commands[0].faults == (INPUT_MISSING,)
    assert bench.commands[0].mode == BeamMode.LOW
    bench.until("", frame)

    def with_short_rows(messages: dict[str, Any]) -> None:
        messages[topics.IMAGE].step = 7

    bench.until(BAD_MESSAGE, frame, with_short_rows)
    assert BAD_MESSAGE in bench.node.faults
    bench.until("", frame)
    with monkeypatch.context() as patch:
        patch.setattr(bench.node._pipeline, "step", lambda *_, **__: 1 / 0)
        bench.until(LiveFault.STAGE_FAILED, frame)
    bench.until("", frame)
    with monkeypatch.context() as patch:
        patch.setattr(bench.node._pipeline, "step", lambda *_, **__: 1 / 0)
        patch.setattr(bench.node._pipeline, "reset", lambda: 1 / 0)
        bench.until(LiveFault.STAGE_FAILED, frame)
        bench.until(LiveFault.STAGE_FAILED, frame)
    bench.until("", frame)
    assert not bench.node.faults
    bench.until(GuardFault.DAMAGED, dataclasses.replace(frame, is_damaged=True))
    bench.until("", frame)
    other = dataclasses.replace(frame, sequence="other")
    bench.until("", other)
    count = len(bench.commands)
    bench.wait(lambda: any(INPUT_MISSING in one.faults for one in bench.commands[count:]))
    bench.until("", frame)
    messages = {state.message for state in bench.states}
    assert {"all is well", INPUT_MISSING, BAD_MESSAGE, LiveFault.STAGE_FAILED} <= messages
    assert {state.name for state in bench.states} == {"foreglow: pipeline"}


def with_no_time(message: Any) -> None:
    message.header.stamp.nanosec = 2_000_000_000


def with_a_long_name(message: Any) -> None:
    message.header.frame_id = "S" * 1000


def test_a_header_that_cannot_be_read_is_low_beam_at_once(bench: Bench, frame: Frame) -> None:
    """Such a message belongs to no frame, and without it no frame is complete: low beam came by the deadline."""
    for topic in (topics.IMAGE, topics.CAMERA_INFO, topics.TWIST):
        for spoil in (with_no_time, with_a_long_name):
            bench.until("", frame)
            count = len(bench.commands)

            def spoilt(messages: dict[str, Any], topic: str = topic, spoil: Callable[[Any], None] = spoil) -> None:
                spoil(messages[topic])

            bench.until(BAD_MESSAGE, frame, spoilt)
            refused = next(one for one in bench.commands[count:] if one.faults)
            assert (refused.mode, refused.faults) == (BeamMode.LOW, (BAD_MESSAGE,))
            assert BAD_MESSAGE in bench.node.faults
    bench.until("", frame)
    assert not bench.node.faults


@pytest.mark.parametrize("topic", [topics.TWIST, topics.ATTITUDE, topics.REPORTED, topics.DAMAGE, topics.ROAD])
def test_a_message_that_is_stamped_ahead_is_low_beam_and_never_believed(bench: Bench, frame: Frame, topic: str) -> None:
    """A speed from a clock that was d s ahead kept the light on until d s after its publisher had died."""
    reported = dataclasses.replace(frame, is_reported=False)
    bench.until("", reported)

    def by_a_fast_clock(messages: dict[str, Any]) -> None:
        messages[topic].header.stamp.sec += 1

    count = len(bench.commands)
    bench.until(STAMPED_AHEAD, reported, by_a_fast_clock)
    assert next(one for one in bench.commands[count:] if STAMPED_AHEAD in one.faults).mode == BeamMode.LOW
    bench.wait(lambda: any(state.message == STAMPED_AHEAD for state in bench.states))
    told = next(state for state in bench.states if state.message == STAMPED_AHEAD)
    assert {value.key: value.value for value in told.values}["stamped ahead"].startswith(f"{topic} ")
    bench.until("", reported)
    assert not bench.node.faults


def test_no_light_by_a_speed_whose_time_has_come(bench: Bench, frame: Frame) -> None:
    bench.until("", frame)
    header = Header(bench.node.clock_ns() + 1_000_000_000, frame.sequence)
    early = dict(FramePublisher.messages(Due(frame, header)))
    bench._publisher.publish([(topics.TWIST, early[topics.TWIST])])
    bench.wait(lambda: STAMPED_AHEAD in bench.node.faults)
    bench.wait(lambda: bench.node.clock_ns() > header.timestamp_ns)
    count = len(bench.commands)

    def without_speed() -> bool:
        messages = FramePublisher.messages(Due(frame, Header(bench.node.clock_ns(), frame.sequence)))
        bench._publisher.publish(message for message in messages if message[0] != topics.TWIST)
        return sum(INPUT_MISSING not in one.faults for one in bench.commands[count:]) > 2

    bench.wait(without_speed)
    assert all(one.mode == BeamMode.LOW for one in bench.commands[count:])
    assert any(GuardFault.NO_SPEED in one.faults for one in bench.commands[count:])


@needs_processes
def test_a_publisher_that_nobody_hears_is_low_beam(bench: Bench, frame: Frame) -> None:
    """A decoder that says with best effort that images are damaged was never heard, and the light stayed on."""
    bench.until("", frame)
    publisher = bench.ros.create_publisher(topics.TYPES[topics.DAMAGE], topics.DAMAGE, qos_profile_sensor_data)
    bench.until(UNHEARD, frame)
    assert bench.commands[-1].mode == BeamMode.LOW
    publisher.destroy()
    bench.until("", frame)
    bench.wait(lambda: any(state.message == UNHEARD for state in bench.states))


OTHER_TYPE = """
import rclpy
from std_msgs.msg import Bool
from foreglow.runtime.ros2.node import make_ros_node
node = make_ros_node("decoder")
publisher = node.create_publisher(Bool, "camera/damage", 10)
input()
node.destroy_node()
rclpy.shutdown()
"""


@needs_processes
def test_a_publisher_of_another_type_is_low_beam(bench: Bench, frame: Frame) -> None:
    """Nothing that it says is delivered either, such as that images are damaged: the light stayed on."""
    bench.until("", frame)
    other = {PARTICIPANT: str((int(os.environ[PARTICIPANT]) + 1) % NUM_PARTICIPANTS)}
    with subprocess.Popen(
        [sys.executable, "-c", OTHER_TYPE], stdin=subprocess.PIPE, env={**os.environ, **other}
    ) as decoder:
        bench.until(UNHEARD, frame)
        assert bench.commands[-1].mode == BeamMode.LOW
        decoder.communicate(b"\n")
    bench.until("", frame)


def test_no_socket_is_open_to_others(bench: Bench, frame: Frame) -> None:
    bench.until("", frame)
    own = {link.readlink().name for link in Path("/proc/self/fd").iterdir() if link.is_symlink()}
    addresses = set()
    for name in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path("/proc/self/net", name).read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if f"socket:[{fields[9]}]" in own:
                addresses.add(socket.inet_ntoa(bytes.fromhex(fields[1].split(":")[0])[3::-1]))
    assert addresses
    assert addresses == {"127.0.0.1", DISCOVERY_GROUP}
    assert interfaces_in(DISCOVERY_GROUP) == {"lo"}


DISCOVERY_GROUP = "239.255.0.1"


def interfaces_in(group: str) -> set[str]:
    """The interfaces on which this machine has joined a multicast group."""
    interface, found = "", set()
    for line in Path("/proc/net/igmp").read_text(encoding="ascii").splitlines()[1:]:
        fields = line.split()
        if not line.startswith("\t"):
            interface = fields[1]
        elif socket.inet_ntoa(bytes.fromhex(fields[0])[::-1]) == group:
            found.add(interface)
    return found


def test_commands_go_onto_the_bus(frame: Frame) -> None:
    can = pytest.importorskip("can")
    from foreglow.runtime.can_output import CanBus

    with can.Bus(interface="virtual", channel="ros2", fd=True) as bus:
        sink = CanBus("virtual:ros2")
        made = Bench(lambda: PipelineNode(Setting(preset("foreglow").commanding(), can=sink)))
        try:
            made.until("", dataclasses.replace(frame, sequence="S"))
        finally:
            made.node.close()
            made.ros.destroy_node()
            rclpy.shutdown()
        identifiers = {bus.recv(1.0).arbitration_id for _ in range(5)}
    assert set(LEVELS_IDS) < identifiers


def test_a_bus_that_failed_is_told_to_the_guard() -> None:
    """So that light comes back slowly when the bus does."""

    class Bus:
        is_broken = True

        def send(self, _: BeamCommand) -> None:
            if self.is_broken:
                raise OSError("can0: buffer full")

    bus: Any = Bus()
    made = Bench(lambda: PipelineNode(Setting(preset("foreglow").commanding())))
    try:
        output, low = BeamOutput(made.node, preset("foreglow").commanding(), can=bus), BeamCommand.low(0, 80)
        output.send(Header(0), low)
        assert output.arrived() == output.arrived() == tuple(made.node._said_ns) == (LiveFault.BUS,)  # and logged
        bus.is_broken = False
        output.send(Header(0), low)
        assert output.arrived() == ()
    finally:
        made.node.close()
        made.ros.destroy_node()
        rclpy.shutdown()


def test_a_parameter_of_ros_that_is_of_another_kind() -> None:
    """It was an internal error."""
    with pytest.raises(ValueError, match=r"ROS 2 cannot begin: .*use_sim_time.* expecting type 'BOOL'"):
        make_ros_node("tracking", ["--ros-args", "-p", "use_sim_time:=banana"])
