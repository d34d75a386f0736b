"""The header of every message: when the image was taken, and which sequence it belongs to."""

from __future__ import annotations

import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from std_msgs.msg import Header as HeaderMessage

from foreglow.files import in_unicode

MAX_NAME = 256
"""Longest name of a sequence, characters."""


@dataclass(frozen=True, slots=True)
class Header:
    """Identifies the frame that a message belongs to: all messages of one frame have equal headers.

    Attributes:
        timestamp_ns: Time of exposure, nanoseconds; `stamp` in a message.
        sequence: Name of the sequence; `frame_id` in a message. When it changes, every stage is reset.
    """

    timestamp_ns: int
    sequence: str = ""


def header_message(header: Header) -> HeaderMessage:
    """The header as a ROS message, in whose name `?` stands for what is no Unicode.

    Raises:
        ValueError: If the time is more than 68 years from zero: a stamp has seconds of 32 bits.
    """
    sec, nanosec = divmod(header.timestamp_ns, 1_000_000_000)
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"header.stamp: expected a time within 68 years of zero, got {sec} s")
    return HeaderMessage(stamp=Time(sec=sec, nanosec=nanosec), frame_id=in_unicode(header.sequence))


def read_header(message: HeaderMessage, topic: str) -> Header:
    """The header of a message that was received on `topic`.

    Raises:
        ValueError: If `nanosec` is a second or more, or `frame_id` is too long.
    """
    if not 0 <= message.stamp.nanosec < 1_000_000_000:
        raise ValueError(f"{topic}: header.stamp.nanosec: expected less than 1e9, got {message.stamp.nanosec}")
    if len(message.frame_id) > MAX_NAME:
        raise ValueError(
            f"{topic}: header.frame_id: expected at most {MAX_NAME} characters, got {len(message.frame_id)}"
        )
    return Header(message.stamp.sec * 1_000_000_000 + message.stamp.nanosec, message.frame_id)


def byte_array(values: NDArray[Any]) -> array.array[int]:
    """The bytes of `values` as an `array.array`, which rclpy copies at once instead of checking every byte."""
    data = array.array("B")
    if values.size:
        data.frombytes(np.ascontiguousarray(values).view(np.uint8).reshape(-1).data)
    return data
