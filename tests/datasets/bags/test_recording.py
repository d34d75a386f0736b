"""What other people's recordings hold comes back: from every container, compression and type of image message."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import Recording, open_source
from tests.datasets.bags.bags import (
    HEIGHT,
    KINDS,
    START_NS,
    STEP_NS,
    TOPIC,
    WIDTH,
    BagWriter,
    Picture,
    images,
    make_bag,
    make_mcap,
    png,
    raw,
)


@pytest.mark.parametrize("kind", KINDS)
def test_frames_of_a_bag(tmp_path: Path, kind: str) -> None:
    expected = images(4)
    source = open_source(make_bag(tmp_path, kind, [raw(image) for image in expected]))
    assert isinstance(source, Recording)
    assert (source.topic, source.name, source.rate_hz) == (TOPIC, source.path.name, 20.0)
    assert source.num_frames == (None if kind == "bag" else 4)
    for _ in range(2):
        frames = list(source)
        assert [frame.timestamp_ns for frame in frames] == [START_NS + index * STEP_NS for index in range(4)]
        assert [frame.frame for frame in frames] == [0, 1, 2, 3]
        assert all(frame.camera is None and frame.motion is None and frame.sequence == "" for frame in frames)
        assert frames[1].path == f"{source.path}, {TOPIC}, frame 1"
        np.testing.assert_array_equal([frame.image for frame in frames], expected)
        assert source.skipped == []


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_compressed_chunks_of_ros1(tmp_path: Path, compression: str) -> None:
    expected = images(3)
    path = make_bag(tmp_path, "bag", [raw(image) for image in expected], compression=compression)
    np.testing.assert_array_equal([frame.image for frame in Recording(path)], expected)


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("chunk_size", [1, 10_000_000])
def test_foxglove_images_in_mcap(tmp_path: Path, compression: str, chunk_size: int) -> None:
    expected = images(3)
    path = make_mcap(tmp_path / "a.mcap", expected, compression=compression, chunk_size=chunk_size)
    source = Recording(path)
    frames = list(source)
    np.testing.assert_array_equal([frame.image for frame in frames], expected)
    assert [frame.timestamp_ns for frame in frames] == [0, STEP_NS, 2 * STEP_NS]
    assert (source.num_frames, source.rate_hz) == (3, 20.0)


@pytest.mark.parametrize(("num_recorded", "is_told"), [(2, False), (3, False), (5, True)])
@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_fewer_images_than_were_recorded_by_the_metadata_are_told(
    tmp_path: Path, kind: str, num_recorded: int, is_told: bool
) -> None:
    """More are none of our business: those of a recorder that was killed since."""
    bag = make_bag(tmp_path, kind, [raw(image) for image in images(3)])
    metadata = bag / "metadata.yaml"
    before, found, after = metadata.read_text().rpartition("message_count: 3")
    assert found
    assert TOPIC in after
    metadata.write_text(f"{before}message_count: {num_recorded}{after}")
    words = (
        f"{bag}: by metadata.yaml 5 messages on {TOPIC} were recorded, 3 are there: what is made from it is incomplete"
    )
    with pytest.warns(UserWarning, match=words) if is_told else contextlib.nullcontext():
        source = Recording(bag)
    assert source.lack == (words if is_told else "")
    assert len(list(source)) == 3


@pytest.mark.parametrize("kind", KINDS)
def test_a_stamp_of_zero_gives_way_to_the_time_of_recording(tmp_path: Path, kind: str) -> None:
    with BagWriter(tmp_path, kind) as bag:
        bag.image(START_NS, raw(images(1)[0]), 0)
        bag.image(START_NS + 9, raw(images(1)[0]), 5)
    assert [frame.timestamp_ns for frame in Recording(bag.path)] == [START_NS, 5]


@pytest.mark.parametrize("kind", KINDS)
def test_times_that_go_back(tmp_path: Path, kind: str) -> None:
    """A little: the frame is refused, as in a video; by more than a second: another recording begins."""
    steps = [0, 1, 3, 2, 4, 0, 1]
    with BagWriter(tmp_path, kind) as bag:
        for index, step in enumerate(steps):
            stamp_ns = START_NS + step * STEP_NS + (index < 5) * 10**10
            bag.image(START_NS + index, raw(images(1)[0]), stamp_ns)
    times = r"1700000010\.273456789 s on, that of the frame before, got 1700000010\.223456789 s$"
    with pytest.raises(ValueError, match=rf"frame 3: expected a time from {times}"):
        list(Recording(bag.path))
    found = Recording(bag.path, on_error="skip")
    assert [(frame.frame, frame.sequence) for frame in found] == [
        *((index, "") for index in (0, 1, 2, 4)),
        *((index, "frame 5") for index in (5, 6)),
    ]
    assert len(found.skipped) == 1


def test_reading_a_bag_writes_nothing_beside_it(tmp_path: Path) -> None:
    """SQLite makes two files beside one that is in the mode WAL, as rosbag2's resilient bags are."""
    path = next(make_bag(tmp_path, "sqlite3", [raw(image) for image in images(2)]).glob("*.db3"))
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
    before = sorted(path.parent.iterdir())
    assert len(list(Recording(path))) == 2
    assert sorted(path.parent.iterdir()) == before


