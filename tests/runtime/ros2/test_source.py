"""Times are moved, not changed; who hears us is the user's to say; the launch file names what exists."""

from __future__ import annotations

import dataclasses
import itertools
import os
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

import rclpy

from benchmarks.faulty import ScriptedCamera
from foreglow.datasets.vehicle_logs import VehicleFiles
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.environment import prepare
from foreglow.runtime.ros2.frame_reader import FrameReader
from foreglow.runtime.ros2.header import Header, read_header
from foreglow.runtime.ros2.input_messages import road_message, twist_message
from foreglow.runtime.ros2.join import Join, Joined
from foreglow.runtime.ros2.source import PAUSE_NS, Due, FramePublisher, NetworkClock, Player, repeated, timed
from foreglow.types import EgoMotion, Frame
from tests.runtime.mcap.drives import CAMERA, ROAD
from tests.stand_ins import night_frames

pytestmark = pytest.mark.ros

NOW_NS = 1_700_000_000_123_456_789


def still(now_ns: int = NOW_NS) -> NetworkClock:
    """A clock that stands still, as the steady one does."""
    return NetworkClock(lambda: now_ns, lambda: 0)


def test_times_of_a_sequence_are_moved_as_one() -> None:
    frames = [*night_frames(4, "A"), *night_frames(3, "B")]
    due = list(timed(frames, still()))
    assert [one.header.sequence for one in due] == ["A"] * 4 + ["B#1"] * 3
    times_ns = [one.header.timestamp_ns - NOW_NS - PAUSE_NS for one in due]
    assert times_ns[:4] == [0, 50_000_000, 100_000_000, 150_000_000]
    assert times_ns[4:] == [150_000_000 + PAUSE_NS + 50_000_000 * k for k in range(3)]


@pytest.mark.parametrize("jump_s", [-60, 7200])
def test_a_clock_that_was_set_is_not_waited_for(jump_s: int) -> None:
    """Frames came hours later, or all at once and too old, until their times were those of before."""
    frames = night_frames(4)
    frames[2:] = [dataclasses.replace(one, timestamp_ns=one.timestamp_ns + jump_s * 10**9) for one in frames[2:]]
    times_ns = [one.header.timestamp_ns - NOW_NS for one in timed(frames, still())]
    step_ns = 50_000_000
    assert times_ns == [PAUSE_NS, PAUSE_NS + step_ns, 2 * PAUSE_NS + step_ns, 2 * PAUSE_NS + 2 * step_ns]


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_times_begin_anew_when_the_network_s_clock_was_set(step_s: int) -> None:
    """Set back, nothing was published until the old time came again; set forward, the rest of the drive at once."""
    now_ns = NOW_NS
    due = timed(night_frames(4), NetworkClock(lambda: now_ns, lambda: 0))
    times_ns = [next(due).header.timestamp_ns - NOW_NS for _ in range(2)]
    now_ns += step_s * 10**9
    times_ns += [one.header.timestamp_ns - now_ns for one in due]
    assert times_ns == [PAUSE_NS, PAUSE_NS + 50_000_000] * 2


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
@pytest.mark.usefixtures("domain")
@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_frame_that_waited_while_the_clock_was_set_is_left_out(step_s: int, monkeypatch: pytest.MonkeyPatch) -> None:
    ahead_ns = 0
    sent: list[int] = []

    def set_clock() -> bool:
        """It is asked for whether to stop while a frame waits."""
        nonlocal ahead_ns
        ahead_ns = step_s * 10**9 if sent else 0
        return False

    def publish(messages: list[tuple[str, Any]]) -> None:
        topic, message = messages[0]
        sent.append(read_header(message.header, topic).timestamp_ns - player.clock_ns())

    player = Player(set_clock)
    monkeypatch.setattr(player, "clock_ns", lambda: time.monotonic_ns() + ahead_ns)
    monkeypatch.setattr(player._publisher, "publish", publish)
    assert player.play(night_frames(4)) == len(sent) == 3
    assert all(-PAUSE_NS < age_ns <= 0 for age_ns in sent)


