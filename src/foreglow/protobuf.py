"""Messages of protobuf, read without their descriptions.

Source: protobuf.dev, Encoding.
"""

from __future__ import annotations

from collections.abc import Iterator

_SIZES = {1: 8, 5: 4}
"""Bytes of a number, by its wire type."""

MAX_NUMBER = (1 << 29) - 1
"""Largest number of a field."""


def protobuf_fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field in turn: whole numbers unsigned, texts, bytes and messages as they are.

    Raises:
        ValueError: If the message is malformed.
    """
    position = 0
    while position < len(message):
        key, position = _varint(message, position)
        number, kind = key >> 3, key & 7
        if number > MAX_NUMBER:  # others take its last bits, and so for another field
            raise ValueError(f"field {number}: expected a number of at most {MAX_NUMBER}")
        if kind == 0:
            value, position = _varint(message, position)
            yield number, value
            continue
        if kind == 2:
            size, position = _varint(message, position)
        elif kind in _SIZES:
            size = _SIZES[kind]
        else:
            raise ValueError(f"field {number}: expected a wire type of 0, 1, 2 or 5, got {kind}")
        content = message[position : position + size]
        if len(content) < size:
            raise ValueError(f"field {number}: expected {size} bytes, the data end after {len(content)}")
        position += size
        yield number, content if kind == 2 else int.from_bytes(content, "little")


def whole_numbers(value: int | memoryview) -> Iterator[int]:
    r"""The whole numbers, unsigned, in one field of a list of them: one, or packed.

    >>> list(whole_numbers(memoryview(b"\x02\x80\x01"))), list(whole_numbers(3))
    ([2, 128], [3])

    Raises:
        ValueError: If they are malformed.
    """
    if isinstance(value, int):
        yield value
        return
    position = 0
    while position < len(value):
        number, position = _varint(value, position)
        yield number


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    """A number of seven bits a byte, and the position after it."""
    value = 0
    for index, byte in enumerate(message[position : position + 10]):
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value, position + index + 1
    raise ValueError("varint: expected a last byte within ten, and before the end of the data")
