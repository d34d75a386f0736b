"""Small recordings of other people's tools: rosbags, mcap and foxglove-sdk write them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.types import Image

HEIGHT, WIDTH = 64, 70
TOPIC, OTHER_TOPIC = "/camera/image_raw", "/right/image_raw"
START_NS = 1_700_000_000_123_456_789
STEP_NS = 50_000_000
KINDS = ("bag", "sqlite3", "mcap")


@dataclass(frozen=True)
class Picture:
    """What goes into one image message."""

    data: bytes
    encoding: str = "mono8"
    step: int = WIDTH
    is_bigendian: int = 0
    height: int = HEIGHT
    width: int = WIDTH


def images(count: int) -> list[Image]:
    return [np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH), np.uint8) for seed in range(count)]


def raw(image: Image) -> Picture:
    return Picture(image.tobytes())


def png(image: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


class BagWriter:
    """Writes ROS messages into a bag of one of `KINDS`; a bag of ROS 1 is a file, others are folders."""

    def __init__(self, folder: Path, kind: str, *, compression: str = "") -> None:
        self.is_ros1 = kind == "bag"
        self.path = folder / ("drive.bag" if self.is_ros1 else f"drive_{kind}")
        typesys = pytest.importorskip("rosbags.typesys")
        stores = typesys.Stores
        self.store = typesys.get_typestore(stores.ROS1_NOETIC if self.is_ros1 else stores.ROS2_JAZZY)
        self.types = self.store.types
        self._writer = self._opened(kind, compression)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> BagWriter:
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def image(self, log_time_ns: int, picture: Picture, stamp_ns: int, topic: str = TOPIC) -> None:
        message = self.types["sensor_msgs/msg/Image"](
            header=self._header(stamp_ns),
            height=picture.height,
            width=picture.width,
            encoding=picture.encoding,
            is_bigendian=picture.is_bigendian,
            step=picture.step,
            data=np.frombuffer(picture.data, np.uint8),
        )
        self._write(topic, "sensor_msgs/msg/Image", message, log_time_ns)

    def compressed(self, log_time_ns: int, data: bytes, stamp_ns: int, topic: str = TOPIC) -> None:
        message = self.types["sensor_msgs/msg/CompressedImage"](
            header=self._header(stamp_ns), format="png", data=np.frombuffer(data, np.uint8)
        )
        self._write(topic, "sensor_msgs/msg/CompressedImage", message, log_time_ns)

    def text(self, log_time_ns: int, topic: str = "/chatter") -> None:
        self._write(topic, "std_msgs/msg/String", self.types["std_msgs/msg/String"](data="dark"), log_time_ns)

    def _write(self, topic: str, kind: str, message: Any, log_time_ns: int) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self._writer.write(self._connections[topic], log_time_ns, serialize(message, kind))

    def _header(self, stamp_ns: int) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        counted = {"seq": 7} if self.is_ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id="camera", **counted)

    def _opened(self, kind: str, compression: str) -> Any:
        if self.is_ros1:
            from rosbags.rosbag1 import Writer as Ros1Writer

            writer: Any = Ros1Writer(self.path)
            if compression:
                writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
            return writer
        from rosbags.rosbag2 import StoragePlugin, Writer

        return Writer(self.path, version=9, storage_plugin=StoragePlugin[kind.upper()])


def make_bag(folder: Path, kind: str, pictures: Sequence[Picture], *, compression: str = "") -> Path:
    """Pictures a twentieth of a second apart on `TOPIC`, recorded 3 ms later; a text before each."""
    with BagWriter(folder, kind, compression=compression) as bag:
        for index, picture in enumerate(pictures):
            time_ns = START_NS + index * STEP_NS
            bag.text(time_ns)
            bag.image(time_ns + 3_000_000, picture, time_ns)
    return bag.path


def make_mcap(
    path: Path,
    pictures: Sequence[Image],
    *,
    compression: str = "ZSTD",
    chunk_size: int = 1,
    others: Sequence[Image] = (),
) -> Path:
    """Foxglove images in a file of the package mcap, 50 ms apart from 0 on; a chunk each, unless it shall be larger.

    On a second topic, `OTHER_TOPIC`, are `others` of the same times, if any.
    """
    pytest.importorskip("mcap")
    messages = pytest.importorskip("foxglove.messages")
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=chunk_size, compression=CompressionType[compression])
        writer.start()
        schema = messages.RawImage.get_schema()
        number = writer.register_schema(schema.name, schema.encoding, schema.data)
        channels = [writer.register_channel(topic, "protobuf", number) for topic in (TOPIC, OTHER_TOPIC)]
        sent = [
            (index, channel)
            for channel, each in zip(channels, (pictures, others), strict=True)
            for index in range(len(each))
        ]
        for index, channel in sorted(sent):
            image = (pictures, others)[channels.index(channel)][index]
            message = messages.RawImage(
                timestamp=messages.Timestamp(sec=0, nsec=index * STEP_NS),
                height=image.shape[0],
                width=image.shape[1],
                encoding="mono8",
                step=image.shape[1],
                data=image.tobytes(),
            )
            writer.add_message(channel, index * STEP_NS, message.encode(), index * STEP_NS)
        writer.finish()
    return path
