"""Names of the topics, relative to the namespace, and how well each is delivered."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TwistStamped, Vector3Stamped
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

IMAGE = "camera/image_raw"
CAMERA_INFO = "camera/camera_info"
MOUNT = "camera/mount"
TWIST = "vehicle/twist"
ATTITUDE = "vehicle/attitude"
ROAD = "road_ahead"
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
    TWIST: TwistStamped,
    ATTITUDE: Vector3Stamped,
    ROAD: PointCloud2,
    DETECTIONS: PointCloud2,
    RANGES: PointCloud2,
    TRACKS: PointCloud2,
    BEAM: PointCloud2,
    TIMING: PointCloud2,
}

SENSORS = (IMAGE, CAMERA_INFO, TWIST, ATTITUDE)
"""What drivers of others publish, too: whatever they promise, we take it."""

NUM_KEPT = 10
"""Messages that are kept for a subscriber that is behind."""


def publisher_quality(topic: str) -> QoSProfile:
    """Images may be lost, as those of cameras may; all else arrives, unless a newer one has come meanwhile."""
    return _quality(NUM_KEPT if topic != IMAGE else 4, is_reliable=topic != IMAGE)


def subscriber_quality(topic: str, depth: int = NUM_KEPT) -> QoSProfile:
    """As published; from sensors also what is only tried once."""
    return _quality(depth, is_reliable=topic not in SENSORS)


def _quality(depth: int, *, is_reliable: bool) -> QoSProfile:
    reliability = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, history=HistoryPolicy.KEEP_LAST, reliability=reliability)
