"""A file that grows chunk by chunk, and holds only whole ones."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path


class GrowingFile:
    """What an MCAP writer writes into: every write goes to the operating system at once, or is taken back.

    After a write that failed nothing more is written: what was there before stays readable. The writer is not told, as
    its messages are not ours; whoever drives it asks for `error`.

    Attributes:
        error: What went wrong, with the path; None while all is well.
    """

    def __init__(self, path: Path, name: Path) -> None:
        """Makes the file `path`, or empties it.

        Args:
            path: The file.
            name: What messages call it.

        Raises:
            OSError: If that cannot be done; the message names `name`.
        """
        self._name = name
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(name)) from error
        self._end = 0
        self.error: OSError | None = None

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
        """Where the end is: nothing is written anywhere else."""
        if (offset, whence) not in ((0, os.SEEK_CUR), (self._end, os.SEEK_SET)):
            raise OSError(errno.ESPIPE, "expected to write at the end alone", str(self._name))
        return self._end

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Closes it."""
        with contextlib.suppress(OSError):
            self._file.close()
