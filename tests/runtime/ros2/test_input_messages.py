"""Values go through messages and come back to the last bit; what is broken is refused by topic and field."""

from __future__ import annotations

import array
import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header as HeaderMessage

from foreglow.calibration import Mount
from foreglow.geometry import Camera, Floats, MountSigmas, Pose, rotation
from foreglow.runtime.ros2.header import Header, header_message, read_header
from foreglow.runtime.ros2.input_messages import (
    attitude_message,
    camera_info_message,
    image_message,
    mount_message,
    read_camera_info,
    read_image,
    read_motion,
    read_mount,
    read_road,
    road_message,
    twist_message,
)
from foreglow.runtime.ros2.table import table_message
from foreglow.types import EgoMotion, RoadAhead

pytestmark = pytest.mark.ros

HEADER = Header(1_700_000_000_123_456_789, "S00001")
finite = st.floats(allow_nan=False, allow_infinity=False)
IMAGE = np.random.default_rng(0).integers(0, 256, (64, 80), np.uint8)


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1), st.text(max_size=20))
def test_headers_come_back(timestamp_ns: int, sequence: str) -> None:
    assert read_header(header_message(Header(timestamp_ns, sequence)), "t") == Header(timestamp_ns, sequence)


@pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning")  # rclpy's own
def test_a_name_that_is_no_unicode_can_be_sent() -> None:
    """A sequence of such a name ended its recording."""
    sent = serialize_message(header_message(Header(5, "S\udcff")))
    assert read_header(deserialize_message(sent, HeaderMessage), "t") == Header(5, "S?")


def test_headers_are_checked() -> None:
    message = header_message(HEADER)
    message.stamp.nanosec = 10**9
    with pytest.raises(ValueError, match=r"image: header\.stamp\.nanosec: expected less than 1e9"):
        read_header(message, "image")
    with pytest.raises(ValueError, match=r"header\.frame_id: expected at most 256"):
        read_header(header_message(Header(0, "x" * 257)), "image")
    with pytest.raises(ValueError, match="within 68 years"):
        header_message(Header(2**63))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_images_come_back(dtype: Any) -> None:
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (64, 90)).astype(dtype)
    for one in (image, image[:, 3:80], image[::-1]):
        back = read_image(image_message(HEADER, one), "t")
        np.testing.assert_array_equal(back, one)
        assert back.dtype == image.dtype


def test_the_other_order_of_bytes_is_read() -> None:
    image = np.random.default_rng(1).integers(0, 65535, (64, 90)).astype(np.uint16)
    message = image_message(HEADER, image.byteswap())
    message.is_bigendian = 1 - message.is_bigendian
    np.testing.assert_array_equal(read_image(message, "t"), image)


@pytest.mark.parametrize(("encoding", "channels"), [("bgr8", 3), ("rgba8", 4), ("8UC3", 3)])
def test_colour_becomes_grey_as_everywhere(encoding: str, channels: int) -> None:
    from foreglow.datasets import to_grey

    colour = np.random.default_rng(2).integers(0, 256, (64, 70, channels), np.uint8)
    message = image_message(HEADER, colour.reshape(64, -1))
    message.width, message.encoding = 70, encoding
    expected = to_grey(colour, order="rgb" if encoding.startswith("rgb") else "bgr")
    np.testing.assert_array_equal(read_image(message, "t"), expected)


def test_rows_may_be_padded() -> None:
    padded = np.zeros((64, 96), np.uint8)
    padded[:, :80] = IMAGE
    message = image_message(HEADER, padded)
    message.width = 80
    np.testing.assert_array_equal(read_image(message, "t"), IMAGE)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("encoding", "bayer_rggb8", "encoding: expected one of mono8"),
        ("height", 65, "data: expected 65 x 80 bytes"),
        ("height", 2**32 - 1, "image size"),
        ("width", 0, "image size"),
        ("width", 81, "step: expected at least 81"),
        ("encoding", "mono16", "step: expected at least 160"),
        ("step", 2**32 - 1, "data: expected 64 x"),
        ("data", array.array("B", bytes(64 * 80 - 1)), "data: expected 64 x 80 bytes, got 5119"),
    ],
)
def test_broken_images_are_refused(field: str, value: Any, expected: str) -> None:
    message = image_message(HEADER, IMAGE)
    setattr(message, field, value)
    with pytest.raises(ValueError, match=f"camera: {expected}"):
        read_image(message, "camera")


