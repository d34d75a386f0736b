"""What is recorded, read by the tools of others, and by ours."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import tracemalloc
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.datasets import Recording, open_source, shipped_drive
from foreglow.datasets.bags.mcap_file import McapFile
from foreglow.pipeline import Pipeline
from foreglow.runs.frames_file import frame_to_line
from foreglow.runs.times_file import frame_to_times
from foreglow.types import Frame, FrameResult, Proposals
from tests.runtime.mcap.drives import STEP_NS, full_frame, full_result, health_at

foxglove = pytest.importorskip("foxglove")
mcap_reader = pytest.importorskip("mcap.reader")

from foreglow.runtime.mcap import McapRecorder  # noqa: E402

TOPICS = {
    "/camera/image": "foxglove.RawImage",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/camera/boxes": "foxglove.ImageAnnotations",
    "/tf": "foxglove.FrameTransform",
    "/scene": "foxglove.SceneUpdate",
    "/frame": "foreglow.Frame",
    "/result": "foreglow.Result",
    "/health": "foreglow.Health",
    "/log": "foxglove.Log",
}


def messages_in(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Time and data of all messages by topic."""
    found = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in mcap_reader.make_reader(file).iter_messages(log_time_order=False):
            found[channel.topic].append((message.log_time, message.data))
    return found


def record(path: Path, frames: list[Frame], **options: Any) -> McapRecorder:
    recorder = McapRecorder(path, **options)
    for frame in frames:
        recorder.write(frame, full_result(frame))
    return recorder


def write_many(recorder: McapRecorder) -> None:
    for index in range(200):
        recorder.write(full_frame(index), full_result(full_frame(index)))


