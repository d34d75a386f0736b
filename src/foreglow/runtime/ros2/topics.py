"""The topics' names, relative to the namespace, their types and qualities of service."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TwistStamped, Vector3Stamped
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

IMAGE = "camera/image_raw"
CAMERA_INFO = "camera/camera_info"
MOUNT = "camera/mount"
DAMAGE = "camera/damage"
TWIST = "vehicle/twist"
ATTITUDE = "vehicle/attitude"
REPORTED = "vehicle/reported"
ROAD = "road_ahead"
PROPOSALS = "proposals"
DETECTIONS = "detections"
RANGES = "ranges"
TRACKS = "tracks"
BEAM = "beam"
TIMING = "timing"
DIAGNOSTICS = "/diagnostics"

TYPES: dict[str, type[Any]] = {
    IMAGE: Image,
    CAMERA_INFO: CameraInfo,
    MOUNT: PointCloud2,
    DAMAGE: PointCloud2,
    TWIST: TwistStamped,
    ATTITUDE: Vector3Stamped,
    REPORTED: PointCloud2,
    ROAD: PointCloud2,
    PROPOSALS: PointCloud2,
    DETECTIONS: PointCloud2,
    RANGES: PointCloud2,
    TRACKS: PointCloud2,
    BEAM: PointCloud2,
    TIMING: PointCloud2,
}

INPUTS = (CAMERA_INFO, MOUNT, TWIST, ATTITUDE, ROAD, DAMAGE, REPORTED, IMAGE)
"""What the source publishes."""

SENSORS = (IMAGE, CAMERA_INFO, TWIST, ATTITUDE)
"""Topics that other people's drivers publish, too; we accept any reliability that they offer."""

FAST = (TWIST, ATTITUDE)
"""Topics of small messages that may come a thousand times a second, as an inertial sensor's do."""

NUM_KEPT = 10
"""Messages that are kept for a slow subscriber."""


def type_name(kind: type[Any]) -> str:
    """ROS 2's name of a type of messages.

    >>> type_name(Image)
    'sensor_msgs/msg/Image'
    """
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def publisher_quality(topic: str) -> QoSProfile:
    """Best effort for images, as cameras publish them; all else is reliable."""
    return _quality(NUM_KEPT if topic != IMAGE else 4, is_reliable=topic != IMAGE)


def subscriber_quality(topic: str, depth: int = NUM_KEPT) -> QoSProfile:
    """Best effort for `SENSORS`, which matches any publisher; all else is reliable."""
    return _quality(depth, is_reliable=topic not in SENSORS)


def _quality(depth: int, *, is_reliable: bool) -> QoSProfile:
    reliability = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=reliability)
