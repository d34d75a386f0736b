"""The network's inputs as messages and back: the image, its camera, our motion and the road ahead.

| value | message |
|---|---|
| image | `sensor_msgs/Image` |
| camera without its mount | `sensor_msgs/CameraInfo`, as drivers send it |
| mount of the camera, whether the image is damaged, and whether a vehicle is reported | `sensor_msgs/PointCloud2` |
| speed and yaw rate | `geometry_msgs/TwistStamped` |
| pitch of the body | `geometry_msgs/Vector3Stamped`, a rotation vector |
| road ahead | `sensor_msgs/PointCloud2`, a row for each point |

Every value is read back exactly as it was written. Readers raise `ValueError` with topic and field.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Literal, NamedTuple

import numpy as np
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from foreglow.calibration import Intrinsics
from foreglow.calibration.ros import distortion_of
from foreglow.calibration.values import HALF_PIXEL_PX
from foreglow.datasets.images import check_size, to_grey
from foreglow.geometry import Camera, MountSigmas, Pose, check_mount
from foreglow.runtime.ros2.header import Header, byte_array, header_message
from foreglow.runtime.ros2.table import Field, read_table, table_message
from foreglow.types import EgoMotion, RoadAhead
from foreglow.types import Image as GreyImage


class Encoding(NamedTuple):
    """The layout of an image's pixels: bytes per sample, samples per pixel, and the order of colours."""

    sample_bytes: int
    num_channels: int
    order: Literal["rgb", "bgr"] = "rgb"


ENCODINGS = {
    "mono8": Encoding(1, 1),
    "mono16": Encoding(2, 1),
    "8UC1": Encoding(1, 1),
    "16UC1": Encoding(2, 1),
    "rgb8": Encoding(1, 3),
    "bgr8": Encoding(1, 3, "bgr"),
    "rgba8": Encoding(1, 4),
    "bgra8": Encoding(1, 4, "bgr"),
    "rgb16": Encoding(2, 3),
    "bgr16": Encoding(2, 3, "bgr"),
    "8UC3": Encoding(1, 3, "bgr"),
}
"""The encodings that can be read; OpenCV's, such as 8UC3, do not name their colours: taken as blue, green, red."""

MOUNT = {
    "position_m": Field("f8", 3, is_finite=True),
    "rotation": Field("f8", 9, is_finite=True),
}
MOUNT_SIGMAS = {"sigmas": Field("f8", 4, is_finite=True)}
"""Yaw, pitch, roll in rad, height in m, as in `MountSigmas`: in a mount whose calibration is not exact."""

DAMAGE = {"is_damaged": Field("u1")}
REPORTED = {"is_reported": Field("u1")}
ROAD = {
    "point_m": Field("f8", 3),
    "cross_slope": Field("f8"),
    "half_width_m": Field("f8"),
    "error_bound_m": Field("f8"),
}


def image_message(header: Header, image: GreyImage) -> Image:
    """A grey image."""
    rows, columns = image.shape
    return Image(
        header=header_message(header),
        height=rows,
        width=columns,
        encoding="mono8" if image.dtype == np.uint8 else "mono16",
        is_bigendian=int(sys.byteorder == "big"),
        step=columns * image.itemsize,
        data=byte_array(image),
    )


def read_image(message: Image, topic: str) -> GreyImage:
    """The image as grey, shape (height, width); not copied if it is grey already.

    Raises:
        ValueError: If the encoding is unknown, or size, row length and data length contradict each other.
    """
    encoding = ENCODINGS.get(message.encoding)
    if encoding is None:
        raise ValueError(f"{topic}: encoding: expected one of {', '.join(ENCODINGS)}, got {message.encoding[:40]!r}")
    check_size(message.height, message.width, topic)
    row_bytes = message.width * encoding.num_channels * encoding.sample_bytes
    if message.step < row_bytes:
        raise ValueError(f"{topic}: step: expected at least {row_bytes} bytes a row, got {message.step}")
    if len(message.data) != message.height * message.step:
        raise ValueError(f"{topic}: data: expected {message.height} x {message.step} bytes, got {len(message.data)}")
    dtype = np.dtype((">" if message.is_bigendian else "<") + f"u{encoding.sample_bytes}")
    rows: NDArray[Any] = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)[:, :row_bytes]
    samples = np.ascontiguousarray(rows).view(dtype)
    if encoding.num_channels > 1:
        samples = samples.reshape(message.height, message.width, encoding.num_channels)
    return to_grey(samples, topic, order=encoding.order)


