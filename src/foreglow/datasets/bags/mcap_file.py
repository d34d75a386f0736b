"""MCAP files, read from front to back, so that also the file of a killed recorder can be read.

Source: mcap.dev/spec, version 0.
"""

from __future__ import annotations

import contextlib
import re
import zlib
from collections.abc import Collection, Generator, Iterator
from pathlib import Path
from typing import BinaryIO

from foreglow.datasets.bags.containers import (
    MAX_BYTES,
    Message,
    Refuse,
    Topic,
    continuation,
    decompressed,
    incomplete,
    is_partial,
    unfinished,
)
from foreglow.datasets.bags.cursor import Cursor

MAGIC = b"\x89MCAP0\r\n"

END_METADATA_NAME, IS_COMPLETE = "foreglow_end", "is_complete"
"""Metadata record at the end of our own recordings, and its entry, `true` or `false`: whether all frames of the source
are in it."""

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0B, 0x0F
_METADATA, _METADATA_INDEX = 0x0C, 0x0D
_READ = frozenset({_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK})
_FOOTER_BYTES, _DATA_END_BYTES = 20, 4
_HEAD_BYTES = 9  # a record: opcode (1 byte), length (8), content
_DATA_END_HEAD = bytes([_DATA_END, *_DATA_END_BYTES.to_bytes(8, "little")])
_MAX_END_BYTES = 1 << 12  # longest record of metadata about the end that is read; ours has some 60

MAX_BREAKS = 100
"""In the order of records; a file may be made of chunks within chunks, each of which is read to its end."""

_CHUNK_HEAD = re.compile(rb"\x06.{4}\0{4}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd).{4}\0{4}", re.DOTALL)
"""Opcode, length, two times, size, checksum, compression, and length of its records; lengths are below 4 GiB."""

_CHUNK_HEAD_BYTES = 53  # the longest
_PIECE_BYTES = 1 << 24  # of a file that is searched: never mapped, as another program may cut it meanwhile


