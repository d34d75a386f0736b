"""Numbers, texts and bytes read from a buffer in sequence; never beyond its end, and without copies."""

from __future__ import annotations

import struct
from typing import Literal, TypeAlias

from foreglow.protobuf import protobuf_fields

MAX_TEXT_BYTES = 4096
"""Longest text in a record or a message: names of topics, types, frames and encodings."""

MAX_FIELDS = 1000
"""Fields of a protobuf message or of a ROS 1 header; those that we read have ten."""

Format: TypeAlias = Literal["B", "H", "I", "Q", "i"]
"""As in `struct`: unsigned of 1, 2, 4 and 8 bytes; signed of 4."""


class Cursor:
    """Reads a buffer from its start.

    MCAP and ROS 1 have their fields in sequence, little-endian, and a text after its length. Every method takes the
    name of the field for its error message.

    Raises:
        ValueError: If a field does not fit into the buffer, or a text is not UTF-8; the message starts with the field.
    """

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self._position = 0
        self._order = "<"

    @property
    def is_at_end(self) -> bool:
        """Whether everything was read."""
        return self._position >= len(self._data)

    def take(self, count: int, field: str) -> memoryview:
        """The next `count` bytes."""
        end = self._position + count
        if end > len(self._data):
            raise ValueError(f"{field}: expected {count} bytes, the data end after {len(self._data) - self._position}")
        taken, self._position = self._data[self._position : end], end
        return taken

    def rest(self) -> memoryview:
        """All bytes that are left."""
        return self.take(len(self._data) - self._position, "rest")

    def number(self, kind: Format, field: str) -> int:
        """The next whole number."""
        (value,) = struct.unpack(self._order + kind, self.take(struct.calcsize(kind), field))
        return int(value)

    def text(self, field: str) -> str:
        """The next text."""
        return text_of(self.block(field), field)

    def block(self, field: str) -> memoryview:
        """The next bytes, after their number, which has 4 bytes."""
        return self.take(self.number("I", field), field)


class CdrCursor(Cursor):
    """Reads a message of ROS 2: numbers at multiples of their size, a text ends with a zero byte.

    Source: OMG Common Data Representation, version 1, with the encapsulation header of RTPS.
    """

    def __init__(self, data: memoryview) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise ValueError(f"header: expected plain CDR (0000 or 0001), got {bytes(data[:2]).hex() or 'nothing'}")
        super().__init__(data[4:])
        self._order = "<" if data[1] else ">"

    def number(self, kind: Format, field: str) -> int:
        """The next whole number, after the padding before it."""
        self.take(-self._position % struct.calcsize(kind), field)
        return super().number(kind, field)

    def text(self, field: str) -> str:
        """The next text."""
        return super().text(field).removesuffix("\0")


def latest_fields(message: memoryview) -> dict[int, int | memoryview]:
    """The fields of a protobuf message by number, the last value of each.

    Raises:
        ValueError: If the message is malformed, or has too many.
    """
    fields: dict[int, int | memoryview] = {}
    for number, value in protobuf_fields(message):
        fields[number] = value
        if len(fields) > MAX_FIELDS:
            raise ValueError(f"expected at most {MAX_FIELDS} fields, got more")
    return fields


def text_of(data: memoryview, field: str) -> str:
    """The UTF-8 text in `data`.

    Raises:
        ValueError: If it is not UTF-8.
    """
    if len(data) > MAX_TEXT_BYTES:
        raise ValueError(f"{field}: expected at most {MAX_TEXT_BYTES} bytes, got {len(data)}")
    try:
        return str(data, "utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{field}: expected UTF-8 text, got {bytes(data[:20])!r}") from None
