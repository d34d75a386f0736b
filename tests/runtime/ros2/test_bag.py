"""A recording with ROS 2's messages is read by other people's tools, and by ours."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")
pytest.importorskip("mcap.reader")

from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from typer.testing import CliRunner

from foreglow.cli import app
from foreglow.datasets import Recording, shipped_drive
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.bag import BagRecorder, definition
from foreglow.runtime.ros2.results import read_beam, read_tracks
from foreglow.runtime.ros2.standard import installed_types
from foreglow.types import Frame, FrameResult
from tests.runtime.mcap.drives import STEP_NS, full_frame, full_result

pytestmark = [
    pytest.mark.ros,
    pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning"),  # rclpy's own
]


@pytest.fixture
def drive(tmp_path: Path) -> tuple[Path, list[tuple[Frame, FrameResult]]]:
    path = tmp_path / "drive.mcap"
    frames = [full_frame(index) for index in range(3)] + [full_frame(index, "S00002") for index in range(2)]
    pairs = [(dataclasses.replace(frame, is_reported=True), full_result(frame)) for frame in frames]
    recorder = BagRecorder(path, source_name="here")
    for frame, result in pairs:
        recorder.write(frame, result)
    assert not path.exists()
    recorder.close()
    assert list(tmp_path.iterdir()) == [path]
    return path, pairs


def messages_in(path: Path) -> dict[str, list[Any]]:
    """The messages by topic, decoded by rclpy."""
    found: dict[str, list[Any]] = {}
    types = {f"/{topic}": kind for topic, kind in {**topics.TYPES, **installed_types()}.items()}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert (
                schema.name == f"{types[channel.topic].__module__.partition('.')[0]}/msg/{schema.name.split('/')[-1]}"
            )
            found.setdefault(channel.topic, []).append(deserialize_message(message.data, types[channel.topic]))
    return found


def test_every_topic_has_a_message_for_each_frame(drive: tuple[Path, list[tuple[Frame, FrameResult]]]) -> None:
    path, pairs = drive
    found = messages_in(path)
    assert found.keys() == {f"/{topic}" for topic in ({*topics.TYPES} | {*installed_types()}) - {topics.TIMING}}
    assert {len(messages) for messages in found.values()} == {len(pairs)}
    num_boxes = [message.width * message.height for message in found["/proposals"]]
    assert num_boxes == [len(result.proposals) for _, result in pairs]
    for (_, result), tracks, beam in zip(pairs, found["/tracks"], found["/beam"], strict=True):
        assert result.tracks is not None
        assert result.beam is not None
        np.testing.assert_array_equal(read_tracks(tracks, "tracks")[1].ranges_m, result.tracks.ranges_m)
        assert read_beam(beam, "beam")[1].mode == result.beam.mode
    headers = [message.header for message in found["/camera/image_raw"]]
    assert [header.frame_id for header in headers] == ["S00001"] * 3 + ["S00002"] * 2
    times_ns = [header.stamp.sec * 10**9 + header.stamp.nanosec for header in headers]
    assert times_ns == [0, STEP_NS, 2 * STEP_NS, 2 * STEP_NS + 10**9, 3 * STEP_NS + 10**9]


def test_our_reader_takes_the_images_again(drive: tuple[Path, list[tuple[Frame, FrameResult]]]) -> None:
    path, pairs = drive
    again = list(Recording(path))
    for (frame, _), read in zip(pairs, again, strict=True):
        np.testing.assert_array_equal(read.image, frame.image)


def test_the_definitions_are_those_of_ros() -> None:
    store = pytest.importorskip("rosbags.typesys")
    typestore = store.get_typestore(store.Stores.ROS2_JAZZY)
    for kind in {*topics.TYPES.values()}:
        package = kind.__module__.partition(".")[0]
        parsed = store.get_types_from_msg(definition(kind), f"{package}/msg/{kind.__name__}")
        for name, (_, fields) in parsed.items():
            assert fields == typestore.fielddefs[name][1], name


def test_a_time_that_fits_no_stamp_names_the_file(tmp_path: Path) -> None:
    recorder = BagRecorder(tmp_path / "drive.mcap")
    frame = full_frame(0, time_ns=-1)
    with pytest.raises(ValueError, match=r"drive\.mcap: time: expected one from 0 to 2\^31 s"):
        recorder.write(frame, full_result(frame))
    recorder.discard()
    assert not list(tmp_path.iterdir())


def test_the_command_records_a_drive(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    result = CliRunner().invoke(app, ["record", str(shipped_drive()), "--out", str(path), "--ros2", "--limit", "2"])
    assert result.exit_code == 0, result.output
    found = messages_in(path)
    assert {len(messages) for messages in found.values()} == {2}
    assert found["/camera/camera_info"][0].k[0] > 0
