"""The MCAP file of a run: chunks reach the operating system whole, and the file gets its name when it is complete."""

from __future__ import annotations

import contextlib
import errno
import os
from importlib import metadata
from io import FileIO
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.datasets.bags.mcap_file import END_METADATA_NAME, IS_COMPLETE
from foreglow.files import checked_path, path_in_unicode
from foreglow.folder_lock import lock
from foreglow.runs.origin import full_name
from foreglow.types.arrays import check_kind, check_optional
from foreglow.whole_files import check_replaceable, numbered, partial_path, put, replaces_only, undisturbed


class GrowingFile:
    """The file that an MCAP writer writes to: every write goes to the operating system at once, or is undone.

    After a write that failed nothing more is written, so that the earlier chunks stay readable. No error is raised
    inside the writer, whose messages would not name the path; the caller checks `error`.

    Attributes:
        num_bytes: Length of what was written.
        error: The first error, with the path; None if there was none.
    """

    def __init__(self, path: Path, name: Path) -> None:
        """Creates the file `path`; that of a killed run gets a numbered name, so that it is kept.

        Args:
            path: The file.
            name: The file's name in messages.

        Raises:
            OSError: If it cannot be written; the message has `name`.
            ValueError: If another run is writing it.
        """
        self._name = name
        try:
            self._file = self._opened(path)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(name)) from error
        self.num_bytes = 0
        self.error: OSError | None = None

    def _opened(self, path: Path) -> FileIO:
        """The file, empty and locked."""
        while True:
            file = path.open("ab", buffering=0)
            if not lock(file.fileno()):
                file.close()
                raise ValueError(f"{self._name}: another run is writing this file; expected one of its own")
            opened = os.fstat(file.fileno())
            if path.exists() and os.path.samestat(path.stat(), opened):
                if not opened.st_size:
                    return file
                path.rename(next(kept for kept in numbered(path) if not kept.exists()))
            file.close()  # it has another name now

    def write(self, data: bytes | bytearray) -> int:
        """Adds all of `data`, or none of it."""
        if self.error is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
                self.num_bytes += len(data)
            except OSError as error:
                self.error = OSError(error.errno or errno.EIO, error.strerror, str(self._name))
                with contextlib.suppress(OSError):
                    self._file.truncate(self.num_bytes)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """The position of the end; seeking to anywhere else is an error."""
        if (offset, whence) not in ((0, os.SEEK_CUR), (self.num_bytes, os.SEEK_SET)):
            raise OSError(errno.ESPIPE, "expected to write at the end alone", str(self._name))
        return self.num_bytes

    def flush(self) -> None:
        """Does nothing, as nothing is buffered."""

    def close(self) -> None:
        """Closes it."""
        with contextlib.suppress(OSError):
            self._file.close()


SUFFIX = ".mcap"

METADATA_NAME = "foreglow"
"""Name of the metadata record at the beginning, with version, source and configuration."""

CHUNK_NS = 500_000_000
"""Longest time span of a chunk: one is written twice a second."""

CHUNK_BYTES = 8 << 20
"""A chunk that has so much before compression is written: no frame is in two chunks."""

COMPRESSION_LEVEL = 1
"""zstd's level; many times faster than 18 images of 1280x960 px a second need."""


