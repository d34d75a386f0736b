"""What the files of recordings have in common: messages on topics, and damage."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

MAX_BYTES = 1 << 29
"""Largest record that is read, and largest chunk that is decompressed: twice an image of 8192x8192 px in colour."""

PARTIAL_SUFFIXES = (".partial", ".active")
"""Endings of recordings that nobody completed: ours of a killed run, and rosbag's."""

Refuse: TypeAlias = Callable[[str], None]
"""Takes what is wrong at some place; raises ValueError, or notes it: then reading goes on with what follows."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic.

    Attributes:
        name: Such as `/camera/image_raw`.
        type: Type of its messages, as its recorder called it: `sensor_msgs/msg/Image`.
        encoding: How they are written: `cdr`, `ros1`, `protobuf`, `json` ...
    """

    name: str
    type: str
    encoding: str


@dataclass(frozen=True, slots=True)
class Message:
    """A message.

    Attributes:
        topic: Where it was published.
        log_time_ns: When it was recorded.
        data: Its bytes.
    """

    topic: Topic
    log_time_ns: int
    data: memoryview


class Container(Protocol):
    """A recording on the disk."""

    @property
    def truncation(self) -> str:
        """What says that the end is missing, with the path; empty for a complete recording, and for one whose name says
        that it is not (`PARTIAL_SUFFIXES`).
        """
        ...

    def messages(self, names: Collection[str] | None, refuse: Refuse) -> Iterator[Message]:
        """The messages on the topics `names`, None for all, in the order of the file.

        Damage goes to `refuse`, with the path; a missing end does not: it is `truncation`.
        """
        ...

    def count(self, name: str) -> int | None:
        """How many messages the topic has; None where the file does not tell."""
        ...


def is_partial(path: Path) -> bool:
    """Whether its name says that nobody completed it."""
    return path.name.endswith(PARTIAL_SUFFIXES)


def decompressed(data: memoryview, compression: str, size: int) -> memoryview:
    """The `size` bytes that `data` were before `compression`: empty, `none`, `lz4`, `zstd` or `bz2`.

    No more than `size` bytes are ever taken, whatever the data say of themselves.

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
