"""Files that appear whole or not at all, errors that name their file, and values as JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import math
import os
import re
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Protocol, runtime_checkable

import numpy as np
from pydantic import BaseModel
from pydantic_core import to_jsonable_python

_TEMPORARY = re.compile(r"\..+\.([1-9]\d{0,8})(-\d+)?\.tmp", re.DOTALL)
"""Name of a hidden file that is being written, with the process that writes it."""

_CLEARED: set[Path] = set()
"""Folders that this process has cleared of what killed processes left."""


@contextlib.contextmanager
def open_atomic(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which becomes `path` when the block ends without an error, and vanishes otherwise.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the message names `path`, which is then as it was.
    """
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        yield file


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """The path of an empty file to write to, for libraries that open it themselves; else as `open_atomic`.

    What processes that were killed have left of such files in the folder is removed.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the message names `path`, which is then as it was.
    """
    _clear(path.parent)
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with naming(path, in_place_of=temporary):
            with temporary.open("wb") as held:
                _is_locked(held)
                yield temporary
            temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def _clear(folder: Path) -> None:
    """Removes the temporary files in `folder` whose process is gone; once per folder is enough."""
    if folder in _CLEARED:
        return
    _CLEARED.add(folder)
    with contextlib.suppress(OSError):
        for left in folder.iterdir():
            found = _TEMPORARY.fullmatch(left.name)
            if found and not _is_alive(int(found[1])):
                with left.open("rb") as file:
                    if _is_locked(file):  # else a process on another machine writes it
                        left.unlink()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _is_locked(file: BinaryIO) -> bool:
    """Locks `file` until it is closed; returns whether that succeeded."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by another, or a file system without locks
        return False
    return True


def write_atomic(path: Path, data: bytes) -> None:
    """Writes `data` to `path`, whole or not at all.

    Raises:
        OSError: If it cannot be written; the message names `path`, which is then as it was.
    """
    with open_atomic(path) as file:
        file.write(data)


@runtime_checkable
class OwnJson(Protocol):
    """A value whose JSON differs from its fields: it adds properties, leaves fields out, or arranges them anew."""

    def to_json(self) -> Any:
        """The value to write instead. It may hold NaN, arrays and dataclasses: `to_json` is applied to it in turn."""
        ...


def to_json(value: Any) -> Any:
    """Converts `value` to plain values that `json` can write: dicts, lists, texts, numbers, truth values and None.

    Dataclasses and pydantic models become dicts of their fields, arrays and tuples become lists, numpy's scalars become
    Python's, enumerations become their values, and paths become texts. NaN and infinity become None. A value with a
    method `to_json` is replaced by what it returns.

    Raises:
        ValueError: If a value in it has a type that cannot be written as JSON.

    >>> to_json({"ranges_m": np.array([1.5, np.nan]), "path": Path("a/b")})
    {'ranges_m': [1.5, None], 'path': 'a/b'}
    """
    if isinstance(value, np.ndarray | np.generic):
        return to_json(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [to_json(part) for part in value]
    if isinstance(value, Mapping):
        return {str(key): to_json(part) for key, part in value.items()}
    if isinstance(value, OwnJson):
        return to_json(value.to_json())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return fields_to_json(value)
    if isinstance(value, BaseModel):
        return to_json(value.model_dump())
    return to_jsonable_python(value)


def fields_to_json(value: Any, *properties: str) -> dict[str, Any]:
    """The fields of a dataclass and then these properties of it, by name; for a method `to_json` to return."""
    names = (*(field.name for field in dataclasses.fields(value)), *properties)
    return {name: to_json(getattr(value, name)) for name in names}


def write_json_results(path: Path, results: Any, indent: int = 1) -> None:
    """Writes `results` to `path` in the form of `to_json`, whole or not at all.

    Raises:
        OSError: If it cannot be written.
    """
    write_atomic(path, json_text(results, indent).encode())


def json_text(value: Any, indent: int = 1) -> str:
    """The text of a JSON file that holds `value` in the form of `to_json`; it ends with a new line."""
    return json.dumps(to_json(value), indent=indent, allow_nan=False) + "\n"


@contextlib.contextmanager
def naming(path: Path, *, in_place_of: Path | None = None) -> Iterator[None]:
    """Adds `path` to an OSError that does not name its file, such as that of a full disk.

    Args:
        path: The file that the user knows.
        in_place_of: A temporary file of ours; an error that names it will name `path` instead.
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
