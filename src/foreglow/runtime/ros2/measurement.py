"""Runs the network over frames, each node in its own process, and records the results and times of each frame."""

from __future__ import annotations

import contextlib
import itertools
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.runtime.ros2 import STAGE_NODES, topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.node import Receiver, make_ros_node
from foreglow.runtime.ros2.results import read_beam, read_detections, read_ranges, read_timing, read_tracks
from foreglow.runtime.ros2.source import Due, FramePublisher, NetworkClock, timed
from foreglow.runtime.ros2.supervisor import Process
from foreglow.types import BeamCommand, Detections, Frame, Ranges, Tracks

WHOLE = ("pipeline",)
"""A network whose stages are all in one node."""

WARM_UP = "warm-up"
START_S, LAST_S, STEP_S = 120.0, 1.0, 5.0
"""Longest waits: for the network's first answer, for the last frame's, and for each frame's when in step."""


@dataclass
class Answer:
    """The network's results for one frame; None and empty where no message was received.

    Attributes:
        header: The header of the frame's messages.
        sent_ms: When the image was published, since exposure.
        times_ms: The times of `results.TIMING` by node.
        detections: The scored boxes.
        ranges: Their ranges.
        tracks: The tracks.
        beam: The command.
    """

    header: Header
    sent_ms: float = 0.0
    times_ms: dict[str, dict[str, float]] = field(default_factory=dict)
    detections: Detections | None = None
    ranges: Ranges | None = None
    tracks: Tracks | None = None
    beam: BeamCommand | None = None

    def latency_ms(self, last: str) -> float | None:
        """From exposure until the node `last` had sent its command; None if the frame was lost."""
        return self.times_ms[last]["done"] if last in self.times_ms else None


@dataclass(frozen=True)
class Command:
    """A beam command that was received.

    Attributes:
        received_ns: When, by the wall clock, like the headers' stamps.
        beam: The command.
    """

    received_ns: int
    beam: BeamCommand


