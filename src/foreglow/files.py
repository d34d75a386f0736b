"""Values as JSON, and reading within bounds.

Every reader goes through `check_file` or `read_bytes`, or a function that does: regular files only, of a size that the
reader states.
"""

from __future__ import annotations

import codecs
import dataclasses
import hashlib
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, AnyStr, Protocol, runtime_checkable
from urllib.parse import quote, unquote_to_bytes

import numpy as np
from pydantic import BaseModel
from pydantic_core import from_json, to_jsonable_python

from foreglow.whole_files import write_atomic
from foreglow.wording import shortened

_FILE_URI = "file://"


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
    if isinstance(value, str):
        return in_unicode(value)
    if isinstance(value, list | tuple):
        return [to_json(part) for part in value]
    if isinstance(value, Mapping):
        return {in_unicode(str(key)): to_json(part) for key, part in value.items()}
    if isinstance(value, OwnJson):
        return to_json(value.to_json())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return fields_to_json(value)
    if isinstance(value, BaseModel):
        return to_json(value.model_dump())
    return to_json(str(value)) if isinstance(value, Path) else to_jsonable_python(value)


def in_unicode(text: str) -> str:
    r"""`text`, such as a file's name, with `?` for each byte that is no UTF-8: no file of text could hold it.

    >>> in_unicode("night\udcff.png")
    'night?.png'
    """
    return text.encode("utf-8", "replace").decode()


def path_in_unicode(text: str) -> str:
    r"""`text` for a file of text, from which `path_from_unicode` has it back, also if it is a path with other bytes.

    Such a path becomes a URI.

    >>> path_in_unicode("/drives/night"), path_in_unicode("/drives/night\udcff")
    ('/drives/night', 'file:///drives/night%FF')
    """
    return text if in_unicode(text) == text else f"{_FILE_URI}{quote(os.fsencode(text))}"


def path_from_unicode(text: str) -> str:
    r"""What `path_in_unicode` had; a URI that a path in UTF-8 could be written for is one that a user gave.

    >>> path_from_unicode(path_in_unicode("night\udcff")) == "night\udcff"
    True
    """
    path = os.fsdecode(unquote_to_bytes(text.removeprefix(_FILE_URI)))
    return path if text.startswith(_FILE_URI) and in_unicode(path) != path else text


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


MIB = 1 << 20

MAX_TEXT_BYTES = 64 * MIB
"""Largest text file that is read as a whole: a map of a city, or the poses of a day."""

MAX_JSON_BYTES = 64 * MIB
"""Largest JSON text: the labels of a data set, or the predictions for it, in some ten bytes a value."""

MAX_JSON_VALUES = 3_000_000
"""Values in a JSON text, as its commas and brackets count: a wrong one takes 400 bytes while it is checked."""

MAX_TOML_BYTES = MIB
"""Largest TOML file: people write them, and `tomllib` may make some hundred bytes of each."""

MAX_YAML_BYTES = MIB
"""Largest YAML file: the metadata of a bag with a thousand topics."""

MAX_KEY_PARTS = 16
"""Parts of a dotted key in TOML: reading it takes their number squared."""

MAX_DEPTH = 32
"""Lists and objects in one another in YAML; files that we read have five."""

MAX_SCALAR_CHARS = 1000
"""A plain word of YAML: a long number in base 60 takes its length squared."""

_TOML_TEXTS = re.compile(
    r"""#[^\n]*|\"\"\"(?:[^\\"]|\\.|\"(?!\"\"))*(?:\"\"\")?|'''(?:[^']|'(?!''))*(?:''')?"""
    r"""|"(?:[^\\"\n]|\\.)*"?|'[^'\n]*'?""",
    re.DOTALL,
)


_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_each_once(values: Iterable[Path | str], field: str) -> None:
    """Checks that nothing is named twice, which would then count twice; paths may name the same in two ways.

    Raises:
        ValueError: If something is; the message begins with `field`.

    >>> check_each_once(["val", "test", "val"], "--split")
    Traceback (most recent call last):
    ValueError: --split: expected each once, val comes twice
    """
    seen = set[Path | str]()
    for value in values:
        key = value.resolve() if isinstance(value, Path) else value
        if key in seen:
            raise ValueError(f"{field}: expected each once, {value} comes twice")
        seen.add(key)


