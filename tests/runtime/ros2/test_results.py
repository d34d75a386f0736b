"""Results go through tables and come back to the last bit; broken tables are refused; random bytes are no danger."""

from __future__ import annotations

import array
import dataclasses
import random
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

pytest.importorskip("rclpy")

from sensor_msgs.msg import PointField

from foreglow.photometry import NUM_LEDS
from foreglow.pipeline import MAX_TRACKS
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.results import (
    beam_message,
    detections_message,
    proposals_message,
    read_beam,
    read_detections,
    read_proposals,
    read_ranges,
    read_timing,
    read_tracks,
    timing_message,
    tracks_message,
)
from foreglow.types import BeamCommand, BeamMode, Detections, Proposals, Ranges, Tracks, Vehicles
from foreglow.types.kinds import kinds_of_direct

pytestmark = pytest.mark.ros

HEADER = Header(1_700_000_000_123_456_789, "S00001")


def detections_of(count: int, seed: int = 0) -> Detections:
    generator = np.random.default_rng(seed)
    corners = generator.integers(0, 500, (count, 2))
    boxes = np.concatenate([corners, corners + generator.integers(1, 50, (count, 2))], axis=1).astype(np.int32)
    kinds = kinds_of(generator, count).astype(np.float32)
    kinds[::3] = np.nan
    return Detections(Proposals(boxes), generator.random(count).astype(np.float32), 0.24, kinds)


def kinds_of(generator: np.random.Generator, count: int) -> NDArray[np.float64]:
    weights = generator.random((count, 4))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def tracks_of(count: int, seed: int = 0) -> Tracks:
    generator = np.random.default_rng(seed)
    corners = generator.random((count, 2)) * 500
    return Tracks(
        ids=np.cumsum(generator.integers(1, 9, count)),
        states=generator.integers(0, 3, count),
        boxes_xyxy_px=np.concatenate([corners, corners + 1 + generator.random((count, 2))], axis=1),
        confidences=generator.random(count),
        num_hits=generator.integers(1, 99, count),
        num_misses=generator.integers(0, 9, count),
        ages_s=generator.random(count) * 10,
        ranges_m=np.where(generator.random(count) < 0.3, np.nan, generator.random(count) * 200),
        sigmas_m=np.where(generator.random(count) < 0.3, np.inf, generator.random(count) + 0.1),
        detections=generator.integers(-1, 5, count),
        light_kinds=kinds_of(generator, count),
    )


def assert_equal_fields(one: Any, other: Any) -> None:
    for field in dataclasses.fields(other):
        value = getattr(one, field.name)
        np.testing.assert_array_equal(value, getattr(other, field.name))
        if isinstance(value, np.ndarray):
            assert value.dtype == getattr(other, field.name).dtype


@given(st.integers(0, 30), st.integers(0, 99), st.booleans())
def test_boxes_and_ranges_come_back(count: int, seed: int, has_ranges: bool) -> None:
    sent, generator = detections_of(count, seed), np.random.default_rng(seed)
    ranges_m = np.where(generator.random(count) < 0.3, np.nan, 1 + generator.random(count) * 200)
    ranges = Ranges(sent, ranges_m, np.where(np.isnan(ranges_m), np.inf, 3.5)) if has_ranges else None
    header, _, back = read_ranges(detections_message(HEADER, sent, ranges), "t", 0.24)
    assert header == HEADER
    assert (back is None) == (ranges is None)
    if back is not None and ranges is not None:
        np.testing.assert_array_equal(back.ranges_m, ranges.ranges_m)
        np.testing.assert_array_equal(back.sigmas_m, ranges.sigmas_m)
    _, alone = read_detections(detections_message(HEADER, sent), "t", 0.24)
    np.testing.assert_array_equal(alone.boxes_xyxy_px, sent.boxes_xyxy_px)
    np.testing.assert_array_equal(alone.scores, sent.scores)
    np.testing.assert_array_equal(alone.light_kinds, sent.light_kinds)
    assert alone.score_threshold == 0.24


@given(st.integers(0, 30), st.integers(0, 99))
def test_tracks_come_back(count: int, seed: int) -> None:
    sent = tracks_of(count, seed)
    header, back = read_tracks(tracks_message(HEADER, sent), "t")
    assert header == HEADER
    assert_equal_fields(back, sent)


def vehicles_of(count: int, seed: int) -> Vehicles:
    generator = np.random.default_rng(seed)
    of_tracks = generator.integers(0, 4, count) * 7
    ids, leading = np.unique(of_tracks, return_index=True)
    return Vehicles(
        ids=ids,
        states=generator.integers(0, 3, len(ids)),
        confidences=generator.random(len(ids)),
        is_in_sight=generator.random(len(ids)) < 0.5,
        of_tracks=of_tracks,
        leading=leading,
    )


@given(st.integers(0, 30), st.integers(0, 99))
def test_vehicles_come_back(count: int, seed: int) -> None:
    sent = dataclasses.replace(tracks_of(count, seed), vehicles=vehicles_of(count, seed))
    _, back = read_tracks(tracks_message(HEADER, sent), "t")
    assert_equal_fields(back.vehicles, sent.vehicles)


