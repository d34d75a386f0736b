"""ROS 1 bags, read from front to back without their index, so that also the bag of a killed `rosbag record` is read.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import contextlib
import itertools
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO

from foreglow.datasets.bags.containers import (
    MAX_BYTES,
    Message,
    Refuse,
    Topic,
    check_num_topics,
    continuation,
    decompressed,
    is_partial,
    unfinished,
)
from foreglow.datasets.bags.cursor import MAX_FIELDS, Cursor, text_of

MAX_HEADER_BYTES = 1 << 20
"""Longest header of a record; that of a connection has the definition of its messages, some kilobytes."""

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _CHUNK, _CONNECTION = 0x02, 0x05, 0x07
_READ = frozenset({_MESSAGE, _CHUNK, _CONNECTION})


class Ros1Bag:
    """A `Container`."""

    def __init__(self, path: Path) -> None:
        """Reads the header.

        Raises:
            ValueError: If it is not a bag of version 2.0.
        """
        self._path = path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError(f"{path}: expected a ROS 1 bag of version 2.0, it does not start like one")
            self._size = file.seek(0, 2)
            self._end = self._size
            file.seek(len(MAGIC))
            try:
                first = next((header for _, header, _ in self._heads(file)), {})
            except _HeaderError as error:
                raise ValueError(f"{path}: {error}") from None
            end = self._index_end(file, first)
        self.truncation = "" if end or is_partial(path) else f"{path}: truncated bag, its index is missing or cut"
        self.lack = unfinished(path) if is_partial(path) and not end else ""
        self._end = end or self._size

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """As in `Container`."""
        connections = _Connections(names)
        with self._path.open("rb") as file:
            file.seek(len(MAGIC))
            end = len(MAGIC)
            try:
                for position, header, length in self._heads(file):
                    end = file.tell() + length
                    if header["op"][0] not in _READ:
                        continue
                    if length > MAX_BYTES:
                        refuse(f"{self._path}: byte {position}: expected at most {MAX_BYTES} bytes, got {length}")
                        continue
                    data = memoryview(file.read(length))
                    try:
                        yield from connections.messages(header, data)
                    except ValueError as error:
                        refuse(f"{self._path}: byte {position}: {error}")
            except _HeaderError as error:
                refuse(f"{self._path}: {error}")
                return
        if end < self._end and not self.truncation and not is_partial(self._path):
            refuse(f"{self._path}: byte {end}: expected a record, it is malformed")
        if self._end < self._size:
            refuse(continuation(self._path, self._end, self._size))

    def count(self, name: str) -> int | None:  # noqa: ARG002
        """As in `Container`: unknown."""
        return None

    def _index_end(self, file: BinaryIO, header: dict[str, bytes]) -> int:
        """End of the index that the bag's `header` announces, a record for each connection and each chunk; 0 if cut."""
        position, *counts = (
            int.from_bytes(header.get(name, b""), "little") for name in ("index_pos", "conn_count", "chunk_count")
        )
        if not 0 < position <= self._size:
            return 0
        num_left, end = sum(counts), position
        file.seek(position)
        with contextlib.suppress(_HeaderError):
            for _, _, length in itertools.islice(self._heads(file), num_left):
                num_left, end = num_left - 1, file.tell() + length
        return 0 if num_left else end

    def _heads(self, file: BinaryIO) -> Iterator[tuple[int, dict[str, bytes], int]]:
        """Position, header and data length of each complete record, with `file` at its data; ends at a cut one."""
        position = file.tell()
        while position + 8 <= self._end:
            length = int.from_bytes(file.read(4), "little")
            if position + 8 + length > self._end:
                return
            try:
                header = _fields(memoryview(file.read(min(length, MAX_HEADER_BYTES + 1))))
            except ValueError as error:
                raise _HeaderError(f"byte {position}: {error}") from None
            data_length = int.from_bytes(file.read(4), "little")
            end = position + 8 + length + data_length
            if end > self._end:
                return
            yield position, header, data_length
            file.seek(position := end)


class _HeaderError(ValueError):
    """A record's header is broken, so that the start of the next record is unknown."""


class _Connections:
    """The topics by the numbers of their connections, and the messages on them."""

    def __init__(self, names: Collection[str] | None) -> None:
        self._names = names
        self._topics: dict[bytes, Topic] = {}

    def messages(self, header: dict[str, bytes], data: memoryview) -> Iterator[Message]:
        """The messages in a record: a message or a chunk of messages; a connection is stored."""
        kind = header["op"][0]
        if kind == _CHUNK:
            size = int.from_bytes(_field(header, "size"), "little")
            compression = text_of(memoryview(_field(header, "compression")), "compression")
            cursor = Cursor(decompressed(data, compression, size))
            while not cursor.is_at_end:
                inner = _fields(cursor.block("header"))
                content = cursor.block("data")
                if inner["op"][0] in (_MESSAGE, _CONNECTION):
                    yield from self.messages(inner, content)
        elif kind == _CONNECTION:
            fields = _fields(data, needs_op=False)
            name = text_of(memoryview(_field(header, "topic")), "topic")
            self._topics[_field(header, "conn")] = Topic(
                name, text_of(memoryview(_field(fields, "type")), "type"), "ros1"
            )
            check_num_topics(self._topics)
        else:
            topic = self._topics.get(number := _field(header, "conn"))
            if topic is None:
                raise ValueError(f"conn: expected a defined connection, got {int.from_bytes(number, 'little')}")
            time = _field(header, "time")
            if len(time) != 8:
                raise ValueError(f"time: expected 8 bytes, got {len(time)}")
            seconds, nanoseconds = struct.unpack("<II", time)
            if self._names is None or topic.name in self._names:
                yield Message(topic, seconds * 1_000_000_000 + nanoseconds, data)


def _fields(data: memoryview, *, needs_op: bool = True) -> dict[str, bytes]:
    """The fields `name=value` of a header; the header of a record has `op`, a single byte."""
    if len(data) > MAX_HEADER_BYTES:
        raise ValueError(f"header: expected at most {MAX_HEADER_BYTES} bytes, got more")
    cursor, fields = Cursor(data), dict[str, bytes]()
    while not cursor.is_at_end:
        if len(fields) > MAX_FIELDS:
            raise ValueError(f"header: expected at most {MAX_FIELDS} fields, got more")
        name, is_field, value = bytes(cursor.block("header")).partition(b"=")
        if not is_field:
            raise ValueError(f"header: expected fields name=value, got {name[:20]!r}")
        fields[name.decode("latin-1")] = value
    if needs_op and len(fields.get("op", b"")) != 1:
        raise ValueError("header: expected a field op of one byte, found none")
    return fields


def _field(fields: dict[str, bytes], name: str) -> bytes:
    if name not in fields:
        raise ValueError(f"{name}: the field is missing")
    return fields[name]