class Network:
    """The compute nodes, each in a process of its own; this process publishes the frames and records the results.

    Attributes:
        processes: The processes by node; one that dies is started again.
        commands: All commands that were received, in order, also those that belong to no frame.
    """

    def __init__(
        self,
        config: PipelineConfig,
        nodes: Sequence[str] = STAGE_NODES,
        *,
        options: Mapping[str, Sequence[str]] | None = None,
        keeps_results: bool = True,
    ) -> None:
        """Starts the processes; call `environment.prepare` and set `ROS_DOMAIN_ID` before.

        Args:
            config: The pipeline's configuration.
            nodes: The nodes to start; the measuring process is one more, the source.
            options: Further command-line options by node.
            keeps_results: Whether boxes, ranges and tracks are recorded, too; beam commands always are.
        """
        self.processes: dict[str, Process] = {}
        self.commands: list[Command] = []
        self._config = config
        self._keeps_results = keeps_results
        self._answers: dict[Header, Answer] = {}
        self._by_time: dict[int, Answer] = {}
        self._closing = contextlib.ExitStack()
        try:
            folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory(prefix="foreglow-")))
            path = folder / "config.toml"
            path.write_text(config_to_toml(config), encoding="utf-8")
            for name in nodes:
                arguments = [name, "--config", str(path), *(options or {}).get(name, ())]
                self.processes[name] = Process(name, arguments)
                self._closing.callback(self.processes[name].wait)
                self._closing.callback(self.processes[name].end)
            self._join()
        except BaseException:
            self._closing.close()
            raise

    def __enter__(self) -> Network:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    def run(
        self,
        frames: Iterable[Frame],
        *,
        speed: float = 1.0,
        is_in_step: bool = False,
        watch: Callable[[int], None] = lambda _: None,
    ) -> list[Answer]:
        """Publishes the frames at their own rate, and returns the results in the same order.

        Args:
            frames: The frames of one or more sequences.
            speed: Replay so many times as fast.
            is_in_step: Whether each frame waits for the previous frame's command, so that none is lost on a busy
                machine.
            watch: Called with each frame's index before it is sent.
        """
        answers = []
        for index, due in enumerate(timed(frames, NetworkClock(self.clock_ns), speed=speed)):
            watch(index)
            answers.append(self._send(due))
            if is_in_step:
                self._spin_until(lambda: self._is_done(answers[-1]), STEP_S)
        if answers:
            self._spin_until(lambda: self._is_done(answers[-1]), LAST_S)
        return answers

    def warm_up(self, frame: Frame, num_frames: int = 5) -> None:
        """Sends `frame` until the network has answered it `num_frames` times.

        Raises:
            TimeoutError: If that takes more than `START_S`.
        """
        numbers = itertools.count()
        end_s, done = time.monotonic() + START_S, 0
        while done < num_frames:
            if time.monotonic() > end_s:
                raise TimeoutError(f"{', '.join(self.processes)}: expected a beam command within {START_S:g} s")
            due = Due(frame, Header(self.clock_ns(), WARM_UP + str(next(numbers) // 1000)))
            answer = self._send(due)
            self._spin_until(lambda: self._is_done(answer), 0.1)  # noqa: B023 - called before the next
            done += self._is_done(answer)

    def spin(self, duration_s: float) -> None:
        """Receives messages and restarts processes that have died, for some time."""
        self._spin_until(lambda: False, duration_s)

    def clock_ns(self) -> int:
        """The network's clock."""
        return int(self._ros.get_clock().now().nanoseconds)

    def _join(self) -> None:
        self._ros = make_ros_node("source")
        self._closing.callback(rclpy.shutdown)
        self._closing.callback(self._ros.destroy_node)
        self._publisher = FramePublisher(self._ros)
        takers = {topics.BEAM: self._take_beam, topics.TIMING: self._take_timing}
        if self._keeps_results:
            takers |= {
                topics.DETECTIONS: self._take_detections,
                topics.RANGES: self._take_ranges,
                topics.TRACKS: self._take_tracks,
            }
        for topic, taker in takers.items():
            quality = topics.subscriber_quality(topic, 100)
            self._ros.create_subscription(topics.TYPES[topic], topic, taker, quality)
        self._receiver = Receiver(self._ros)

    def _send(self, due: Due) -> Answer:
        """Publishes a frame at its time."""
        answer = Answer(due.header)
        self._answers[due.header] = self._by_time[due.header.timestamp_ns] = answer
        messages = self._publisher.messages(due)
        self._spin_until(lambda: False, (due.header.timestamp_ns - self.clock_ns()) / 1e9)
        self._publisher.publish(messages)
        answer.sent_ms = (self.clock_ns() - due.header.timestamp_ns) / 1e6
        return answer

    def _is_done(self, answer: Answer) -> bool:
        if self._keeps_results and (answer.detections is None or answer.tracks is None):
            return False
        return answer.beam is not None and len(answer.times_ms) == len(self.processes)

    def _spin_until(self, is_done: Callable[[], bool], duration_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while not is_done() and (left_s := end_s - time.monotonic()) > 0:
            self._receiver.receive(min(left_s, 0.02))
            for process in self.processes.values():
                process.update()

    def _take_beam(self, message: Any) -> None:
        header, beam = read_beam(message, topics.BEAM)
        self.commands.append(Command(time.time_ns(), beam))
        if header in self._answers:
            self._answers[header].beam = beam

    def _take_timing(self, message: Any) -> None:
        header, times_ms = read_timing(message, topics.TIMING)
        answer = self._by_time.get(header.timestamp_ns)
        if answer is not None:
            answer.times_ms[header.sequence] = times_ms

    def _take_detections(self, message: Any) -> None:
        header, detections = read_detections(message, topics.DETECTIONS, self._threshold)
        if header in self._answers:
            self._answers[header].detections = detections

    def _take_ranges(self, message: Any) -> None:
        header, _, ranges = read_ranges(message, topics.RANGES, self._threshold)
        if header in self._answers:
            self._answers[header].ranges = ranges

    def _take_tracks(self, message: Any) -> None:
        header, tracks = read_tracks(message, topics.TRACKS)
        if header in self._answers:
            self._answers[header].tracks = tracks

    @property
    def _threshold(self) -> float:
        return self._config.classifier.score_threshold


@contextlib.contextmanager
def own_domain(number: int) -> Iterator[None]:
    """While entered, nodes and processes that are started use the ROS domain `number`, apart from other networks."""
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(number)
    try:
        yield
    finally:
        if before is None:
            del os.environ["ROS_DOMAIN_ID"]
        else:
            os.environ["ROS_DOMAIN_ID"] = before