def test_vehicles_that_do_not_fit_their_tracks() -> None:
    tracks = dataclasses.replace(tracks_of(3), vehicles=vehicles_of(3, 0))
    message = tracks_message(HEADER, tracks)
    message.fields = [field for field in message.fields if field.name != "vehicle_state"]
    with pytest.raises(ValueError, match="tracks: vehicle_state: missing, expected with is_leading"):
        read_tracks(message, "tracks")
    message = tracks_message(HEADER, tracks)
    offset = next(field.offset for field in message.fields if field.name == "is_leading")
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(3, message.point_step).copy()
    rows[:, offset] = 0
    message.data = rows.tobytes()
    with pytest.raises(ValueError, match="tracks: is_leading: expected one track of each vehicle"):
        read_tracks(message, "tracks")


@given(count=st.integers(0, 20), seed=st.integers(0, 9))
def test_proposals_come_back(count: int, seed: int) -> None:
    proposals = detections_of(count, seed).proposals
    header, read = read_proposals(proposals_message(HEADER, proposals), "proposals")
    assert header == HEADER
    assert_equal_fields(read, proposals)


def test_tables_without_kinds_tell_lamps_from_their_light() -> None:
    """As older versions sent them."""
    detections, tracks = detections_message(HEADER, detections_of(3)), tracks_message(HEADER, tracks_of(3))
    for message in (detections, tracks):
        message.fields = [field for field in message.fields if field.name != "light_kinds"]
    _, found = read_detections(detections, "t", 0.24)
    np.testing.assert_array_equal(found.light_kinds, kinds_of_direct(detections_of(3).direct_probabilities))
    _, followed = read_tracks(tracks, "t")
    np.testing.assert_array_equal(followed.light_kinds, kinds_of_direct(tracks_of(3).direct_probabilities))


@pytest.mark.parametrize(
    "sent",
    [
        BeamCommand.low(HEADER.timestamp_ns, NUM_LEDS, "image_black", "Störung"),
        BeamCommand(HEADER.timestamp_ns, BeamMode.FULL, np.ones((2, 3))),
        BeamCommand(
            HEADER.timestamp_ns,
            BeamMode.GLARE_FREE,
            np.random.default_rng(0).random((2, NUM_LEDS)),
            np.array([[-0.1, 0.05], [0.2, 0.3]]),
            np.array([70.0, np.nan]),
        ),
    ],
)
def test_commands_come_back(sent: BeamCommand) -> None:
    header, back = read_beam(beam_message(HEADER, sent), "t")
    assert header == HEADER
    assert_equal_fields(back, sent)


def test_times_come_back() -> None:
    times_ms = {"received": 1.5, "done": 2.75, "beam": 0.1}
    assert read_timing(timing_message(HEADER, times_ms), "t") == (HEADER, times_ms)


def broken(message: Any, **values: Any) -> Any:
    for name, value in values.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"is_bigendian": True}, "is_bigendian"),
        ({"height": 2}, "height, width: expected 1 and"),
        ({"width": 2**31}, "height, width: expected 1 and at most 100000"),
        ({"width": 3}, "row_step, data: expected 3 x 40 bytes"),
        ({"row_step": 1}, "row_step, data"),
        ({"data": array.array("B", bytes(79))}, "row_step, data: expected 2 x 40 bytes, got 80 and 79"),
        ({"point_step": 0}, "point_step: expected 1 to"),
        ({"point_step": 2**31}, "point_step: expected 1 to"),
        ({"point_step": 39, "row_step": 78}, "light_kinds: expected to end within 39 bytes"),
        ({"fields": []}, "box_xyxy_px: missing"),
    ],
)
def test_broken_tables_are_refused(values: dict[str, Any], expected: str) -> None:
    message = broken(detections_message(HEADER, detections_of(2)), **values)
    with pytest.raises(ValueError, match=f"detections: {expected}"):
        read_detections(message, "detections", 0.24)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"name": "speed"}, "'speed': expected the fields box_xyxy_px, score"),
        ({"datatype": PointField.UINT32}, "box_xyxy_px: expected i4, got datatype 6"),
        ({"datatype": 0}, "box_xyxy_px: expected i4, got datatype 0"),
        ({"count": 2}, "box_xyxy_px: expected 4 numbers a row, got 2"),
        ({"count": 0}, "box_xyxy_px: expected 4 numbers a row, got 0"),
        ({"offset": 2**32 - 1}, "box_xyxy_px: expected to end within 40 bytes"),
    ],
)
def test_broken_fields_are_refused(values: dict[str, Any], expected: str) -> None:
    message = detections_message(HEADER, detections_of(2))
    broken(message.fields[0], **values)
    with pytest.raises(ValueError, match=f"detections: {expected}"):
        read_detections(message, "detections", 0.24)


