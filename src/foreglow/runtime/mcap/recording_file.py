"""The MCAP file of a run: chunks reach the operating system whole, and the file gets its name when it is complete."""

from __future__ import annotations

import contextlib
from importlib import metadata
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.files import in_unicode
from foreglow.outputs import partial_path
from foreglow.runtime.mcap.growing_file import GrowingFile

SUFFIX = ".mcap"

CHUNK_NS = 500_000_000
"""Longest time span of a chunk: one is written twice a second."""

CHUNK_BYTES = 8 << 20
"""Largest chunk before compression."""

COMPRESSION_LEVEL = 1
"""zstd's level; many times faster than 18 images of 1280x960 px a second need."""


class RecordingFile:
    """An MCAP file that is called `FILE.mcap.partial` while it is written; `close` renames it.

    The `.partial` of an earlier, killed run is kept under a numbered name. If a write fails, such as on a full disk,
    `close` leaves what was written before as `.partial`; `discard` deletes it.

    Attributes:
        path: The file's final name.
        context: Channels made with it log to the file.
    """

    def __init__(self, path: Path, config: PipelineConfig | None, source_name: str, profile: str = "") -> None:
        """Creates the file.

        Args:
            path: The file's final name.
            config: The pipeline's configuration, kept in the recording's metadata.
            source_name: The name of the frames' source, kept likewise.
            profile: MCAP's name for what the messages are; empty for no certain one.

        Raises:
            OSError: If it cannot be created; the message names the path.
            ValueError: If the path does not end in `.mcap`, or another run is recording into it.
        """
        if path.suffix.lower() != SUFFIX:
            raise ValueError(f"{path}: expected a recording that ends in {SUFFIX}")
        if path.is_dir():
            raise ValueError(f"{path}: expected a file to write, or nothing, got a folder")
        self.path, self._partial = path, partial_path(path)
        self._file = GrowingFile(self._partial, path)
        self.context = foxglove.Context()  # kept: its channels live as long as it does
        self._writer = foxglove.open_mcap(
            self._file,
            context=self.context,
            writer_options=MCAPWriteOptions(
                profile=profile,
                chunk_size=CHUNK_BYTES,
                compression_level=COMPRESSION_LEVEL,
                compression_threads=0,
                disable_seeking=True,  # a chunk is written whole
            ),
        )
        texts = {"version": metadata.version("foreglow"), "source": in_unicode(source_name)}
        self._writer.write_metadata("foreglow", texts | ({} if config is None else {"config": config_to_toml(config)}))
        self._chunk_start_ns: int | None = None
        self._is_open = True

    def wrote(self, time_ns: int) -> None:
        """Ends the chunk if the frame just written, at `time_ns`, is `CHUNK_NS` after its first one.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        if self._chunk_start_ns is None:
            self._chunk_start_ns = time_ns
        elif not 0 <= time_ns - self._chunk_start_ns < CHUNK_NS:
            self.flush()
        self._check()

    def flush(self) -> None:
        """Ends the chunk.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._writer.flush()
        self._chunk_start_ns = None
        self._check()

    def close(self) -> None:
        """Completes and renames the file; if a write failed before, it stays `.partial`.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        if not self._is_open:
            return
        had_failed = self._file.error is not None
        self._finish()
        if not had_failed:
            self._check()
            self._partial.replace(self.path)

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before."""
        if self._is_open:
            self._finish()
            with contextlib.suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def _finish(self) -> None:
        self._is_open = False
        self._writer.close()
        self._file.close()

    def _check(self) -> None:
        if self._file.error is not None:
            raise self._file.error
