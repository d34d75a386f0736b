"""A file that grows chunk by chunk, and never holds a part of one."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

from foreglow.outputs import lock


class GrowingFile:
    """The file that an MCAP writer writes to: every write goes to the operating system at once, or is undone.

    After a write that failed nothing more is written, so that the earlier chunks stay readable. No error is raised
    inside the writer, whose messages would not name the path; the caller checks `error`.

    Attributes:
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
        self._end = 0
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
                path.rename(next(kept for kept in _numbered(path) if not kept.exists()))
            file.close()  # it has another name now

    def write(self, data: bytes | bytearray) -> int:
        """Adds all of `data`, or none of it."""
        if self.error is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
                self._end += len(data)
            except OSError as error:
                self.error = OSError(error.errno or errno.EIO, error.strerror, str(self._name))
                with contextlib.suppress(OSError):
                    self._file.truncate(self._end)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """The position of the end; seeking to anywhere else is an error."""
        if (offset, whence) not in ((0, os.SEEK_CUR), (self._end, os.SEEK_SET)):
            raise OSError(errno.ESPIPE, "expected to write at the end alone", str(self._name))
        return self._end

    def flush(self) -> None:
        """Does nothing, as nothing is buffered."""

    def close(self) -> None:
        """Closes it."""
        with contextlib.suppress(OSError):
            self._file.close()


def _numbered(path: Path) -> Iterator[Path]:
    """Names for the file of a killed run, such as `FILE.1.mcap.partial` for `FILE.mcap.partial`."""
    stem, suffixes = path.with_suffix("").stem, "".join(path.suffixes[-2:])
    return (path.with_name(f"{stem}.{number}{suffixes}") for number in itertools.count(1))