def checked_path(path: object, field: str = "path") -> Path:
    """`path`, if it is one: an empty text would stand for the working directory.

    Raises:
        ValueError: If it is no path or text, or no file can have such a name; the message begins with `field`.

    >>> checked_path(None, "split")
    Traceback (most recent call last):
    ValueError: split: expected the path of a file or folder, got None
    """
    if not isinstance(path, str | os.PathLike) or not str(path) or "\0" in str(path):
        raise ValueError(f"{field}: expected the path of a file or folder, got {shortened(path)}")
    found = Path(path)
    try:
        found.exists()
    except OSError as error:  # a name that is too long
        reason = error.strerror or str(error)
        raise ValueError(f"{field}: expected the path of a file or folder, {reason}: {shortened(str(path))}") from None
    return found


def check_is_folder(path: Path, expected: str) -> None:
    """Passes a folder.

    Raises:
        FileNotFoundError: If there is nothing; the message ends with what was `expected`.
        ValueError: If it is something else.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such folder, expected {expected}")
    if not path.is_dir():
        kind = _KINDS.get(stat.S_IFMT(path.stat().st_mode), "a file")
        raise ValueError(f"{path}: expected {expected}, is {kind} and no folder")


def check_file(path: Path, max_bytes: float = math.inf) -> None:
    """Passes a regular file of at most `max_bytes`; opening another, such as a pipe, may wait for ever.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is a folder, a pipe, a socket or a device, or is larger.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    state = path.stat()
    if not stat.S_ISREG(state.st_mode):
        raise ValueError(f"{path}: expected a file, is {_KINDS.get(stat.S_IFMT(state.st_mode), 'none')}")
    _check_size(path, state.st_size, max_bytes)


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """What the regular file at `path` holds.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no regular file, larger than `max_bytes`, or cannot be read.
    """
    check_file(path, max_bytes)
    try:
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    _check_size(path, len(data), max_bytes)  # it may grow, and those of the kernel do not tell their size
    return data


