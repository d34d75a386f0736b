"""ROS 2 bags: a folder with `metadata.yaml` and files of SQLite or MCAP, or such a file alone."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

from foreglow.datasets.bags.containers import (
    MAX_BYTES,
    Container,
    Message,
    Refuse,
    Topic,
    check_num_topics,
    continuation,
    is_partial,
    unfinished,
)
from foreglow.datasets.bags.mcap_file import McapFile
from foreglow.files import read_yaml

METADATA = "metadata.yaml"

SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError)
"""Errors about a damaged file: the second where the damage is in the error's own text."""

MAX_STEPS = 10_000_000
MAX_STEPS_A_BYTE = 100
"""Instructions of SQLite's machine for a query, and more for each byte of the file. A message takes 20 of them and has
20 bytes; pages that refer to each other take any number."""

MAX_TOPIC_BYTES = 1 << 16
"""Longest text of a topic, and of the table's definition."""

_STEPS_AT_ONCE = 10_000

_TABLES = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("id", "topic_id", "timestamp", "data"),
}

SQLITE_MAGIC = b"SQLite format 3\0"


class SqliteBag:
    """A `Container`: a file of a bag in SQLite, whose messages come in the order in which they were written.

    Source: github.com/ros2/rosbag2, rosbag2_storage_sqlite3.
    """

    def __init__(self, path: Path) -> None:
        """Reads its topics.

        Raises:
            ValueError: If it is not a bag, or is cut within a page, which SQLite would fill with zeros.
        """
        self._path = path
        size, expected, page, is_sure = _sizes(path)
        if size < expected and size % page:
            raise ValueError(f"{path}: truncated bag, expected whole pages of {page} bytes, got {size} bytes")
        self.truncation = f"{path}: truncated bag, {expected - size} bytes are missing" if size < expected else ""
        self.lack = unfinished(path) if is_partial(path) else ""
        self._continuation = continuation(path, expected, size) if is_sure and expected < size else ""
        try:
            with closing(self._connect(MAX_TOPIC_BYTES)) as connection:
                _check_tables(connection)
                rows = []
                for row in connection.execute("SELECT id, name, type, serialization_format FROM topics"):
                    rows.append(row)
                    check_num_topics(rows)
        except SQLITE_ERRORS as error:
            raise ValueError(f"{path}: expected a ROS 2 bag in SQLite: {error}") from None
        if not all([type(value) for value in row] == [int, str, str, str] for row in rows):
            raise ValueError(f"{path}: topics: expected numbers, names, types and formats")
        self._topics = {row[0]: Topic(*row[1:]) for row in rows}

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """As in `Container`."""
        wanted = [number for number, topic in self._topics.items() if names is None or topic.name in names]
        marks = ",".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id"
        try:
            with closing(self._connect()) as connection:
                for number, log_time_ns, data in connection.execute(query, wanted):
                    if not isinstance(log_time_ns, int) or not isinstance(data, bytes):
                        refuse(f"{self._path}: messages: expected a time and bytes, got others")
                        continue
                    yield Message(self._topics[number], log_time_ns, memoryview(data))
        except SQLITE_ERRORS as error:
            refuse(f"{self._path}: damaged file: {error}")
        if self._continuation:
            refuse(self._continuation)

    def count(self, name: str) -> int | None:
        """As in `Container`."""
        query = "SELECT COUNT(*) FROM messages JOIN topics ON topic_id = topics.id WHERE name = ?"
        try:
            with closing(self._connect()) as connection:
                return int(connection.execute(query, (name,)).fetchone()[0])
        except SQLITE_ERRORS:
            return None

    def _connect(self, max_bytes: int = MAX_BYTES) -> sqlite3.Connection:
        """A connection that writes nothing: of a bag with a journal of what comes next (WAL), SQLite would make one."""
        has_more = any(self._path.with_name(self._path.name + end).exists() for end in ("-wal", "-journal"))
        how = "mode=ro" if has_more else "mode=ro&immutable=1"
        connection = sqlite3.connect(f"file:{quote(str(self._path))}?{how}", uri=True)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max_bytes)
        num_left = iter(range((MAX_STEPS + MAX_STEPS_A_BYTE * self._path.stat().st_size) // _STEPS_AT_ONCE))
        connection.set_progress_handler(lambda: next(num_left, None) is None, _STEPS_AT_ONCE)
        return connection


def _check_tables(connection: sqlite3.Connection) -> None:
    """Refuses tables other than those read: a view, and a column that is computed, can make any amount of it."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name IN ('topics', 'messages')"
    names = [name for (name,) in connection.execute(query).fetchmany(3)]
    columns = [column for name in names for column in connection.execute(f"PRAGMA table_xinfo({name})")]
    is_computed = any(column[6] for column in columns)
    if sorted(names) != ["messages", "topics"] or is_computed:
        raise sqlite3.DatabaseError("expected the tables topics and messages, neither views nor computed columns")


STORAGES: Mapping[str, Callable[[Path], Container]] = MappingProxyType({".db3": SqliteBag, ".mcap": McapFile})
"""Containers by the ending of a file of a bag."""


class Ros2Bag:
    """A `Container`: the files that the folder's `metadata.yaml` names, in sequence."""

    def __init__(self, folder: Path) -> None:
        """Reads the metadata and opens every file.

        Raises:
            FileNotFoundError: If a file is missing.
            ValueError: If the metadata are broken, or a file cannot be used.
        """
        self._folder, information = folder, _information(folder)
        self._files = [_storage(path) for path in _files(folder, information)]
        self._counts = _recorded_counts(information)
        self.truncation = next((file.truncation for file in self._files if file.truncation), "")
        self.lack = next((file.lack for file in self._files if file.lack), "")

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """As in `Container`."""
        for file in self._files:
            yield from file.messages(names, refuse)

    def count(self, name: str) -> int | None:
        """As in `Container`."""
        counts = [file.count(name) for file in self._files]
        return None if None in counts else sum(count or 0 for count in counts)

    def lack_of(self, name: str, num_found: int | None) -> str:
        """A message if `num_found` messages on the topic are fewer than were recorded by the metadata; else empty.

        More are no lack: a recorder that was killed leaves metadata of before, and others append.
        """
        num_recorded = self._counts.get(name, 0)
        if num_found is None or num_found >= num_recorded:
            return ""
        words = f"by {METADATA} {num_recorded} messages on {name} were recorded, {num_found} are there"
        return f"{self._folder}: {words}: what is made from it is incomplete"


def _sizes(path: Path) -> tuple[int, int, int, bool]:
    """Size of the file, its size by its header, size of a page, bytes; and whether the header's size is up to date.

    It is if the two counters of changes agree; programs of before 2010 leave the second as it is.

    Source: sqlite.org/fileformat2, 1.3.
    """
    with path.open("rb") as file:
        header = file.read(100)
        size = file.seek(0, 2)
    if not header.startswith(SQLITE_MAGIC) or len(header) < 100:
        raise ValueError(f"{path}: expected a ROS 2 bag in SQLite, it does not start like one")
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    num_pages = int.from_bytes(header[28:32], "big")
    return size, page * num_pages, page, num_pages > 0 and header[24:28] == header[92:96]


def _storage(path: Path) -> Container:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, the bag's {METADATA} names it")
    if path.suffix not in STORAGES:
        raise ValueError(
            f"{path}: expected a file of a bag that ends in {', '.join(STORAGES)}; `ros2 bag convert` decompresses "
            "others"
        )
    return STORAGES[path.suffix](path)


def _information(folder: Path) -> dict[str, Any]:
    """What the metadata say of the bag; empty if nothing."""
    metadata = read_yaml(folder / METADATA)
    information = metadata.get("rosbag2_bagfile_information") if isinstance(metadata, dict) else None
    return information if isinstance(information, dict) else {}


def _files(folder: Path, information: Mapping[str, Any]) -> list[Path]:
    path = folder / METADATA
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError(f"{path}: rosbag2_bagfile_information.relative_file_paths: expected names of files")
    if str(information.get("compression_mode", "")).upper() == "MESSAGE":
        raise ValueError(f"{path}: compression_mode: expected messages as they are; `ros2 bag convert` decompresses")
    return [folder / PurePath(name).name for name in names]


def _recorded_counts(information: Mapping[str, Any]) -> dict[str, int]:
    """Messages that were recorded by topic, as rosbag2 has counted them once they were written; others are left out."""
    topics = information.get("topics_with_message_count")
    counts = dict[str, int]()
    for topic in topics if isinstance(topics, list) else []:
        about = topic.get("topic_metadata") if isinstance(topic, dict) else None
        if (
            isinstance(about, dict)
            and isinstance(about.get("name"), str)
            and isinstance(topic.get("message_count"), int)
        ):
            counts[about["name"]] = topic["message_count"]
    return counts
