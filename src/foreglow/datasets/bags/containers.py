"""The interface of all files of recordings: messages on topics, and damage."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

MAX_BYTES = 1 << 29
"""Largest record that is read, and largest chunk that is decompressed: twice an image of 8192x8192 px in colour."""

MAX_TOPICS = 1 << 16
"""Topics of a recording: as many as MCAP can number."""

PARTIAL_SUFFIXES = (".partial", ".active")
"""Endings of incomplete recordings: ours of a killed run, and rosbag's."""

Refuse: TypeAlias = Callable[[str], None]
"""Takes a message about damage; raises ValueError, or notes it: then reading continues after the damage."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic.

    Attributes:
        name: Such as `/camera/image_raw`.
        type: Type of its messages by its recorder's name: `sensor_msgs/msg/Image`.
        encoding: Their encoding: `cdr`, `ros1`, `protobuf`, `json` ...
    """

    name: str
    type: str
    encoding: str


@dataclass(frozen=True, slots=True)
class Message:
    """A message.

    Attributes:
        topic: The topic on which it was published.
        log_time_ns: Time of recording.
        data: Its bytes.
    """

    topic: Topic
    log_time_ns: int
    data: memoryview


class Container(Protocol):
    """A recording on the disk."""

    @property
    def truncation(self) -> str:
        """A message that the end is missing, with the path; empty for a complete recording, and for a recording whose
        name says that it is incomplete (`PARTIAL_SUFFIXES`).
        """
        ...

    @property
    def lack(self) -> str:
        """A message, with the path, that what was to be recorded is not all there, as the recording says itself or by
        its name; empty where neither says so.
        """
        ...

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """The messages on the topics `names`, None for all, in the order of the file.

        Damage is passed to `refuse`, with the path; a missing end is not: it is in `truncation`.
        """
        ...

    def count(self, name: str) -> int | None:
        """Number of messages on the topic; None if unknown without reading all of the file."""
        ...


def is_partial(path: Path) -> bool:
    """Whether its name says that it is incomplete."""
    return path.name.endswith(PARTIAL_SUFFIXES)


def unfinished(path: Path) -> str:
    """A message about a recording whose name says that it is incomplete."""
    return f"{path}: the recording was not finished, what is made from it is incomplete"


def incomplete(path: Path) -> str:
    """A message about a recording that says that frames of its source are missing."""
    return f"{path}: frames are missing from the recording, what is made from it is incomplete"


def continuation(path: Path, end: int, size: int) -> str:
    """A message about what lies behind a recording that ends at byte `end` of `size`, such as another recording."""
    return (
        f"{path}: byte {end}: expected the end of the recording, what follows ({size - end} bytes) is not read: join "
        "recordings with their own tools, not with `cat`"
    )


def check_num_topics(topics: Collection[object]) -> None:
    """Passes as many topics as are read.

    Raises:
        ValueError: If there are more.
    """
    if len(topics) > MAX_TOPICS:
        raise ValueError(f"expected at most {MAX_TOPICS} topics, got more")


def decompressed(data: memoryview, compression: str, size: int) -> memoryview:
    """The `size` bytes of `data` without their `compression`: empty, `none`, `lz4`, `zstd` or `bz2`.

    It never allocates more than `size` bytes, whatever the headers within the data claim.

    Raises:
        ModuleNotFoundError: If the package for it is not installed (extra `recordings`).
        ValueError: If the size is not accepted, the compression is unknown, or the data are damaged.
    """
    if size > MAX_BYTES:
        raise ValueError(f"expected a chunk of at most {MAX_BYTES} bytes, got {size}")
    if compression in ("", "none"):
        taken: bytes | memoryview = data
    elif compression == "lz4":
        taken = _from_lz4(data, size)
    elif compression == "zstd":
        taken = _from_zstd(data, size)
    elif compression == "bz2":
        taken = _from_bz2(data, size)
    else:
        raise ValueError(f"expected a compression of lz4, zstd, bz2 or none, got {compression!r}")
    if len(taken) != size:
        raise ValueError(f"expected a chunk of {size} bytes, got {len(taken)}")
    return memoryview(taken)


def _from_lz4(data: memoryview, size: int) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    except (RuntimeError, EOFError) as error:
        raise ValueError(f"lz4 data are damaged: {error}") from None


def _from_zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    try:
        return zstandard.ZstdDecompressor().stream_reader(data).read(size)
    except zstandard.ZstdError as error:
        raise ValueError(f"zstd data are damaged: {error}") from None


def _from_bz2(data: memoryview, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=size)
    except (OSError, EOFError) as error:
        raise ValueError(f"bz2 data are damaged: {error}") from None