def file_digest(path: Path) -> str:
    """SHA-256 of a regular file.

    Raises:
        OSError: If there is no such file, or it cannot be read.
        ValueError: If it is no regular file.
    """
    check_file(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_text(path: Path, max_bytes: int = MAX_TEXT_BYTES, encoding: str = "utf-8-sig", errors: str = "strict") -> str:
    """The text in the file at `path`, UTF-8 unless `encoding` says otherwise; a byte order mark is dropped.

    `errors` is what undecodable bytes do, as in `bytes.decode`; UTF-16 is such, too.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no regular file, larger than `max_bytes`, or not such text.
    """
    data = read_bytes(path, max_bytes)
    if errors == "strict":
        check_encoding(data, path)
    try:
        text = data.decode(encoding, errors)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected UTF-8 text: {error}") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def check_encoding(data: bytes, path: Path) -> None:
    """Passes all but UTF-16, by the mark with which it begins: editors save it, and no file of ours is.

    Raises:
        ValueError: If it is; the message names `path`.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ValueError(f"{path}: expected UTF-8 text, is UTF-16: save it as UTF-8")


def bounded_lines(file: IO[AnyStr], path: Path, max_bytes: int) -> Iterator[AnyStr]:
    """The lines of an open file.

    Raises:
        ValueError: If one is longer than `max_bytes`; the message names `path` and the line.
    """
    number = 0
    while line := file.readline(max_bytes + 1):
        number += 1
        if len(line) > max_bytes:
            raise ValueError(f"{path}: line {number}: expected at most {max_bytes} bytes, got more")
        yield line


def read_toml(path: Path | str) -> dict[str, Any]:
    """What the TOML file `path` holds.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or beyond a bound; the message names the path and the place.
    """
    data = read_bytes(Path(path), MAX_TOML_BYTES)
    check_encoding(data, Path(path))
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
        for part in re.split(r"[=,{}\[\]\n]", _TOML_TEXTS.sub('""', text)):
            if part.count(".") >= MAX_KEY_PARTS:
                raise ValueError(f"keys of at most {MAX_KEY_PARTS} parts, got {shortened(part.strip())}")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also for an integer of thousands of digits
        raise ValueError(f"{path}: expected TOML: {error}") from error


def read_yaml(path: Path) -> Any:
    """What the YAML file `path` holds; aliases are refused, since a few make billions of values.

    A line `---` may end it, as in what `ros2 topic echo` prints.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not YAML, has an alias or a key twice, or is beyond a bound; the message names the path.
    """
    import yaml

    text = read_text(path, MAX_YAML_BYTES).rstrip().removesuffix("\n---")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        depth = 0
        for event in yaml.parse(text, loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(f"expected no aliases, got *{shortened(event.anchor)}")
            if depth > MAX_DEPTH:
                raise ValueError(f"expected at most {MAX_DEPTH} lists and objects in one another, got more")
            if isinstance(event, yaml.ScalarEvent) and not event.style and len(event.value) > MAX_SCALAR_CHARS:
                raise ValueError(f"expected words of at most {MAX_SCALAR_CHARS} characters, got {len(event.value)}")
        _check_keys(yaml.compose(text, loader))
        return yaml.load(text, loader)  # a safe one
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected YAML: {' '.join(str(error).split())}") from None


def _check_keys(node: Any) -> None:
    """Raises ValueError if an object in a node of YAML has a key twice, of which the last would count."""
    if node is not None and isinstance(node.value, list):
        parts = [part for pair in node.value for part in (pair if isinstance(pair, tuple) else (pair,))]
        keys = [pair[0].value for pair in node.value if isinstance(pair, tuple) and isinstance(pair[0].value, str)]
        check_each_once(keys, "keys")
        for part in parts:
            _check_keys(part)


def check_json(data: bytes | str, origin: str) -> None:
    """Passes JSON text that is neither too long nor of too many values, as its commas and brackets count.

    Raises:
        ValueError: If it is; the message begins with `origin`.
    """
    if len(data) > MAX_JSON_BYTES:
        raise ValueError(f"{origin}: expected JSON of at most {MAX_JSON_BYTES // MIB} MiB, got more")
    num = data.count(b",") + data.count(b"[") if isinstance(data, bytes) else data.count(",") + data.count("[")
    if num > MAX_JSON_VALUES:
        raise ValueError(f"{origin}: expected JSON of at most {MAX_JSON_VALUES} values, got {num}")


def _check_pairs(pairs: list[tuple[str, Any]]) -> None:
    if len(dict(pairs)) < len(pairs):
        check_each_once([key for key, _ in pairs], "keys")


_KEYS = json.JSONDecoder(object_pairs_hook=_check_pairs)


def check_json_keys(data: bytes | str, origin: str) -> None:
    """Passes JSON text, which is known to be such, in which no object has a key twice, of which the last would count.

    Raises:
        ValueError: If one has; the message begins with `origin`.
    """
    try:
        _KEYS.decode(data.decode() if isinstance(data, bytes) else data)
    except ValueError as error:
        raise ValueError(f"{origin}: {error}") from None


def read_plain_json(path: Path) -> Any:
    """What the JSON file `path` holds, as lists, dicts, texts and numbers.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no JSON, has a key twice, or is beyond a bound; the message names the path.
    """
    data = read_bytes(path, MAX_JSON_BYTES).removeprefix(codecs.BOM_UTF8)
    check_encoding(data, path)
    check_json(data, str(path))
    try:
        value = from_json(data)
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON: {error}") from None
    check_json_keys(data, str(path))
    return value


def number_in(text: str) -> float:
    """The number that a text is, finite or not.

    Raises:
        ValueError: If it is none; 1_000 and the digits of other scripts, which Python alone takes for one, are none.
    """
    if not text.isascii():
        raise ValueError(f"could not convert string to float: {shortened(text)}")
    return float(text.replace("_", "?"))


def _check_size(path: Path, num_bytes: int, max_bytes: float) -> None:
    if num_bytes > max_bytes:
        limit = f"{max_bytes / MIB:g} MiB" if max_bytes >= MIB else f"{max_bytes:g} bytes"
        raise ValueError(f"{path}: expected a file of at most {limit}, got {num_bytes} bytes or more")