def camera(focal_px: float = 1356.5, centre_px: float = 640.2) -> Camera:
    mount = Mount(position_m=(2.0906, -0.0030294, 1.3011), yaw_deg=0.2, pitch_deg=-0.4, roll_deg=0.02)
    lens = (-0.077618, 0.015524, 8.6827e-05, -2.1137e-05, 0.0)
    sigmas = MountSigmas(1e-3, 2e-3, 3e-3, 0.02)
    return Camera(1280, 960, (focal_px, focal_px / 1.1), (centre_px, 495.0), lens, mount.pose, sigmas)


@given(st.floats(1000, 5000), st.floats(0.5, 1270))
def test_cameras_come_back(focal_px: float, centre_px: float) -> None:
    sent = camera(focal_px, centre_px)
    size_px, intrinsics = read_camera_info(camera_info_message(HEADER, (1280, 960), sent), "t")
    assert intrinsics is not None
    assert size_px == (1280, 960)
    mount, sigmas = read_mount(mount_message(HEADER, sent), "t")
    back = Camera(**intrinsics.model_dump(), vehicle_from_camera=mount, mount_sigmas=sigmas)
    assert dataclasses.replace(back, vehicle_from_camera=sent.vehicle_from_camera) == sent
    np.testing.assert_array_equal(mount.rotation, sent.vehicle_from_camera.rotation)
    np.testing.assert_array_equal(mount.position_m, sent.vehicle_from_camera.position_m)


def test_no_calibration_is_none() -> None:
    assert read_camera_info(camera_info_message(HEADER, (640, 480), None), "t") == ((640, 480), None)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("width", 9000, "image size"),
        ("distortion_model", "equidistant", "distortion_model: expected one of"),
        ("d", [0.1] * 8, "no further term but 0"),
        ("d", [math.nan] * 5, "d: expected finite numbers"),
        ("k", [math.inf] * 9, "k: expected finite numbers"),
        ("k", [-5.0, 0, 3, 0, 5.0, 3, 0, 0, 1.0], "fx: expected a positive"),
        ("d", [-3.0, 0.0, 0.0, 0.0, 0.0], "d: expected one that can be undone everywhere in the image"),
        ("d", [1e7, 0.0, 0.0, 0.0, 0.0], "distortion_coefficients: expected coefficients of at most"),
        ("k", [1312.0, 0, 1e6, 0, 1312.0, 480, 0, 0, 1.0], "k: cx, cy: expected a principal point at most 2560 px"),
        ("binning_x", 2, "roi, binning"),
    ],
)
def test_broken_cameras_are_refused(field: str, value: Any, expected: str) -> None:
    message = camera_info_message(HEADER, (1280, 960), camera())
    setattr(message, field, value)
    with pytest.raises(ValueError, match=f"info: .*{expected}"):
        read_camera_info(message, "info")


def test_a_part_of_the_sensor_is_refused() -> None:
    message = camera_info_message(HEADER, (1280, 960), camera())
    message.roi.width = 640
    with pytest.raises(ValueError, match="info: roi: expected the whole image, got 640x0"):
        read_camera_info(message, "info")


def test_a_mount_is_on_a_vehicle() -> None:
    with pytest.raises(ValueError, match=r"mount\.position_m: .*10 m high, got "):
        read_mount(mounted(Pose(np.array([2.0, 0.0, 1e6]), np.eye(3))), "mount")


def mounted(pose: Pose) -> PointCloud2:
    """The message of a camera with this pose, whatever it is."""
    sent = camera()
    object.__setattr__(sent, "vehicle_from_camera", pose)
    return mount_message(HEADER, sent)


def test_a_mount_without_sigmas_counts_as_exact() -> None:
    pose = camera().vehicle_from_camera
    columns = {"position_m": pose.position_m.reshape(1, 3), "rotation": pose.rotation.reshape(1, 9)}
    assert read_mount(table_message(HEADER, columns), "mount")[1] == MountSigmas()


