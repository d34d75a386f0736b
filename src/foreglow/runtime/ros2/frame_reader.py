"""Makes a `Frame` of the messages that belong to it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from foreglow.datasets.vehicle_data import VehicleData, equip
from foreglow.geometry import Camera
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.input_messages import (
    read_camera_info,
    read_damage,
    read_image,
    read_motion,
    read_mount,
    read_reported,
    read_road,
)
from foreglow.runtime.ros2.join import Joined
from foreglow.types import EgoMotion, Frame


class FrameReader:
    """Makes frames; while the camera does not change it stays the same object, by which stages cache their results."""

    def __init__(self, calibration: VehicleData | None = None) -> None:
        """A reader that takes the camera from a calibration, scaled to the image; None takes it from messages."""
        self._calibration = calibration
        self._known: tuple[Any, Camera | None] = (None, None)

    def read(self, joined: Joined) -> Frame:
        """The frame; without an image among the messages, its pixels are all zero, and its size is that of CameraInfo.

        Raises:
            ValueError: If a message cannot be used, the error names topic and field; if the calibration does not fit
                the image, it names the calibration's file.
        """
        messages = joined.messages
        if topics.IMAGE in messages:
            image = read_image(messages[topics.IMAGE], topics.IMAGE)
        else:
            info = messages[topics.CAMERA_INFO]
            image = np.broadcast_to(np.uint8(0), (info.height, info.width))
        road, damage, reported = (messages.get(topic) for topic in (topics.ROAD, topics.DAMAGE, topics.REPORTED))
        frame = Frame(
            image,
            joined.header.timestamp_ns,
            sequence=joined.header.sequence,
            path=topics.IMAGE,
            camera=None if self._calibration is not None else self._camera(messages),
            motion=motion_of(messages),
            road=None if road is None else read_road(road, topics.ROAD),
            is_damaged=damage is not None and read_damage(damage, topics.DAMAGE),
            is_reported=None if reported is None else read_reported(reported, topics.REPORTED),
        )
        return frame if self._calibration is None else equip(frame, self._calibration)

    def _camera(self, messages: Mapping[str, Any]) -> Camera | None:
        """The camera by its messages."""
        info, mount = messages[topics.CAMERA_INFO], messages.get(topics.MOUNT)
        key = (
            *(info.height, info.width, info.distortion_model, tuple(info.d), tuple(info.k)),
            *(info.roi, info.binning_x, info.binning_y),
            None if mount is None else (mount.fields, mount.point_step, mount.data),
        )
        if self._known[0] != key:
            _, intrinsics = read_camera_info(info, topics.CAMERA_INFO)
            camera: Camera | None = None
            if intrinsics is not None and mount is not None:
                pose, sigmas = read_mount(mount, topics.MOUNT)
                camera = Camera(**intrinsics.model_dump(), vehicle_from_camera=pose, mount_sigmas=sigmas)
            self._known = (key, camera)
        return self._known[1]


def motion_of(messages: Mapping[str, Any]) -> EgoMotion | None:
    """Our motion by the messages of a frame; None without one.

    Raises:
        ValueError: If a message cannot be used; the error names topic and field.
    """
    twist = messages.get(topics.TWIST)
    if twist is None:
        return None
    return read_motion(twist, messages.get(topics.ATTITUDE), topics.TWIST, topics.ATTITUDE)
