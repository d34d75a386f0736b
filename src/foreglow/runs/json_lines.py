"""Files with one line of JSON for each frame, which are written while a run goes on."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import ConfigDict, Field, RootModel, with_config

from foreglow.datasets import json_files
from foreglow.datasets.json_files import parse_json
from foreglow.types import Frame, FrameResult
from foreglow.whole_files import naming

Whole: TypeAlias = Annotated[int, Field(ge=-(2**63), lt=2**63)]
"""A whole number of 64 bits, as arrays and tables hold it."""

Line = TypeVar("Line", bound=Mapping[str, Any])
T = TypeVar("T")

checked = with_config(ConfigDict(strict=True, allow_inf_nan=False))
"""Decorator for the type of a line or of an object in it: values must have exactly these types, and numbers must be
finite. Keys that the type does not have are ignored, so that files of other versions can be read."""

_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


class LineSink:
    """A result sink that writes one line for every frame, each at once.

    Attributes:
        num_bytes: Length of the lines that were written whole.
    """

    def __init__(self, path: Path, to_line: Callable[[Frame, FrameResult], Mapping[str, Any]]) -> None:
        """Opens the file.

        Args:
            path: The file.
            to_line: Makes the object of a line.

        Raises:
            OSError: If the file cannot be written; the message names the path.
        """
        self._path = path
        self._to_line = to_line
        self.num_bytes = 0
        with naming(path):
            self._file = path.open("wb")

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a line.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        line = f"{_encode(self._to_line(frame, result))}\n".encode()
        with naming(self._path):
            self._file.write(line)
            self._file.flush()
        self.num_bytes += len(line)

    def close(self) -> None:
        """Completes the file.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        with naming(self._path):
            self._file.close()

    def discard(self) -> None:
        """Closes the file, even if it cannot be completed."""
        with contextlib.suppress(OSError):
            self._file.close()

    def cut(self, num_bytes: int) -> None:
        """Closes the file, and leaves so many bytes of it.

        Raises:
            OSError: If that fails; the message names the path.
        """
        self.discard()
        os.truncate(self._path, num_bytes)


def no_run_file(path: Path, expected: str) -> FileNotFoundError:
    """The error about a file of a run that is not there; it says so if a run there was killed."""
    left = path.with_name("frames.jsonl.partial")
    is_killed = left.is_file() and not path.with_name("summary.json").exists()
    words = f"; {left.name} is of a run that was killed: run it again" if is_killed else ""
    return FileNotFoundError(f"{path}: no such file, expected {expected}{words}")


def read_lines(path: Path, model: type[RootModel[Line]], convert: Callable[[Line], T]) -> dict[int, T]:
    """Reads the file at `path` and gives, by frame, the value that `convert` makes of its line; skips empty lines.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a line does not fit the model, cannot be converted, or is about the same frame as another; the
            message names the line.
    """
    if not path.exists():
        raise no_run_file(path, "one that a run wrote")
    values: dict[int, T] = {}
    for number, text in enumerate(json_files.read_lines(path), start=1):
        if not text.strip():
            continue
        origin = f"{path}: line {number}"
        line = parse_json(text, model, origin).root
        frame = line["frame"]
        if frame in values:
            raise ValueError(f"{origin}: frame: expected each frame once, {frame} is there twice")
        try:
            values[frame] = convert(line)
        except ValueError as error:
            raise ValueError(f"{origin}: {error}") from error
    return values
