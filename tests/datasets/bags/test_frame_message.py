"""What a frame carries comes back to the last bit."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from foreglow.datasets.bags import FrameMessage
from foreglow.datasets.json_files import parse_json
from foreglow.geometry import Camera, MountSigmas, Pose, rotation
from foreglow.types import EgoMotion, Frame, RoadAhead

FINITE = st.floats(-1e6, 1e6)
TURN = st.floats(-0.4, 0.4)
SIGMAS = MountSigmas(1e-3, 2e-3, 3e-3, 0.02)
IMAGE = np.zeros((48, 64), np.uint8)


def returned(frame: Frame) -> Frame:
    text = FrameMessage.of(frame).to_json()
    return parse_json(text, FrameMessage, "here").frame_of(frame.image, "there")


@given(
    angles=st.tuples(TURN, TURN, TURN),
    position_m=st.tuples(st.floats(-30, 30), st.floats(-10, 10), st.floats(0.1, 10)),
    focal=st.floats(3.0, 1e4),
)
def test_a_camera(angles: tuple[float, float, float], position_m: tuple[float, float, float], focal: float) -> None:
    pose = Pose(np.array(position_m), rotation(*angles))
    camera = Camera(64, 48, (focal, 1.1 * focal), (31.7, 24.1), (-7e-13, 1.5e-13, 1e-14, -2e-15, 1e-12), pose, SIGMAS)
    found = returned(Frame(IMAGE, 3, camera=camera)).camera
    assert found is not None
    assert (found.width_px, found.height_px) == (64, 48)
    for name in ("focal_px", "centre_px", "distortion"):
        assert getattr(found, name) == getattr(camera, name)
    np.testing.assert_array_equal(found.vehicle_from_camera.position_m, pose.position_m)
    np.testing.assert_array_equal(found.vehicle_from_camera.rotation, pose.rotation)
    assert found.mount_sigmas == SIGMAS


@given(speed=FINITE, yaw=FINITE, pitch=FINITE | st.just(math.nan), time_ns=st.integers(0, 2**62))
def test_motion_and_time(speed: float, yaw: float, pitch: float, time_ns: int) -> None:
    found = returned(Frame(IMAGE, time_ns, 17, "S00001", "here", motion=EgoMotion(speed, yaw, pitch)))
    assert (found.timestamp_ns, found.frame, found.sequence, found.path) == (time_ns, 17, "S00001", "there")
    assert found.motion is not None
    assert (found.motion.speed_mps, found.motion.yaw_rate_radps) == (speed, yaw)
    np.testing.assert_equal(found.motion.pitch_rad, pitch)


@given(
    heights=st.lists(FINITE, min_size=2, max_size=5),
    half_width=st.floats(0.1, 10.0),
    bound=st.floats(0.0, 100.0) | st.just(math.inf),
)
def test_a_road(heights: list[float], half_width: float, bound: float) -> None:
    points = np.array([[5.0 * index, 0.1 * index, height] for index, height in enumerate(heights)])
    road = RoadAhead(points, half_width, np.linspace(0.0, 0.1, len(points)), bound)
    found = returned(Frame(IMAGE, 0, road=road)).road
    assert found is not None
    np.testing.assert_array_equal(found.points_m, road.points_m)
    np.testing.assert_array_equal(found.cross_slopes, road.cross_slopes)
    assert (found.half_width_m, found.error_bound_m) == (half_width, bound)


def test_a_message_of_an_earlier_recording() -> None:
    """The names of the fields are those of 0.1.0."""
    camera = {"width": 64, "height": 48, "focal_px": [60.0, 60.0], "centre_px": [32.0, 24.0], "distortion": [0.0] * 5}
    mount = {"position_m": [1.0, 0.0, 1.2], "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}
    motion = {"speed_mps": 20.0, "yaw_rate_radps": 0.1, "pitch_rad": None}
    road = {
        "points_m": [[0.0] * 3, [5.0, 0, 0]],
        "half_width_m": 3.5,
        "cross_slopes": [0.0, 0.0],
        "error_bound_m": None,
    }
    fields = {
        "frame": 7,
        "sequence": "S00001",
        "timestamp_ns": 5,
        "camera": camera | mount,
        "motion": motion,
        "road": road,
    }
    frame = parse_json(json.dumps(fields), FrameMessage, "here").frame_of(IMAGE, "there")
    later = {"is_damaged": False, "is_reported": None, "red_chroma": None, "earlier": None}
    written = json.loads(FrameMessage.of(frame).to_json())
    assert written.pop("camera") == camera | mount | {"mount_sigmas": [0.0] * 4}
    assert written == {name: value for name, value in (fields | later).items() if name != "camera"}
    assert frame.camera is not None
    assert (frame.camera.width_px, frame.frame, frame.sequence) == (64, 7, "S00001")


@given(arrays(np.uint8, (5, 7)) | arrays(np.uint16, (5, 7)))
def test_an_earlier_image(image: NDArray[np.uint8]) -> None:
    """Without it, a recording of single images gave other scores than its images."""
    found = returned(Frame(np.zeros_like(image), 7, earlier=Frame(image, -3))).earlier
    assert found is not None
    assert (found.timestamp_ns, found.image.dtype) == (-3, image.dtype)
    np.testing.assert_array_equal(found.image, image)


@given(arrays(np.uint8, (24, 32)) | arrays(np.uint16, (24, 32)))
def test_colour(chroma: NDArray[np.uint8]) -> None:
    found = returned(Frame(IMAGE, 0, red_chroma=chroma)).red_chroma
    assert found is not None
    assert found.dtype == chroma.dtype
    np.testing.assert_array_equal(found, chroma)


def test_colour_of_an_early_recording() -> None:
    """It had 8 bits, and did not say so."""
    fields = json.loads(FrameMessage.of(Frame(IMAGE, 0, red_chroma=np.full((24, 32), 9, np.uint8))).to_json())
    del fields["red_chroma"]["bits"]
    found = parse_json(json.dumps(fields), FrameMessage, "here").frame_of(IMAGE, "there")
    np.testing.assert_array_equal(found.red_chroma, np.full((24, 32), 9, np.uint8))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"height": 25}, "red_chroma: zlib: expected 25 rows of 32 bytes, got 768 bytes"),
        ({"height": 1_000_000}, "red_chroma.height: .*4096"),
        ({"zlib": "x"}, "red_chroma: zlib: expected compressed rows in base 64, cannot be read"),
        ({"zlib": "eJw="}, "red_chroma: zlib: expected 24 rows of 32 bytes, got 0 bytes"),
    ],
)
def test_colour_that_is_damaged(change: dict[str, object], complaint: str) -> None:
    fields = json.loads(FrameMessage.of(Frame(IMAGE, 0, red_chroma=np.full((24, 32), 9, np.uint8))).to_json())
    fields["red_chroma"] |= change
    with pytest.raises(ValueError, match=f"here: {complaint}"):
        parse_json(json.dumps(fields), FrameMessage, "here")


def test_a_frame_without_anything() -> None:
    found = returned(Frame(IMAGE, 0))
    assert (found.camera, found.motion, found.road) == (None, None, None)


def test_frames_of_one_camera_share_it() -> None:
    """Estimators remember what depends on it."""
    camera = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
    first, second = returned(Frame(IMAGE, 0, camera=camera)), returned(Frame(IMAGE, 1, camera=camera))
    assert first.camera is second.camera is not None


def test_a_camera_for_another_size_is_refused() -> None:
    camera = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
    record = FrameMessage.of(Frame(IMAGE, 0, camera=camera))
    with pytest.raises(ValueError, match=r"Frame\.camera: expected a calibration for images of 65x48 px"):
        record.frame_of(np.zeros((48, 65), np.uint8), "there")


def test_a_recorded_camera_of_no_lens_is_refused() -> None:
    camera = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
    fields = json.loads(FrameMessage.of(Frame(IMAGE, 0, camera=camera)).to_json())
    for name, value, complaint in (
        ("width", 2**70, "Camera: expected a size of 1x1 to"),
        ("position_m", [1.9, 300.0, 1.3], r"camera\.position_m: expected a camera at most 30 m"),
        (
            "rotation",
            [[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]],
            r"camera\.rotation: expected yaw, pitch and roll of at most 45",
        ),
        ("focal_px", [1.0, 60.0], "focal_px: expected focal lengths in pixels"),
        ("centre_px", [1e6, 24.0], "centre_px: expected a principal point at most 128 px outside"),
        ("distortion", [-3.0, 0.0, 0.0, 0.0, 0.0], "distortion: expected one that can be undone everywhere in"),
    ):
        wrong = fields | {"camera": fields["camera"] | {name: value}}
        with pytest.raises(ValueError, match=f"here: .*{complaint}"):
            parse_json(json.dumps(wrong), FrameMessage, "here")