def test_no_field_comes_twice() -> None:
    message = detections_message(HEADER, detections_of(2))
    message.fields = [message.fields[1], message.fields[1]]
    with pytest.raises(ValueError, match=r"detections: 'score': expected the fields .*, each once"):
        read_detections(message, "detections", 0.24)


def with_values(tracks: Tracks, **values: NDArray[Any]) -> Tracks:
    """Tracks with values that no tracks of ours can have."""
    changed = dataclasses.replace(tracks)
    for name, value in values.items():
        object.__setattr__(changed, name, value)
    return changed


def test_values_that_are_none_are_refused() -> None:
    message = detections_message(HEADER, detections_of(1))
    message.data[16:20] = array.array("B", np.float32(np.nan).tobytes())
    with pytest.raises(ValueError, match=r"detections: Detections\.scores"):
        read_detections(message, "detections", 0.24)
    tracks = tracks_of(1)
    message = tracks_message(HEADER, with_values(tracks, confidences=np.array([np.nan])))
    with pytest.raises(ValueError, match="tracks: confidence: expected finite numbers"):
        read_tracks(message, "tracks")
    message = tracks_message(HEADER, with_values(tracks, states=np.array([7])))
    with pytest.raises(ValueError, match="tracks: state: expected 0 to 2, got 7"):
        read_tracks(message, "tracks")
    with pytest.raises(ValueError, match="id: expected numbers of 32 bits"):
        tracks_message(HEADER, dataclasses.replace(tracks, ids=np.array([2**31])))


def test_more_tracks_than_a_beam_is_made_of_are_refused() -> None:
    """A table of 100,000 held the beam up for seconds."""
    assert len(read_tracks(tracks_message(HEADER, tracks_of(MAX_TRACKS)), "tracks")[1]) == MAX_TRACKS
    message = tracks_message(HEADER, tracks_of(MAX_TRACKS + 1))
    with pytest.raises(ValueError, match=f"tracks: width: expected at most {MAX_TRACKS} tracks, got {MAX_TRACKS + 1}"):
        read_tracks(message, "tracks")


def test_commands_that_are_none_are_refused() -> None:
    full = BeamCommand(0, BeamMode.FULL, np.ones((2, 4)))
    for place, value, expected in ((0, 9, "mode: expected 0 to 2, got 9"), (8, 255, r"BeamCommand\.levels")):
        message = beam_message(HEADER, full)
        message.data[place] = value
        with pytest.raises(ValueError, match=f"beam: {expected}"):
            read_beam(message, "beam")
    message = beam_message(HEADER, full)
    message.fields[2].count = 3
    with pytest.raises(ValueError, match="beam: levels_right: expected as many LEDs as left, 4, got 3"):
        read_beam(message, "beam")
    message = beam_message(HEADER, BeamCommand.low(0, 4, "x"))
    message.data[-1] = 0xFF
    with pytest.raises(ValueError, match=r"beam: .*utf-8"):
        read_beam(message, "beam")


FUZZ = """
import random, resource, warnings
warnings.simplefilter("ignore")
from foreglow.runtime.ros2.environment import prepare
prepare()
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.impl.implementation_singleton import rclpy_implementation
from foreglow.runtime.ros2.input_messages import camera_info_message, image_message, read_camera_info, read_image
from foreglow.runtime.ros2.header import Header, read_header
from foreglow.runtime.ros2.results import detections_message, read_beam, read_detections, read_tracks
from tests.runtime.ros2.test_input_messages import camera
from tests.runtime.ros2.test_results import detections_of

number = random.Random(SEED)
header = Header(5, "S")
whole = (
    image_message(header, np.zeros((64, 64), np.uint8)),
    camera_info_message(header, (1280, 960), camera()),
    detections_message(header, detections_of(3)),
)
readers = {
    "Image": (read_image,),
    "CameraInfo": (read_camera_info,),
    "PointCloud2": (read_beam, read_tracks, lambda message, topic: read_detections(message, topic, 0.5)),
}
refused = read = 0
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for _ in range(4000):
    message = number.choice(whole)
    data = bytearray(serialize_message(message))
    if number.random() < 0.3:
        data = bytearray(number.randbytes(number.randrange(300)))
    for _ in range(number.randrange(5)):
        if len(data) > 8:
            place = 4 * number.randrange(min(len(data), 240) // 4)
            data[place : place + 4] = number.choice([b"\\xff" * 4, bytes(4), number.randbytes(4)])
    data = data[: number.randrange(len(data) + 1)] if number.random() < 0.2 else data
    try:
        came = deserialize_message(bytes(data), type(message))
    except rclpy_implementation.RMWError:
        refused += 1
        continue
    for reader in readers[type(came).__name__]:
        try:
            read_header(came.header, "t")
            reader(came, "t")
            read += 1
        except ValueError:
            refused += 1
grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
print(refused, read, grown_mb)
assert refused > 1000 and read > 100 and grown_mb < 50
"""


def test_random_bytes_are_refused_without_harm() -> None:
    code = FUZZ.replace("SEED", str(random.Random(0).randrange(2**32)))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