def test_quicker_means_nearer() -> None:
    due = list(timed(night_frames(3), still(0), speed=2.0))
    assert [one.header.timestamp_ns - PAUSE_NS for one in due] == [0, 25_000_000, 50_000_000]


def test_a_drive_is_played_again_as_another_sequence() -> None:
    frames = repeated(night_frames(3), 2, is_endless=True)
    played = [next(frames) for _ in range(5)]
    assert [one.sequence for one in played] == ["S00001", "S00001", "S00001+1", "S00001+1", "S00001+2"]
    assert len(list(repeated(night_frames(3)))) == 3
    assert not list(repeated([], is_endless=True))


@pytest.mark.parametrize("is_reported", [None, False, True])
def test_what_the_production_system_says_comes_back(is_reported: bool | None) -> None:
    frame = dataclasses.replace(night_frames(1)[0], is_reported=is_reported)
    due = Due(frame, Header(frame.timestamp_ns, frame.sequence))
    read = FrameReader().read(Joined(due.header, dict(FramePublisher.messages(due)), 0))
    assert read.is_reported is is_reported
    assert read.is_damaged is False


def test_a_calibration_is_scaled_to_the_image() -> None:
    (frame,) = night_frames(1)
    due = Due(frame, Header(frame.timestamp_ns, frame.sequence))
    joined = Joined(due.header, dict(FramePublisher.messages(due)), 0)
    twice = CAMERA.scaled(2 * frame.width_px, 2 * frame.height_px)
    assert FrameReader(VehicleFiles(camera=twice)).read(joined).camera == CAMERA
    other = dataclasses.replace(CAMERA, width_px=2 * frame.width_px)
    with pytest.raises(ValueError, match=r"own\.toml: image: expected the frames' size or its multiple, 128x96 px"):
        FrameReader(VehicleFiles(camera=other, names=("own.toml", "", ""))).read(joined)


def test_by_default_nobody_else_hears_us() -> None:
    known: dict[str, str] = {}
    prepare(environment=known)
    profile = ET.parse(known["FASTRTPS_DEFAULT_PROFILES_FILE"])
    name = "{http://www.eprosima.com}"
    assert [one.text for one in profile.iter(f"{name}address")] == ["127.0.0.1"]
    assert next(profile.iter(f"{name}useBuiltinTransports")).text == "false"


