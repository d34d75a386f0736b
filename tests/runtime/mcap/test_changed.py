"""Recordings that another tool has changed: what belongs to an image comes back, or its loss is told."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets import Recording
from foreglow.datasets.bags import FRAME_TOPIC
from foreglow.types import Frame
from tests.runtime.mcap.drives import full_frame, full_result

pytest.importorskip("foxglove")
mcap_reader = pytest.importorskip("mcap.reader")
mcap_writer = pytest.importorskip("mcap.writer")

from foreglow.runtime.mcap import McapRecorder  # noqa: E402
from foreglow.runtime.mcap.channels import IMAGE_TOPIC  # noqa: E402

Logged = tuple[str, int, bytes]
"""Topic, log time and data."""
Change = Callable[[list[Logged]], list[Logged]]


def frames_of(*sequences: str) -> list[Frame]:
    """Six frames of each sequence, each of which begins at 0; the third is damaged."""
    frames = [full_frame(index, sequence) for sequence in sequences for index in range(6)]
    frames[2] = dataclasses.replace(frames[2], is_damaged=True)
    return frames


def recorded(path: Path, frames: list[Frame], change: Change) -> Path:
    """A recording of which a tool has written the images and `/frame` again, changed."""
    whole = path.with_name("whole.mcap")
    recorder = McapRecorder(whole)
    for frame in frames:
        recorder.write(frame, full_result(frame))
    recorder.close()
    schemas: dict[str, tuple[Any, Any]] = {}
    messages: list[Logged] = []
    with whole.open("rb") as file:
        for schema, channel, message in mcap_reader.make_reader(file).iter_messages(log_time_order=False):
            if channel.topic in (IMAGE_TOPIC, FRAME_TOPIC):
                schemas[channel.topic] = schema, channel
                messages.append((channel.topic, message.log_time, message.data))
    with path.open("wb") as file:
        writer = mcap_writer.Writer(file)
        writer.start()
        numbers = {}
        for topic, (schema, channel) in schemas.items():
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[topic] = writer.register_channel(topic, channel.message_encoding, number)
        for topic, time_ns, data in change(messages):
            writer.add_message(numbers[topic], time_ns, data, time_ns)
        writer.finish()
    return path


def swapped(messages: list[Logged]) -> list[Logged]:
    """Each image before its `/frame`."""
    return [message for index in range(0, len(messages), 2) for message in (messages[index + 1], messages[index])]


def at_one_time(messages: list[Logged]) -> list[Logged]:
    return [(topic, 0, data) for topic, _, data in messages]


def rotated(by: int) -> Change:
    """Data of `/frame` of the image that comes `by` later."""

    def change(messages: list[Logged]) -> list[Logged]:
        data = [message[2] for message in messages if message[0] == FRAME_TOPIC]
        data = data[by:] + data[:by]
        return [(topic, time, data.pop(0) if topic == FRAME_TOPIC else image) for topic, time, image in messages]

    return change


def without(topic: str, number: int) -> Change:
    def change(messages: list[Logged]) -> list[Logged]:
        left_out = [message for message in messages if message[0] == topic][number]
        return [message for message in messages if message is not left_out]

    return change


def first_images(messages: list[Logged]) -> list[Logged]:
    return sorted(messages, key=lambda message: message[0] == FRAME_TOPIC)


@pytest.mark.parametrize("change", [list, swapped, at_one_time, lambda messages: at_one_time(swapped(messages))])
@pytest.mark.parametrize("sequences", [("S00001",), ("S00001", "S00002")])
def test_the_order_of_equal_times_does_not_matter(tmp_path: Path, change: Change, sequences: tuple[str, ...]) -> None:
    """An image before its `/frame` lost motion, camera, sequence and the mark of damage without a word."""
    frames = frames_of(*sequences)
    for found, frame in zip(Recording(recorded(tmp_path / "t.mcap", frames, change)), frames, strict=True):
        for name in ("timestamp_ns", "frame", "sequence", "is_damaged"):
            assert getattr(found, name) == getattr(frame, name)
        assert found.camera is not None
        assert (found.motion and found.motion.speed_mps) == (frame.motion and frame.motion.speed_mps)


@pytest.mark.parametrize(
    ("change", "kept", "complaint"),
    [
        (rotated(1), [], r"frame 0: foreglow\.Frame: timestamp_ns: expected 0, as its image has, got 50000000"),
        (rotated(-1), [], r"frame 0: foreglow\.Frame: timestamp_ns: expected 0, as its image has, got 250000000"),
        (without(FRAME_TOPIC, 3), [0, 1, 2, 4, 5], r"frame 3: expected foreglow\.Frame at its time, 150000000 ns"),
        (without(IMAGE_TOPIC, 3), [0, 1, 2, 4, 5], r"frame 2: expected an image at the time of foreglow\.Frame, 15000"),
        (without(IMAGE_TOPIC, 5), [0, 1, 2, 3, 4], r"frame 4: expected an image at the time of foreglow\.Frame, 25000"),
        (first_images, [0, 1, 2, 3, 4], r"frame 5: expected an image at the time of foreglow\.Frame, 0 ns"),
    ],
)
def test_what_is_not_an_images_own_is_told(tmp_path: Path, change: Change, kept: list[int], complaint: str) -> None:
    path = recorded(tmp_path / "t.mcap", frames_of("S00001"), change)
    with pytest.raises(ValueError, match=rf"t\.mcap: /camera/image: {complaint}"):
        list(Recording(path))
    source = Recording(path, on_error="skip")
    numbers = [round(frame.timestamp_ns / 50e6) for frame in source]
    assert numbers[: len(kept)] == kept
    assert len(source.skipped) >= 1


def test_a_part_of_a_recording_whose_times_were_shifted(tmp_path: Path) -> None:
    """The second sequence alone, as a tool cuts it: its images are later than its `/frame` by the first one."""
    path = recorded(tmp_path / "t.mcap", frames_of("S00001", "S00002"), lambda messages: messages[12:])
    assert [(frame.sequence, frame.timestamp_ns) for frame in Recording(path)] == [
        ("S00002", index * 50_000_000) for index in range(6)
    ]
    swapped_data = recorded(
        tmp_path / "s.mcap", frames_of("S00001", "S00002"), lambda messages: rotated(1)(messages[12:])
    )
    with pytest.raises(ValueError, match=r"frame 5: foreglow\.Frame: timestamp_ns: expected 300000000, as .* got 0"):
        list(Recording(swapped_data))