def test_topics_times_and_schemas(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    frames = [full_frame(index) for index in range(30)]
    recorder = McapRecorder(path, config=PipelineConfig(), source_name="here")
    for frame in frames:
        recorder.write(frame, full_result(frame))
    recorder.write_health(health_at(30 * STEP_NS, "camera_gone"))
    assert not path.exists()
    recorder.close()
    assert list(tmp_path.iterdir()) == [path]
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        channels = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
        assert channels == TOPICS
        metadata, end = reader.iter_metadata()
        assert summary.statistics.chunk_count >= 3
    assert (end.name, end.metadata) == ("foreglow_end", {"is_complete": "true"})
    assert metadata.metadata["config"] == config_to_toml(PipelineConfig())
    assert metadata.metadata["source"] == "here"
    found = messages_in(path)
    times_ns = [frame.timestamp_ns for frame in frames]
    for topic in TOPICS.keys() - {"/health", "/log"}:
        assert [time_ns for time_ns, _ in found[topic]] == times_ns
    assert [json.loads(data) for _, data in found["/result"]] == [
        {**frame_to_line(each, full_result(each)), **frame_to_times(each, full_result(each))} for each in frames
    ]
    assert [json.loads(data)["motion"]["speed_mps"] for _, data in found["/frame"]] == [20.0 + k for k in range(30)]
    ((time_ns, health),) = found["/health"]
    assert time_ns == 30 * STEP_NS
    assert json.loads(health) == {
        "timestamp_ns": time_ns,
        "faults": ["camera_gone"],
        "num_frames": 5,
        "num_dropped": 2,
        "num_late": 1,
        "details": "",
        "beam": None,
    }


def test_messages_of_foxglove_say_what_was_found(tmp_path: Path) -> None:
    """Decoded by protobuf, by the schemas in the file."""
    pool = pytest.importorskip("google.protobuf.descriptor_pool")
    from google.protobuf import descriptor_pb2, message_factory

    path = tmp_path / "drive.mcap"
    frame = full_frame(3)
    record(path, [frame]).close()
    decoded = {}
    with path.open("rb") as file:
        for schema, channel, message in mcap_reader.make_reader(file).iter_messages():
            if schema.encoding == "protobuf":
                known = pool.DescriptorPool()
                for described in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    known.Add(described)
                kind = message_factory.GetMessageClass(known.FindMessageTypeByName(schema.name))
                decoded[channel.topic] = kind.FromString(message.data)
    image = decoded["/camera/image"]
    assert (image.width, image.height, image.step, image.encoding) == (128, 96, 128, "mono8")
    assert image.data == frame.image.tobytes()
    assert image.timestamp.ToNanoseconds() == frame.timestamp_ns
    calibration = decoded["/camera/calibration"]
    assert list(calibration.K) == [130.0, 0.0, 63.5, 0.0, 130.0, 47.5, 0.0, 0.0, 1.0]
    boxes = decoded["/camera/boxes"]
    proposals, detection, *tracks = boxes.points
    assert (len(proposals.points), len(detection.points), len(tracks)) == (16, 8, 2)
    assert {(point.x, point.y) for point in detection.points} == {(10, 20), (20, 20), (20, 30), (10, 30)}
    assert [text.text for text in boxes.texts] == ["3: 0.75, rear lamp, 55 m ± 6", "8: 0.75"]
    transform = decoded["/tf"]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("vehicle", "camera")
    assert (transform.translation.x, transform.translation.y, transform.translation.z) == (1.9, 0.0, 1.3)
    turned = [transform.rotation.x, transform.rotation.y, transform.rotation.z, transform.rotation.w]
    np.testing.assert_allclose(np.abs(turned), 0.5)  # forward is z: two quarter turns
    tracks_3d, road, gaps = decoded["/scene"].entities
    (cube,) = tracks_3d.cubes
    at = cube.pose.position
    # box centre 49 px left of and 23 px above the axis, 55 m away
    ray = np.array([130.0, 48.75, 23.0])
    np.testing.assert_allclose([at.x, at.y, at.z], [1.9, 0, 1.3] + 55.0 * ray / np.linalg.norm(ray), rtol=1e-9)
    assert [text.text for text in tracks_3d.texts] == ["3: 0.75, rear lamp, 55 m ± 6"]
    right, centre, left = road.lines
    assert [point.y for point in (right.points[0], centre.points[0], left.points[0])] == pytest.approx([-1.6, 1.6, 4.8])
    assert left.points[2].z == pytest.approx(0.2 + 0.02 * 3.2)
    (gap,) = gaps.lines
    assert (gap.points[1].x, gap.points[1].y) == pytest.approx((77.0 * np.cos(-0.1), 77.0 * np.sin(-0.1)))


def test_frames_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    frames = [full_frame(index) for index in range(4)]
    deep = full_frame(4)
    frames.append(dataclasses.replace(deep, image=deep.image.astype(np.uint16) * 257))
    frames.append(dataclasses.replace(full_frame(5), camera=None, motion=None, road=None))
    frames[3] = dataclasses.replace(frames[3], is_damaged=True, is_reported=True)
    half = (-(-frames[2].height_px // 2), -(-frames[2].width_px // 2))
    red_chroma = np.random.default_rng(1).integers(0, 256, half).astype(np.uint8)
    frames[2] = dataclasses.replace(frames[2], red_chroma=red_chroma)
    record(path, frames).close()
    source = Recording(path)
    assert (source.topic, source.num_frames, source.rate_hz) == ("/camera/image", 6, 20.0)
    for found, frame in zip(source, frames, strict=True):
        assert found.image.dtype == frame.image.dtype
        np.testing.assert_array_equal(found.image, frame.image)
        for name in ("timestamp_ns", "frame", "sequence", "is_damaged", "is_reported"):
            assert getattr(found, name) == getattr(frame, name)
        np.testing.assert_array_equal(found.red_chroma, frame.red_chroma)
        assert (found.camera is None) == (frame.camera is None)
        assert (found.motion and found.motion.speed_mps) == (frame.motion and frame.motion.speed_mps)
        assert (found.road is None) == (frame.road is None)


def test_two_recordings_into_one_file(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    first = record(path, [full_frame(0)])
    with pytest.raises(ValueError, match=r"drive\.mcap: another run is writing this file"):
        McapRecorder(path)
    first.write(full_frame(1), full_result(full_frame(1)))
    first.close()
    assert [frame.frame for frame in Recording(path)] == [7, 9]
    record(path, [full_frame(2)]).close()  # afterwards there is room for another
    assert [frame.frame for frame in Recording(path)] == [11]
    assert list(tmp_path.iterdir()) == [path]


def test_sequences_follow_each_other_and_keep_their_times(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    frames = [full_frame(index, sequence) for sequence in ("S00001", "S00002") for index in range(3)]
    record(path, frames).close()
    times_ms = [time_ns // 10**6 for time_ns, _ in messages_in(path)["/camera/image"]]
    assert times_ms == [0, 50, 100, 1100, 1150, 1200]
    assert [(each.sequence, each.timestamp_ns) for each in Recording(path)] == [
        (frame.sequence, frame.timestamp_ns) for frame in frames
    ]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_a_replay_gives_the_same_results(tmp_path: Path, kind: str) -> None:
    drive = open_source(shipped_drive())
    frames = [frame for frame, _ in zip(drive, range(24), strict=False)]
    if kind == "uint16":
        frames = [dataclasses.replace(frame, image=frame.image.astype(np.uint16) * 257) for frame in frames[:6]]
    pipeline, path = Pipeline(), tmp_path / "drive.mcap"
    recorder = McapRecorder(path)
    expected = []
    for frame in frames:
        result = pipeline.step(frame)
        recorder.write(frame, result)
        expected.append(frame_to_line(frame, result))
    recorder.close()
    pipeline.reset()
    found = [frame_to_line(frame, pipeline.step(frame)) for frame in Recording(path)]
    assert any(each["tracks"] for each in expected)
    assert found == expected


def test_faults_are_logged_when_they_change(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    recorder = McapRecorder(path)
    for index, faults in enumerate([(), ("dark",), ("dark",), (), ()]):
        frame = full_frame(index)
        recorder.write(frame, full_result(frame, *faults))
    for index, faults in enumerate([("camera_gone",), ("camera_gone",), ()], 5):
        recorder.write_health(health_at(index * STEP_NS, *faults))
    recorder.close()
    found = messages_in(path)
    texts = [
        next(text for text in (b"dark", b"camera_gone", b"none any more") if text in data) for _, data in found["/log"]
    ]
    assert texts == [b"dark", b"none any more", b"camera_gone", b"none any more"]
    assert [time_ns // STEP_NS for time_ns, _ in found["/log"]] == [1, 3, 5, 7]
    assert len(found["/health"]) == 3


def test_a_bare_result(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    frame = Frame(full_frame(0).image, 0)
    recorder = McapRecorder(path)
    recorder.write(frame, FrameResult(0, 0, Proposals(np.zeros((0, 4), np.int32)), None))
    recorder.close()
    assert set(messages_in(path)) == TOPICS.keys() - {"/camera/calibration", "/tf", "/health", "/log"}


@pytest.mark.parametrize("was_there", [False, True])
def test_a_file_that_somebody_writes_meanwhile_stays(tmp_path: Path, was_there: bool) -> None:
    """A drive takes hours; what is there at its end is not what was looked at in the beginning."""
    path = tmp_path / "night.mcap"
    if was_there:
        record(path, [full_frame(0)]).close()
    recorder = record(path, [full_frame(0), full_frame(1)])
    path.write_text("notes")
    with pytest.raises(FileExistsError, match="somebody wrote another file there meanwhile; the new one is in"):
        recorder.close()
    recorder.discard()
    assert path.read_text() == "notes"
    path.with_name("night.mcap.partial").rename(tmp_path / "kept.mcap")
    assert len(list(open_source(tmp_path / "kept.mcap"))) == 2


def test_nothing_remains_of_what_is_discarded(tmp_path: Path) -> None:
    recorder = record(tmp_path / "drive.mcap", [full_frame(0)])
    recorder.discard()
    recorder.discard()
    assert list(tmp_path.iterdir()) == []
    recorder = record(tmp_path / "drive.mcap", [full_frame(0)])
    recorder.close()
    recorder.close()
    recorder.discard()
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_what_a_killed_run_left_is_kept(tmp_path: Path) -> None:
    left = tmp_path / "drive.mcap.partial"
    for number in range(2):
        left.write_bytes(bytes([number]))
        record(tmp_path / "drive.mcap", [full_frame(0)]).close()
    assert (tmp_path / "drive.1.mcap.partial").read_bytes() == b"\0"
    assert (tmp_path / "drive.2.mcap.partial").read_bytes() == b"\1"
    assert len(list(Recording(tmp_path / "drive.mcap"))) == 1


def test_paths_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"drive\.bag: expected a recording that ends in \.mcap"):
        McapRecorder(tmp_path / "drive.bag")
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(ValueError, match=r"folder\.mcap: expected a file to write, or nothing, got a folder"):
        McapRecorder(tmp_path / "folder.mcap")
    os.mkfifo(tmp_path / "pipe.mcap.partial")  # opening it would wait for a reader
    with pytest.raises(ValueError, match=r"pipe\.mcap\.partial: expected a file to write, or nothing, got a device"):
        McapRecorder(tmp_path / "pipe.mcap")
    with pytest.raises(OSError, match=r"No such file or directory: '.*absent/drive\.mcap'"):
        McapRecorder(tmp_path / "absent" / "drive.mcap")


def test_a_time_before_zero(tmp_path: Path) -> None:
    recorder = McapRecorder(tmp_path / "drive.mcap")
    frame = full_frame(0, time_ns=-1)
    with pytest.raises(ValueError, match=r"drive\.mcap: time: expected one from 0 to 2\^32 s, got -0\.000 s"):
        recorder.write(frame, full_result(frame))
    recorder.discard()


def test_a_full_disk(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """One error with the path; what was there before is readable, and stays so when the recorder is closed."""
    path, partial = tmp_path / "drive.mcap", tmp_path / "drive.mcap.partial"
    recorder = McapRecorder(path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(OSError, match=rf"File too large: '{path}'"):
            write_many(recorder)
        size = partial.stat().st_size
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [each.name for each in tmp_path.iterdir()] == ["drive.mcap.partial"]
    assert partial.stat().st_size == size
    with pytest.warns(UserWarning, match="the recording was not finished"):
        source = Recording(partial)
    frames = list(source)
    assert frames
    np.testing.assert_array_equal(frames[-1].image, full_frame(len(frames) - 1).image)
    assert source.skipped == []
    assert capfd.readouterr().err == ""


def test_a_full_disk_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    recorder = record(path, [full_frame(index) for index in range(3)])
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match=rf"File too large: '{path}'"):
            recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not path.exists()
    recorder.discard()  # as an off-line run does then
    assert not any(tmp_path.iterdir())


def test_what_is_complete_is_not_discarded(tmp_path: Path) -> None:
    """A later sink may fail after it was closed."""
    recorder = record(tmp_path / "drive.mcap", [full_frame(0)])
    recorder.close()
    (tmp_path / "drive.mcap.partial").write_bytes(b"of another run")
    recorder.discard()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["drive.mcap", "drive.mcap.partial"]


@pytest.mark.slow
def test_images_are_not_kept(tmp_path: Path) -> None:
    """Memory of Python objects is flat over many frames; that of the writer is bounded by its chunk."""
    recorder = McapRecorder(tmp_path / "drive.mcap")
    frame = Frame(np.zeros((16, 16), np.uint8), 0)
    result = FrameResult(0, 0, Proposals(np.zeros((0, 4), np.int32)), None)
    sizes = []
    tracemalloc.start()
    for index in range(10_000):
        recorder.write(dataclasses.replace(frame, timestamp_ns=index * STEP_NS), result)
        if index in (999, 9_999):
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    recorder.close()
    assert sizes[1] - sizes[0] < 50_000


def test_health_is_handed_over_at_once(tmp_path: Path) -> None:
    """What was wrong just before a crash is what everybody wants to know."""
    recorder = record(tmp_path / "drive.mcap", [full_frame(0)])
    partial = tmp_path / "drive.mcap.partial"
    before = partial.stat().st_size
    recorder.write_health(health_at(STEP_NS, "camera_gone"))
    assert partial.stat().st_size > before
    copy = tmp_path / "copy.mcap.partial"
    copy.write_bytes(partial.read_bytes())
    recorder.discard()
    with pytest.warns(UserWarning, match="the recording was not finished"):
        (frame,) = Recording(copy)
    np.testing.assert_array_equal(frame.image, full_frame(0).image)
    container = McapFile(copy)
    topics = [message.topic.name for message in container.messages({"/health", "/log"}, pytest.fail)]
    assert topics == ["/health", "/log"]
