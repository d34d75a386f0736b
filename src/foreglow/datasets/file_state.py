"""Whether a file was written to after it was opened; then what was read may not be what its container says."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path


class FileStates:
    """What files were like at a time, by size, time of writing and place on the disk."""

    def __init__(self, paths: Iterable[Path]) -> None:
        """Takes how the files are now.

        Raises:
            OSError: If there is none at one of the paths.
        """
        self._states = {path: _state(path.stat()) for path in paths}

    def change(self) -> str:
        """A line about the first file that is not as it was, or in whose place there is another; empty without any.

        One that was deleted is still read to its end by who has it open.
        """
        for path, before in self._states.items():
            try:
                now = _state(path.stat())
            except FileNotFoundError:
                continue
            if now != before:
                size = f"of {before[0]} bytes" if now[0] == before[0] else f"from {before[0]} to {now[0]} bytes"
                return f"{path}: changed while it was read, {size}; frames may be missing, wrong, or too many"
        return ""


def _state(found: os.stat_result) -> tuple[int, int, int]:
    return found.st_size, found.st_mtime_ns, found.st_ino