class McapFile:
    """A `Container`; opening it checks its start and its end."""

    def __init__(self, path: Path) -> None:
        """Checks the file's start and end.

        Raises:
            ValueError: If it is not an MCAP file.
        """
        self._path = path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError(f"{path}: expected an MCAP file, it does not start like one")
            self._size = file.seek(0, 2)
            file.seek(max(len(MAGIC), self._size - len(MAGIC)))
            end = self._size if file.read() == MAGIC else self._walked_end(file)
        self.truncation = "" if end or is_partial(path) else f"{path}: truncated recording, its end is missing"
        self._end = end or self._size
        if end:
            self.lack = incomplete(path) if self._is_cut() else ""
        else:
            self.lack = unfinished(path) if is_partial(path) else ""

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """As in `Container`; a topic that was defined in a damaged chunk is known from the end of the file.

        Where records do not follow each other, since bytes are missing or too many, the next whole chunk is looked for.
        """
        channels = _Channels(names)
        self._read_summary(channels)
        with self._path.open("rb") as file:
            start = len(MAGIC)
            for _ in range(MAX_BREAKS):
                file.seek(start)
                broken = yield from self._following(file, channels, refuse)
                found = None if broken is None else _next_chunk(file, broken)
                if found is None:
                    return
                start = found
        refuse(f"{self._path}: byte {start}: expected at most {MAX_BREAKS} damaged parts, what follows is not read")

    def _following(self, file: BinaryIO, channels: _Channels, refuse: Refuse) -> Generator[Message, None, int | None]:
        """The messages in the records that follow each other from here; returns where they broke, None at the end."""
        broken, complaints = file.tell(), list[str]()
        for position, kind, length in self._heads(file, complaints.append):
            broken = position + _HEAD_BYTES + length
            if kind in (_DATA_END, _FOOTER):
                self._check_end(file, position, refuse)
                return None
            if kind not in _READ:
                continue
            try:
                if length > MAX_BYTES:
                    raise ValueError(f"expected a record of at most {MAX_BYTES} bytes, got {length}")
                yield from channels.messages(kind, memoryview(file.read(length)))
            except ValueError as error:
                refuse(f"{self._path}: byte {position}: {error}")
                broken = position + 1  # its length may be wrong, or bytes of it be missing
        if not complaints and (self.truncation or is_partial(self._path)):
            return None
        expected = f"{self._path}: expected records up to the end, one of them is malformed"
        refuse(complaints[0] if complaints else expected)
        return broken

    def count(self, name: str) -> int | None:
        """As in `Container`: by the statistics at the end."""
        channels = _Channels(None)
        counts = self._read_summary(channels)
        wanted = [number for number, topic in channels.topics.items() if topic.name == name]
        return sum(counts.get(number, 0) for number in wanted) if counts and wanted else None

    def _check_end(self, file: BinaryIO, position: int, refuse: Refuse) -> None:
        """Refuses what lies behind the footer; `position` is that of a record after all messages.

        What is between them may be damaged, as it is not needed.
        """
        file.seek(position)
        end = self._size
        with contextlib.suppress(ValueError):
            for found, kind, length in self._heads(file, _raise):
                if kind == _FOOTER and length == _FOOTER_BYTES:
                    end = found + _HEAD_BYTES + length + len(MAGIC)
                    break
        if end < self._size:
            refuse(continuation(self._path, end, self._size))

    def _walked_end(self, file: BinaryIO) -> int:
        """Where the recording ends if something lies behind it, by its records from its start on; 0 if nowhere."""
        file.seek(len(MAGIC))
        with contextlib.suppress(ValueError):
            for position, kind, length in self._heads(file, _raise):
                if kind == _FOOTER:
                    end = position + _HEAD_BYTES + length
                    file.seek(end)
                    return end + len(MAGIC) if file.read(len(MAGIC)) == MAGIC else 0
        return 0

    def _read_summary(self, channels: _Channels) -> dict[int, int]:
        """Adds the definitions at the end of the file to `channels`, and returns the numbers of messages by channel.

        Without an end there are none of both; of a damaged end, what is before the damage.
        """
        counts = dict[int, int]()
        with contextlib.suppress(ValueError), self._path.open("rb") as file:
            for kind, length in self._summary_heads(file):
                if kind in (_SCHEMA, _CHANNEL):
                    channels.add(kind, Cursor(memoryview(file.read(length))))
                elif kind == _STATISTICS:
                    counts = _message_counts(Cursor(memoryview(file.read(length))))
        return counts

    def _is_cut(self) -> bool:
        """Whether it says of itself that its source was not read to the end; foreign recordings say nothing."""
        with contextlib.suppress(ValueError), self._path.open("rb") as file:
            for kind, length in self._summary_heads(file):
                if kind != _METADATA_INDEX:
                    continue
                index = Cursor(memoryview(file.read(length)))
                start, size = index.number("Q", "offset"), index.number("Q", "length")
                if index.text("name") == END_METADATA_NAME and size <= _MAX_END_BYTES:
                    file.seek(start)
                    return _is_false(file.read(size))
        return False

    def _summary_heads(self, file: BinaryIO) -> Iterator[tuple[int, int]]:
        """Opcode and length of each record of the summary at the end of the file, which is then at its content."""
        footer = max(0, self._end - len(MAGIC) - _FOOTER_BYTES)
        file.seek(footer)
        start = Cursor(memoryview(file.read(_FOOTER_BYTES))).number("Q", "summary")
        if start == 0:
            return
        last = footer - _HEAD_BYTES
        if not self._leads_to(file, start, last) and self._leads_to(file, behind := _behind_data(file, footer), last):
            start = behind  # bytes are missing before
        if start >= self._end:
            return
        file.seek(start)
        for position, kind, length in self._heads(file, _raise):
            if position >= last or length > MAX_BYTES:
                return
            yield kind, length

    def _leads_to(self, file: BinaryIO, start: int, end: int) -> bool:
        """Whether the records from `start` on follow each other up to `end`."""
        if start > end:
            return False
        file.seek(start)
        return any(position == end for position, _, _ in self._heads(file, lambda _: None))

    def _heads(self, file: BinaryIO, refuse: Refuse) -> Iterator[tuple[int, int, int]]:
        """Position, opcode and length of each complete record; `file` is then at its content. Ends at a cut record."""
        position = file.tell()
        while position + _HEAD_BYTES <= self._size:
            head = file.read(_HEAD_BYTES)
            if len(head) < _HEAD_BYTES:  # the file was cut since it was opened
                return
            kind, length = head[0], int.from_bytes(head[1:], "little")
            if kind == 0:
                refuse(f"{self._path}: byte {position}: expected a record of MCAP, got {head[:4].hex()}")
                return
            if position + _HEAD_BYTES + length > self._size:
                return
            yield position, kind, length
            position += _HEAD_BYTES + length
            file.seek(position)