@pytest.mark.parametrize(
    ("known", "is_networked", "expected"),
    [
        ({}, False, "SYSTEM_DEFAULT"),  # the profile has the loopback interface alone
        ({}, True, "SUBNET"),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, False, "LOCALHOST"),
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "mine.xml"}, False, "LOCALHOST"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, True, "OFF"),
    ],
)
def test_what_the_user_has_set_counts(
    known: dict[str, str], is_networked: bool, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.xml").write_text("<dds/>")
    given = dict(known)
    prepare(is_networked=is_networked, environment=known)
    assert known["ROS_AUTOMATIC_DISCOVERY_RANGE"] == expected
    assert given.items() <= known.items()
    is_others = "RMW_IMPLEMENTATION" in given or "FASTDDS_DEFAULT_PROFILES_FILE" in given
    assert ("FASTRTPS_DEFAULT_PROFILES_FILE" in known) != is_others


def test_the_launch_file_starts_nodes_that_exist() -> None:
    from typer.testing import CliRunner

    from foreglow.cli import app

    path = Path(CliRunner().invoke(app, ["ros2", "launch-file"]).output.replace("\n", ""))
    code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    assert "generate_launch_description" in code.co_names or "generate_launch_description" in str(code.co_consts)
    from foreglow.runtime.ros2 import STAGE_NODES

    assert str(STAGE_NODES).replace("'", '"') in path.read_text(encoding="utf-8")
    assert os.access(path, os.R_OK)


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
@pytest.mark.usefixtures("domain")
def test_a_live_camera_is_stamped_with_its_exposure_and_opened_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = night_frames(5)
    monkeypatch.setattr("foreglow.runtime.ros2.source.RETRY_S", 0.01)
    player = Player(lambda: False)
    sent: list[tuple[Due, int]] = []

    def keep(messages: list[tuple[str, Due]]) -> None:
        sent.extend((due, player.clock_ns()) for _, due in messages)

    player._publisher = SimpleNamespace(messages=lambda due: [("", due)], publish=keep)  # type: ignore[assignment]
    scripts: list[list[Frame | BaseException | float]] = [
        [*frames[:2], OSError("unplugged")],
        [frames[2], RuntimeError("driver")],
        [*frames[3:4]],
        [*frames[4:]],
    ]
    camera = ScriptedCamera(*scripts, is_live=True, is_endless=True)
    assert player.stream(camera, limit=5) == 5
    rclpy.shutdown()
    assert [due.frame.frame for due, _ in sent] == [frame.frame for frame in frames]
    ages_ns = [now_ns - due.header.timestamp_ns for due, now_ns in sent]
    assert min(ages_ns) >= 0
    assert max(ages_ns) < 1e9
    stamps_ns = [due.header.timestamp_ns for due, _ in sent]
    assert stamps_ns == sorted(set(stamps_ns))
    assert {due.header.sequence for due, _ in sent} == {"S00001"}


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
@pytest.mark.usefixtures("domain")
def test_the_car_is_heard_beside_a_live_camera() -> None:
    """The camera said of each frame that the speed is unknown, so that there was never light."""
    sampled = (topics.MOUNT, topics.TWIST, topics.ATTITUDE, topics.ROAD, topics.DAMAGE)
    player, join = Player(lambda: False), Join((topics.IMAGE, topics.CAMERA_INFO), sampled)
    told, seen = EgoMotion(25.0, 0.01), list[Frame]()

    def publish(messages: Iterable[tuple[str, Any]]) -> None:
        due = list(messages)
        header = read_header(due[-1][1].header, topics.IMAGE)
        before = Header(header.timestamp_ns - 10_000_000)
        join.put(topics.TWIST, before, twist_message(before, told), 0)
        join.put(topics.ROAD, before, road_message(before, ROAD), 0)
        for topic, message in due:
            join.put(topic, header, message, 0)
        joined = join.take(Join.PATIENCE_NS)
        seen.extend([] if joined is None else [FrameReader().read(joined)])

    player._publisher = SimpleNamespace(messages=FramePublisher.messages, publish=publish)  # type: ignore[assignment]
    assert player.stream(ScriptedCamera(night_frames(3), is_live=True, is_endless=True), limit=3) == 3
    rclpy.shutdown()
    motions = [frame.motion for frame in seen]
    assert [motion and (motion.speed_mps, motion.yaw_rate_radps) for motion in motions] == 3 * [(25.0, 0.01)]
    assert all(frame.road is not None for frame in seen)


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
@pytest.mark.usefixtures("domain")
def test_a_network_whose_topics_have_other_names_is_not_waited_for_in_vain() -> None:
    """The source counted those who use the topics' own names: there were none, and it never began."""
    looks = itertools.count()
    player = Player(lambda: next(looks) > 100, ["--ros-args", "-r", "beam:=/lamps/beam", "-r", "detections:=found"])
    try:
        assert not player._is_listened_to()
        for topic in (topics.BEAM, topics.DETECTIONS):  # as the node `pipeline`
            player.ros.create_publisher(topics.TYPES[topic], topic, topics.publisher_quality(topic))
        player.wait()
        assert next(looks) <= 100
    finally:
        player.ros.destroy_node()
        rclpy.shutdown()


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
@pytest.mark.usefixtures("domain")
def test_nothing_is_played_by_the_clock_of_a_simulation() -> None:
    """It stands still for a source, which hears no clock: no frame was ever due."""
    with pytest.raises(ValueError, match="use_sim_time: expected false for a source"):
        Player(lambda: True, ["--ros-args", "-p", "use_sim_time:=true"])
    rclpy.shutdown()
