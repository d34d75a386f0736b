"""Files that appear whole or not at all, and errors that say which file they are about."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO


@contextlib.contextmanager
def open_atomic(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which becomes `path` when the block ends without an error, and vanishes otherwise.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the message names `path`, which is then as it was.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with naming(path, in_place_of=temporary):
            with temporary.open("wb") as file:
                yield file
            temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def write_atomic(path: Path, data: bytes) -> None:
    """Writes `data` to `path`, whole or not at all.

    Raises:
        OSError: If it cannot be written; the message names `path`, which is then as it was.
    """
    with open_atomic(path) as file:
        file.write(data)


def write_json_results(path: Path, results: Any, indent: int = 1) -> None:
    """Writes numbers and texts to `path` as JSON, whole or not at all.

    Raises:
        OSError: If it cannot be written.
        ValueError: If a number is NaN or infinite: JSON knows null for what is not defined.
    """
    write_atomic(path, (json.dumps(results, indent=indent, allow_nan=False) + "\n").encode())


@contextlib.contextmanager
def naming(path: Path, *, in_place_of: Path | None = None) -> Iterator[None]:
    """Puts `path` into an OSError that does not say which file it is about, such as one of a full disk.

    Args:
        path: The file that the user knows.
        in_place_of: A temporary file of ours; an error about it becomes one about `path`.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename not in (None, in_place_of and str(in_place_of)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def read_text(path: Path) -> str:
    """The text in the UTF-8 file at `path`; a byte order mark is dropped.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not UTF-8 text.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected UTF-8 text: {error}") from error