def camera_info_message(header: Header, size_px: tuple[int, int], camera: Camera | None) -> CameraInfo:
    """The camera's intrinsics; K = 0, by ROS's convention, if it is not calibrated."""
    message = CameraInfo(header=header_message(header), width=size_px[0], height=size_px[1])
    if camera is not None:
        fx, fy = (float(focal_px) for focal_px in camera.focal_px)
        cx, cy = (float(centre_px) - HALF_PIXEL_PX for centre_px in camera.centre_px)
        message.distortion_model = "plumb_bob"
        message.d = [float(coefficient) for coefficient in camera.distortion]
        message.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        message.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def read_camera_info(message: CameraInfo, topic: str) -> tuple[tuple[int, int], Intrinsics | None]:
    """Width and height, and the intrinsics of the unrectified image; None if the camera is not calibrated (K = 0).

    Raises:
        ValueError: If the image is cropped, binned or rectified, its size is impossible, or matrix or distortion are
            not as in ROS's calibration files.
    """
    check_size(message.height, message.width, topic)
    if not any(message.k):
        return (message.width, message.height), None
    roi = message.roi
    if any((roi.x_offset, roi.y_offset, roi.do_rectify)) or max(message.binning_x, message.binning_y) > 1:
        raise ValueError(f"{topic}: roi, binning: expected the whole image, neither binned nor rectified")
    if roi.width not in (0, message.width) or roi.height not in (0, message.height):
        raise ValueError(f"{topic}: roi: expected the whole image, got {roi.width}x{roi.height} px")
    for name in ("k", "d"):
        if not np.isfinite(getattr(message, name)).all():
            raise ValueError(f"{topic}: {name}: expected finite numbers, got NaN or infinity")
    size_px = (message.width, message.height)
    distortion = distortion_of(message.distortion_model, tuple(float(number) for number in message.d), topic)
    found = Intrinsics.of_matrix(np.array(message.k, np.float64), size_px, f"{topic}: k", distortion)
    return size_px, found.undistorted(f"{topic}: d")


def mount_message(header: Header, camera: Camera) -> PointCloud2:
    """How the camera is mounted in the vehicle, and how well that is known."""
    mount, sigmas = camera.vehicle_from_camera, camera.mount_sigmas
    columns = {
        "position_m": mount.position_m.reshape(1, 3),
        "rotation": mount.rotation.reshape(1, 9),
        "sigmas": np.array([[sigmas.yaw_rad, sigmas.pitch_rad, sigmas.roll_rad, sigmas.height_m]]),
    }
    return table_message(header, columns)


def read_mount(message: PointCloud2, topic: str) -> tuple[Pose, MountSigmas]:
    """The camera's pose in the vehicle, and how well it is known: exactly, if the message does not say.

    Raises:
        ValueError: If the table is malformed, or the pose is not one of a camera that looks ahead.
    """
    has_sigmas = any(field.name in MOUNT_SIGMAS for field in message.fields)
    _, columns = read_table(message, topic, MOUNT | MOUNT_SIGMAS if has_sigmas else MOUNT, num_rows=1)
    try:
        pose = Pose(columns["position_m"][0], columns["rotation"][0].reshape(3, 3))
        sigmas = MountSigmas(*columns["sigmas"][0].tolist()) if has_sigmas else MountSigmas()
    except ValueError as error:
        raise ValueError(f"{topic}: {error}") from None
    check_mount(pose, topic)
    return pose, sigmas