class _Channels:
    """The topics by the numbers of their channels, and the messages on them."""

    def __init__(self, names: Collection[str] | None) -> None:
        self._names = names
        self._schemas = {0: ""}
        self.topics: dict[int, Topic] = {}

    def messages(self, kind: int, data: memoryview) -> Iterator[Message]:
        """The messages in a record: a message or a chunk of messages; a definition is stored."""
        cursor = Cursor(data)
        if kind == _CHUNK:
            for inner_kind, inner in _records(_chunk(cursor)):
                if inner_kind in _READ - {_CHUNK}:
                    yield from self.messages(inner_kind, inner)
        elif kind == _MESSAGE:
            topic = self.topics.get(number := cursor.number("H", "channel"))
            if topic is None:
                raise ValueError(f"channel: expected a defined channel, got {number}")
            cursor.number("I", "sequence")
            log_time_ns = cursor.number("Q", "log_time")
            cursor.number("Q", "publish_time")
            if self._names is None or topic.name in self._names:
                yield Message(topic, log_time_ns, cursor.rest())
        else:
            self.add(kind, cursor)

    def add(self, kind: int, cursor: Cursor) -> None:
        """Stores a schema or a channel."""
        number = cursor.number("H", "id")
        if kind == _SCHEMA:
            self._schemas[number] = cursor.text("name")
            return
        schema = cursor.number("H", "schema_id")
        topic, encoding = cursor.text("topic"), cursor.text("message_encoding")
        self.topics[number] = Topic(topic, self._schemas.get(schema, ""), encoding)


def _behind_data(file: BinaryIO, end: int) -> int:
    """Position behind the last record before `end` that looks like the one that ends the data; `end` without any."""
    place = end
    while place > 0:
        start = max(0, place - _PIECE_BYTES)
        file.seek(start)
        found = file.read(min(place + len(_DATA_END_HEAD) - 1, end) - start).rfind(_DATA_END_HEAD)
        if found >= 0:
            return start + found + len(_DATA_END_HEAD) + _DATA_END_BYTES
        place = start
    return end


def _next_chunk(file: BinaryIO, start: int) -> int | None:
    """Position of the first chunk from `start` on that fits into the file and whose two lengths agree."""
    size = file.seek(0, 2)
    for place in range(start, size, _PIECE_BYTES):
        file.seek(place)
        data = file.read(_PIECE_BYTES + _CHUNK_HEAD_BYTES - 1)
        found = _CHUNK_HEAD.search(data)
        while found is not None and found.start() < _PIECE_BYTES:
            length, inner = (int.from_bytes(found[0][part], "little") for part in (slice(1, 9), slice(-8, None)))
            head_bytes = found.end() - found.start()
            if _HEAD_BYTES + length == head_bytes + inner and place + found.end() + inner <= size:
                return place + found.start()
            found = _CHUNK_HEAD.search(data, found.start() + 1)
    return None


def _records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record in a chunk."""
    cursor = Cursor(data)
    while not cursor.is_at_end:
        kind = cursor.number("B", "opcode")
        yield kind, cursor.take(cursor.number("Q", "length"), "record")


def _chunk(cursor: Cursor) -> memoryview:
    """The records of a chunk, decompressed and checked."""
    for field in ("message_start_time", "message_end_time"):
        cursor.number("Q", field)
    size, checksum = cursor.number("Q", "uncompressed_size"), cursor.number("I", "uncompressed_crc")
    compression = cursor.text("compression")
    records = decompressed(cursor.take(cursor.number("Q", "records"), "records"), compression, size)
    if checksum and zlib.crc32(records) != checksum:
        raise ValueError("damaged chunk, its checksum is wrong")
    return records


def _is_false(record: bytes) -> bool:
    """Whether the entry of a record of metadata about our recordings' end says that it is not complete."""
    cursor = Cursor(memoryview(record))
    if cursor.number("B", "opcode") != _METADATA:
        return False
    cursor.number("Q", "length")
    cursor.text("name")
    entries = Cursor(cursor.block("metadata"))
    while not entries.is_at_end:
        if (entries.text("key"), entries.text("value")) == (IS_COMPLETE, "false"):
            return True
    return False


def _message_counts(cursor: Cursor) -> dict[int, int]:
    """Number of messages by channel, from a statistics record."""
    cursor.take(8 + 2 + 4 * 4 + 2 * 8, "statistics")
    counts = Cursor(cursor.block("channel_message_counts"))
    found = dict[int, int]()
    while not counts.is_at_end:
        channel = counts.number("H", "channel")
        found[channel] = counts.number("Q", "count")
    return found


def _raise(message: str) -> None:
    raise ValueError(message)