class RecordingFile:
    """An MCAP file that is called `FILE.mcap.partial` while it is written; `close` renames it.

    The `.partial` of an earlier, killed run is kept under a numbered name. If a write fails, such as on a full disk,
    `close` leaves what was written before as `.partial`; `discard` deletes it.

    Attributes:
        path: The file's final name.
        context: Channels made with it log to the file.
        num_kept: Frames that are on the disk.
    """

    def __init__(self, path: Path | str, config: PipelineConfig | None, source_name: str, profile: str = "") -> None:
        """Creates the file.

        Args:
            path: The file's final name.
            config: The pipeline's configuration, kept in the recording's metadata.
            source_name: The name of the frames' source, kept likewise; a path is kept in full.
            profile: MCAP's name for what the messages are; empty for no certain one.

        Raises:
            OSError: If it cannot be created; the message names the path.
            ValueError: If the path does not end in `.mcap`, what is there is no file, or another run is recording into
                it.
        """
        path = checked_path(path)
        check_optional("config", config, PipelineConfig)
        check_kind("source_name", source_name, str)
        if path.suffix.lower() != SUFFIX:
            raise ValueError(f"{path}: expected a recording that ends in {SUFFIX}")
        check_replaceable(path)
        self.path, self._partial = path, partial_path(path)
        replaces_only(path)
        self.num_kept = self._num_frames = self._chunk_bytes = 0
        self._chunk_start_ns: int | None = None
        self._is_open, self._is_complete = True, False
        texts = {"version": metadata.version("foreglow"), "source": path_in_unicode(full_name(source_name))}
        texts |= {} if config is None else {"config": config_to_toml(config)}
        self.context = foxglove.Context()  # kept: its channels live as long as it does
        self._file = GrowingFile(self._partial, path)
        try:
            self._writer = foxglove.open_mcap(
                self._file,
                context=self.context,
                writer_options=MCAPWriteOptions(
                    profile=profile,
                    chunk_size=None,
                    compression_level=COMPRESSION_LEVEL,
                    compression_threads=0,
                    disable_seeking=True,  # a chunk is written whole
                ),
            )
            self._writer.write_metadata(METADATA_NAME, texts)
        except BaseException:
            self._file.close()
            self._remove()
            raise

    def wrote(self, time_ns: int, num_bytes: int) -> None:
        """Counts the frame just written, and ends the chunk if it is long or large enough.

        Args:
            time_ns: The frame's time.
            num_bytes: About how large it is.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._num_frames += 1
        self._chunk_bytes += num_bytes
        if self._chunk_start_ns is None:
            self._chunk_start_ns = time_ns
        if self._chunk_bytes >= CHUNK_BYTES or not 0 <= time_ns - self._chunk_start_ns < CHUNK_NS:
            self.flush()
        self._check()

    def flush(self) -> None:
        """Ends the chunk.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._end_chunk()
        self._check()

    def close(self, *, is_complete: bool = True) -> None:
        """Completes and renames the file; if a write failed before, it stays `.partial`.

        Args:
            is_complete: Whether all frames of the source are in it, which the file says.

        Raises:
            OSError: If the disk is full, or somebody has written another file there meanwhile, which stays as it is;
                the message names the path.
        """
        if not self._is_open:
            return
        had_failed = self._file.error is not None
        self._end_chunk()
        self._finish(is_complete=is_complete)
        if not had_failed:
            self._check()
            self._is_complete = True
            put(self._partial, self.path.absolute(), self.path)

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before; also after a `close` that failed."""
        if self._is_complete:
            return
        if self._is_open:
            self._finish(is_complete=False)
        self._remove()
        self._is_complete, self.num_kept = True, 0

    def _end_chunk(self) -> None:
        num_bytes = self._file.num_bytes
        with undisturbed():  # in a callback of the writer, the error of a signal would be lost
            self._writer.flush()
        if self._file.num_bytes > num_bytes:  # the chunk is whole, even if its index is not
            self.num_kept = self._num_frames
        self._chunk_start_ns, self._chunk_bytes = None, 0

    def _finish(self, *, is_complete: bool) -> None:
        self._is_open = False
        with undisturbed():
            self._writer.write_metadata(END_METADATA_NAME, {IS_COMPLETE: str(is_complete).lower()})
            self._writer.close()
            self._file.close()

    def _remove(self) -> None:
        with contextlib.suppress(OSError):
            self._partial.unlink(missing_ok=True)

    def _check(self) -> None:
        if self._file.error is not None:
            raise self._file.error