def damage_message(header: Header, is_damaged: bool) -> PointCloud2:
    """Whether the source knows that the image is damaged, `Frame.is_damaged`."""
    return table_message(header, {"is_damaged": np.array([is_damaged], np.uint8)})


def read_damage(message: PointCloud2, topic: str) -> bool:
    """Whether the source knows that the image is damaged; any number but 0 says so."""
    _, columns = read_table(message, topic, DAMAGE, num_rows=1)
    return bool(columns["is_damaged"][0])


def reported_message(header: Header, is_reported: bool) -> PointCloud2:
    """Whether the car's production system reports a vehicle, `Frame.is_reported`."""
    return table_message(header, {"is_reported": np.array([is_reported], np.uint8)})


def read_reported(message: PointCloud2, topic: str) -> bool:
    """Whether the car's production system reports a vehicle; any number but 0 says so."""
    _, columns = read_table(message, topic, REPORTED, num_rows=1)
    return bool(columns["is_reported"][0])


def twist_message(header: Header, motion: EgoMotion | None) -> TwistStamped:
    """Speed and yaw rate; NaN where unknown."""
    message = TwistStamped(header=header_message(header))
    message.twist.linear.x = math.nan if motion is None else float(motion.speed_mps)
    message.twist.angular.z = math.nan if motion is None else float(motion.yaw_rate_radps)
    return message


def attitude_message(header: Header, motion: EgoMotion | None) -> Vector3Stamped:
    """The body's rotation against the road as a rotation vector (x forward, y left, z up): y = -pitch."""
    message = Vector3Stamped(header=header_message(header))
    message.vector.y = math.nan if motion is None else -float(motion.pitch_rad)
    return message


def read_motion(
    twist: TwistStamped, attitude: Vector3Stamped | None, twist_topic: str, attitude_topic: str
) -> EgoMotion | None:
    """How our vehicle moves; None if the speed is NaN, which stands for unknown.

    Raises:
        ValueError: If a number is infinite, or the yaw rate is NaN although the speed is known.
    """
    speed_mps, yaw_rate_radps = twist.twist.linear.x, twist.twist.angular.z
    if math.isnan(speed_mps):
        return None
    if not (math.isfinite(speed_mps) and math.isfinite(yaw_rate_radps)):
        raise ValueError(
            f"{twist_topic}: twist: expected finite linear.x and angular.z, got {speed_mps} and {yaw_rate_radps}"
        )
    pitch_rad = math.nan if attitude is None else -attitude.vector.y
    if math.isinf(pitch_rad):
        raise ValueError(f"{attitude_topic}: vector.y: expected a finite number or NaN, got {pitch_rad}")
    return EgoMotion(speed_mps, yaw_rate_radps, pitch_rad)


def road_message(header: Header, road: RoadAhead | None) -> PointCloud2:
    """The road ahead, a row for each point; no rows if there is no road."""
    points = np.zeros((0, 3)) if road is None else road.points_m
    count = len(points)
    width_m, bound_m = (math.nan, math.nan) if road is None else (road.half_width_m, road.error_bound_m)
    return table_message(
        header,
        {
            "point_m": points,
            "cross_slope": np.zeros(0) if road is None else road.cross_slopes,
            "half_width_m": np.full(count, width_m),
            "error_bound_m": np.full(count, bound_m),
        },
    )


def read_road(message: PointCloud2, topic: str) -> RoadAhead | None:
    """The road ahead; None if the table has no rows.

    Raises:
        ValueError: If it is no such table or no valid road, or width and bound differ between rows.
    """
    _, columns = read_table(message, topic, ROAD)
    points = columns["point_m"]
    if not len(points):
        return None
    width_m, bound_m = columns["half_width_m"], columns["error_bound_m"]
    if not ((width_m == width_m[0]).all() and (bound_m == bound_m[0]).all()):
        raise ValueError(f"{topic}: half_width_m, error_bound_m: expected the same numbers in all rows")
    try:
        return RoadAhead(points, float(width_m[0]), columns["cross_slope"], float(bound_m[0]))
    except ValueError as error:
        raise ValueError(f"{topic}: {error}") from None