@pytest.mark.parametrize(
    ("turned", "expected"),
    [
        (np.diag([1.0, -1.0, 1.0]), r"Pose\.rotation: expected a rotation"),
        (
            rotation(yaw_rad=math.radians(60.0)),
            "rotation: expected yaw.* got 60.0",
        ),
        (
            rotation(pitch_rad=math.radians(-60.0)),
            "rotation: expected yaw.* got 0.0, -60.0",
        ),
    ],
    ids=["mirrored", "yaw", "pitch"],
)
def test_a_mount_looks_ahead_and_is_not_mirrored(turned: Floats, expected: str) -> None:
    pose = Pose(np.array([2.0, 0.0, 1.3]), np.eye(3))
    object.__setattr__(pose, "rotation", turned)
    with pytest.raises(ValueError, match=f"mount(: |\\.){expected}"):
        read_mount(mounted(pose), "mount")


def test_no_mount_is_no_rotation() -> None:
    pose = Pose(np.array([2.0, 0.0, 1.3]), np.eye(3))
    message = mounted(pose)
    message.data[24:32] = array.array("B", np.float64(2.0).tobytes())
    with pytest.raises(ValueError, match=r"mount: Pose\.rotation"):
        read_mount(message, "mount")


@given(finite, finite, st.one_of(finite, st.just(math.nan)))
def test_motion_comes_back(speed_mps: float, yaw_rate_radps: float, pitch_rad: float) -> None:
    sent = EgoMotion(speed_mps, yaw_rate_radps, pitch_rad)
    back = read_motion(twist_message(HEADER, sent), attitude_message(HEADER, sent), "t", "a")
    np.testing.assert_equal(dataclasses.astuple(back or EgoMotion(0, 0)), dataclasses.astuple(sent))


def test_unknown_motion_is_none_and_a_broken_one_is_refused() -> None:
    assert read_motion(twist_message(HEADER, None), attitude_message(HEADER, None), "t", "a") is None
    twist = twist_message(HEADER, EgoMotion(10.0, 0.1))
    alone = read_motion(twist, None, "t", "a")
    assert alone is not None
    assert math.isnan(alone.pitch_rad)
    twist.twist.angular.z = math.nan
    with pytest.raises(ValueError, match=r"twist: twist: expected finite linear\.x and angular\.z"):
        read_motion(twist, None, "twist", "a")
    tilted = attitude_message(HEADER, EgoMotion(10.0, 0.1))
    tilted.vector.y = -math.inf
    with pytest.raises(ValueError, match=r"attitude: vector\.y: expected a finite number or NaN, got inf"):
        read_motion(twist_message(HEADER, EgoMotion(10.0, 0.1)), tilted, "twist", "attitude")


@given(hnp.arrays(np.float64, (5, 4), elements=st.floats(-1e3, 1e3)), st.floats(0.1, 50), st.floats(0, math.inf))
def test_roads_come_back(numbers: Any, half_width_m: float, bound_m: float) -> None:
    numbers[:, 0] = np.arange(5)
    sent = RoadAhead(numbers[:, :3], half_width_m, 1e-3 * numbers[:, 3], bound_m)
    back = read_road(road_message(HEADER, sent), "t")
    assert back is not None
    for name in ("points_m", "cross_slopes", "half_width_m", "error_bound_m"):
        np.testing.assert_array_equal(getattr(back, name), getattr(sent, name))


def test_no_road_is_none_and_a_broken_one_is_refused() -> None:
    assert read_road(road_message(HEADER, None), "t") is None
    message = road_message(HEADER, RoadAhead(np.array([[0.0, 0, 0], [5, 0, 0]]), 3.5))
    message.data[0:8] = array.array("B", np.float64(math.nan).tobytes())
    with pytest.raises(ValueError, match=r"road: RoadAhead\.points_m: expected finite"):
        read_road(message, "road")
    message = road_message(HEADER, RoadAhead(np.array([[0.0, 0, 0], [5, 0, 0]]), 3.5))
    for start in (32, 80):  # half_width_m of both rows
        message.data[start : start + 8] = array.array("B", np.float64(1e6).tobytes())
    with pytest.raises(ValueError, match=r"road: RoadAhead\.half_width_m: expected at most 200, got 1000000"):
        read_road(message, "road")
    message.data[32:40] = array.array("B", np.float64(9.0).tobytes())
    with pytest.raises(ValueError, match="road: half_width_m, error_bound_m: expected the same"):
        read_road(message, "road")