def test_a_bag_whose_recorder_was_killed_has_what_its_journal_holds(tmp_path: Path) -> None:
    path = next(make_bag(tmp_path, "sqlite3", [raw(image) for image in images(2)]).glob("*.db3"))
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        copy = "INSERT INTO messages SELECT id + 100, topic_id, timestamp, data FROM messages"
        connection.execute(copy)
        connection.commit()
        assert Recording(path).num_frames == 4


@pytest.mark.parametrize("kind", KINDS)
def test_compressed_images(tmp_path: Path, kind: str) -> None:
    deep = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH)
    colour = np.dstack([images(1)[0]] * 3)
    with BagWriter(tmp_path, kind) as bag:
        for index, image in enumerate((images(1)[0], deep, colour)):
            bag.compressed(START_NS + index, png(image), START_NS + index)
        jpeg = cv2.imencode(".jpg", np.full((HEIGHT, WIDTH), 77, np.uint8))[1].tobytes()
        bag.compressed(START_NS + 3, jpeg, START_NS + 3)
    first, second, third, fourth = [frame.image for frame in Recording(bag.path)]
    np.testing.assert_array_equal(first, images(1)[0])
    np.testing.assert_array_equal(second, deep)
    np.testing.assert_array_equal(third, images(1)[0])
    assert abs(float(fourth.mean()) - 77) < 1


def test_the_first_image_topic_or_the_one_named(tmp_path: Path) -> None:
    left, right = images(2)
    with BagWriter(tmp_path, "mcap") as bag:
        bag.text(START_NS)
        for index in range(2):
            bag.image(START_NS + 2 * index, raw(left), START_NS, "/left")
            bag.image(START_NS + 2 * index + 1, raw(right), START_NS, "/right")
    assert [source.topic for source in (Recording(bag.path), Recording(bag.path, topic="/right"))] == [
        "/left",
        "/right",
    ]
    named = Recording(bag.path, topic="/right")
    np.testing.assert_array_equal([frame.image for frame in named], [right, right])
    assert named.num_frames == 2
    known = r"found /chatter \(std_msgs/msg/String\), /left \(sensor_msgs/msg/Image\), /right \(sensor_msgs/msg/Image\)"
    with pytest.raises(ValueError, match=rf"expected the topic /middle with images .*{known}"):
        open_source(bag.path, topic="/middle")
    with pytest.raises(ValueError, match=rf"expected the topic /chatter with images .*{known}"):
        open_source(bag.path, topic="/chatter")


def test_a_recording_without_images(tmp_path: Path) -> None:
    with BagWriter(tmp_path, "bag") as bag:
        bag.text(START_NS)
    with pytest.raises(
        ValueError, match=r"drive\.bag: expected a topic with images .*, found /chatter \(std_msgs/String\)"
    ):
        Recording(bag.path)


def test_one_file_of_a_bag(tmp_path: Path) -> None:
    expected = images(2)
    folder = make_bag(tmp_path, "sqlite3", [raw(image) for image in expected])
    (path,) = folder.glob("*.db3")
    np.testing.assert_array_equal([frame.image for frame in open_source(path)], expected)


def test_a_bad_image_stops_or_is_skipped(tmp_path: Path) -> None:
    good = raw(images(1)[0])
    bad = Picture(good.data[:-1])
    path = make_bag(tmp_path, "sqlite3", [good, bad, good])
    message = rf"{path}: {TOPIC}: frame 1: data: expected 4480 bytes by height and step, got 4479"
    with pytest.raises(ValueError, match=message):
        list(Recording(path))
    source = Recording(path, on_error="skip")
    for _ in range(2):
        assert [frame.frame for frame in source] == [0, 2]
        assert source.skipped == [message]


def test_what_is_no_recording(tmp_path: Path) -> None:
    for name, message in (
        ("a.mcap", "expected an MCAP file"),
        ("a.bag", "expected a ROS 1 bag of version 2.0"),
        ("a.db3", "expected a ROS 2 bag in SQLite"),
    ):
        for content in (b"", b"no recording at all " * 10):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(ValueError, match=message):
                open_source(tmp_path / name)
    with pytest.raises(FileNotFoundError, match="no such recording"):
        Recording(tmp_path / "absent.mcap")
    (tmp_path / "a.txt").touch()
    with pytest.raises(ValueError, match=r"expected a recording that ends in \.mcap, \.bag, \.db3"):
        Recording(tmp_path / "a.txt")


def test_a_topic_of_what_has_none(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), images(1)[0])
    with pytest.raises(ValueError, match="expected a recording, as a topic was named"):
        open_source(tmp_path / "a.png", topic=TOPIC)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "expected YAML"),
        ("a: 1", "relative_file_paths: expected names of files"),
        ("rosbag2_bagfile_information: {relative_file_paths: [3]}", "expected names of files"),
        ("rosbag2_bagfile_information: {relative_file_paths: [a.mcap]}", r"a\.mcap: no such file"),
        ("rosbag2_bagfile_information: {relative_file_paths: [../metadata.yaml]}", "expected a file of a bag"),
        ("rosbag2_bagfile_information: {relative_file_paths: [x], compression_mode: message}", "compression_mode"),
    ],
)
def test_broken_metadata(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        open_source(tmp_path)
