"""Image messages of ROS 1, ROS 2 and Foxglove: their time and their picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from foreglow.datasets.bags.cursor import CdrCursor, Cursor, latest_fields, text_of
from foreglow.datasets.bags.pixels import Pixels, grey_image
from foreglow.datasets.images import decode_image
from foreglow.types import Image

NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ImageMessage:
    """An image message whose picture is not decoded yet.

    Attributes:
        stamp_ns: Time in its header, nanoseconds; 0 where there is none.
        content: Pixels, or the bytes of a PNG or JPEG.
    """

    stamp_ns: int
    content: Pixels | memoryview

    def image(self) -> Image:
        """The grey image.

        Raises:
            ValueError: If the picture is damaged, or its size or encoding is not accepted; the message starts with the
                field.
        """
        if isinstance(self.content, Pixels):
            return grey_image(self.content)
        return decode_image(bytes(self.content), "data")


def _ros1(data: memoryview) -> Cursor:
    cursor = Cursor(data)
    cursor.number("I", "header.seq")
    return cursor


def _image(cursor: Cursor, seconds: Literal["i", "I"]) -> ImageMessage:
    """sensor_msgs/Image, from its time stamp on."""
    stamp_ns = _ros_stamp_ns(cursor, seconds)
    height, width = cursor.number("I", "height"), cursor.number("I", "width")
    encoding, is_big_endian = cursor.text("encoding"), cursor.number("B", "is_bigendian")
    step = cursor.number("I", "step")
    return ImageMessage(stamp_ns, Pixels(height, width, encoding, bool(is_big_endian), step, cursor.block("data")))


def _compressed(cursor: Cursor, seconds: Literal["i", "I"]) -> ImageMessage:
    """sensor_msgs/CompressedImage, from its time stamp on; its format is not used."""
    stamp_ns = _ros_stamp_ns(cursor, seconds)
    cursor.text("format")
    return ImageMessage(stamp_ns, cursor.block("data"))


def _foxglove_image(data: memoryview) -> ImageMessage:
    fields = latest_fields(data)
    pixels = Pixels(
        height_px=_number(fields, 3, "height"),
        width_px=_number(fields, 2, "width"),
        encoding=text_of(_bytes(fields, 4, "encoding"), "encoding"),
        is_big_endian=False,
        step=_number(fields, 5, "step"),
        data=_bytes(fields, 6, "data"),
    )
    return ImageMessage(_foxglove_stamp_ns(fields), pixels)


def _foxglove_compressed(data: memoryview) -> ImageMessage:
    fields = latest_fields(data)
    return ImageMessage(_foxglove_stamp_ns(fields), _bytes(fields, 2, "data"))


DECODERS: Mapping[tuple[str, str], Callable[[memoryview], ImageMessage]] = MappingProxyType(
    {
        ("sensor_msgs/Image", "ros1"): lambda data: _image(_ros1(data), "I"),
        ("sensor_msgs/msg/Image", "cdr"): lambda data: _image(CdrCursor(data), "i"),
        ("sensor_msgs/CompressedImage", "ros1"): lambda data: _compressed(_ros1(data), "I"),
        ("sensor_msgs/msg/CompressedImage", "cdr"): lambda data: _compressed(CdrCursor(data), "i"),
        ("foxglove.RawImage", "protobuf"): _foxglove_image,
        ("foxglove.CompressedImage", "protobuf"): _foxglove_compressed,
    }
)
"""Decoders by the type of a message and its encoding; each raises ValueError, with the field, for a broken message."""


def _ros_stamp_ns(cursor: Cursor, seconds: Literal["i", "I"]) -> int:
    """The time in a header, whose frame id is skipped; ROS 2 has signed seconds."""
    stamp_ns = cursor.number(seconds, "header.stamp.sec") * NS + cursor.number("I", "header.stamp.nanosec")
    cursor.text("header.frame_id")
    return stamp_ns


def _foxglove_stamp_ns(fields: Mapping[int, int | memoryview]) -> int:
    """The google.protobuf.Timestamp in field 1."""
    stamp = latest_fields(_bytes(fields, 1, "timestamp"))
    return _number(stamp, 1, "timestamp.seconds") * NS + _number(stamp, 2, "timestamp.nanos")


def _number(fields: Mapping[int, int | memoryview], number: int, field: str) -> int:
    value = fields.get(number, 0)
    if isinstance(value, memoryview):
        raise ValueError(f"{field}: expected a number, got {len(value)} bytes")
    return value


def _bytes(fields: Mapping[int, int | memoryview], number: int, field: str) -> memoryview:
    value = fields.get(number, memoryview(b""))
    if isinstance(value, int):
        raise ValueError(f"{field}: expected bytes, got the number {value}")
    return value
