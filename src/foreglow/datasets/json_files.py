"""JSON files that are checked against a model while they are read, and written whole or not at all."""

from __future__ import annotations

import codecs
import functools
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema

from foreglow.config.fields import PlainModel
from foreglow.files import (
    MAX_JSON_BYTES,
    bounded_lines,
    check_encoding,
    check_file,
    check_json,
    check_json_keys,
    read_bytes,
)
from foreglow.whole_files import write_atomic
from foreglow.wording import shortened

Model = TypeVar("Model")

adapter: Callable[[Any], TypeAdapter[Any]] = functools.cache(TypeAdapter)
"""Reads and writes the JSON of a pydantic model or a dataclass; made once for each."""

MAX_ERRORS = 10_000
"""Wrong values in a JSON text of which the first is told: pydantic makes a kilobyte of each at once."""

MAX_LINES_BYTES = 1 << 29
"""Largest file of lines: what `live` writes in some hours."""

MAX_LINE_BYTES = 1 << 22
"""Longest line: a frame with ten thousand boxes."""

MAX_LINES = 1_000_000
"""Lines that are read: the frames of 15 hours."""

_MESSAGES = {
    "missing": "field is missing",
    "extra_forbidden": "field is unknown",
    "unexpected_keyword_argument": "field is unknown",
    "too_long": "expected at most {max_length} entries, got {actual_length}",
    "too_short": "expected at least {min_length} entries, got {actual_length}",
}
"""Messages by pydantic's type of an error, for models and dataclasses alike; with values of its context."""


_KINDS = {"str": "text", "int": "a number", "float": "a number", "bool": "true or false"}
"""What is expected, by the name with which pydantic ends the place of a field that may be of several types."""


class Record(PlainModel):
    """A frozen JSON object: types are strict, and unknown keys are kept."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow", allow_inf_nan=False)


@dataclass(frozen=True)
class StoredAs:
    """Says that a file stores a field as another type than Python has: `Annotated[Floats, StoredAs(...)]`.

    Attributes:
        stored: The type in the file; pydantic must know it.
        read: Converts the stored value to that in Python.
        write: Converts back.
    """

    stored: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """How pydantic asks for it."""
        stored = handler.generate_schema(self.stored)
        writing = core_schema.plain_serializer_function_ser_schema(self.write, return_schema=stored)
        return core_schema.no_info_after_validator_function(self.read, stored, serialization=writing)


def parse_json(data: bytes | str, model: type[Model], origin: str) -> Model:
    """The `model`, a pydantic model or a dataclass, in the JSON text `data`.

    Raises:
        ValueError: If it is not JSON, has a key twice, or a field is missing, of the wrong type or out of range; the
            message names `origin`, the field, what was expected and what is there.
    """
    check_json(data, origin)
    try:
        value: Model = adapter(model).validate_json(data)
    except ValidationError as error:
        if error.error_count() > MAX_ERRORS:
            raise ValueError(f"{origin}: expected another structure, {error.error_count()} values are wrong") from None
        first, *others = error.errors(include_url=False)
        if first["type"] == "json_invalid":
            raise ValueError(f"{origin}: expected JSON: {first['ctx']['error']}") from None
        place = first["loc"]
        kinds = [each["loc"][-1] for each in (first, *others) if each["loc"][:-1] == place[:-1] and each["loc"]]
        is_union = len(kinds) > 1 and all(kind in _KINDS for kind in kinds)
        place = place[:-1] if is_union else place
        field = ".".join(_printable(str(part)) for part in place) or "document"
        plain = first["msg"].replace("Input should be", "expected").removeprefix("Value error, ")
        message = _MESSAGES.get(first["type"], plain).format_map(first.get("ctx", {}))
        if first["type"] == "missing" and isinstance(place[-1], int):
            message = "expected one more entry"
        if is_union:
            message = f"expected {' or '.join(dict.fromkeys(_KINDS[str(kind)] for kind in kinds))}"
        got = "" if first["type"] == "missing" or ", got " in message else f", got {shortened(first['input'])}"
        raise ValueError(f"{origin}: {field}: {message}{got}") from None
    check_json_keys(data, origin)
    return value


def read_json(path: Path, model: type[Model]) -> Model:
    """The `model` in the JSON file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, is not JSON, or does not fit the model.
    """
    data = read_bytes(path, MAX_JSON_BYTES).removeprefix(codecs.BOM_UTF8)
    check_encoding(data, path)
    return parse_json(data, model, str(path))


def read_json_lines(path: Path, model: type[Model]) -> Iterator[tuple[str, Model]]:
    """For each line of the file at `path`, where it is (for messages), and the `model` in it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a line is not JSON or does not fit the model; the message names path, line and field.
    """
    for number, line in enumerate(read_lines(path), start=1):
        origin = f"{path}: line {number}"
        yield origin, parse_json(line, model, origin)


def read_lines(path: Path) -> Iterator[bytes]:
    """The lines of the file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no regular file, or it, a line or the number of lines is beyond a bound.
    """
    check_file(path, MAX_LINES_BYTES)
    with path.open("rb") as file:
        for number, line in enumerate(bounded_lines(file, path, MAX_LINE_BYTES), start=1):
            if number > MAX_LINES:
                raise ValueError(f"{path}: expected at most {MAX_LINES} lines, got more")
            yield line.removeprefix(codecs.BOM_UTF8) if number == 1 else line


def write_json(path: Path, record: BaseModel) -> None:
    """Writes `record` with its names on disk, without the fields that were never given; whole or not at all.

    Raises:
        OSError: If it cannot be written; `path` is then as it was before.
    """
    write_atomic(path, json_bytes(record))


def check_storable(field: str, value: object) -> None:
    """Checks that `value` is the same after JSON, but for lists that are tuples.

    Raises:
        ValueError: If a part of it is nothing that JSON has; the message begins with its place.

    >>> check_storable("info", {"note": [1.0, float("nan")]})
    Traceback (most recent call last):
    ValueError: info.note.1: expected what JSON can store, got nan
    """
    if isinstance(value, dict):
        for key, part in value.items():
            if not isinstance(key, str):
                raise ValueError(f"{field}: expected texts as keys, got {shortened(key)}")
            check_storable(f"{field}.{_printable(key)}", part)
    elif isinstance(value, list | tuple):
        for index, part in enumerate(value):
            check_storable(f"{field}.{index}", part)
    elif not isinstance(value, str | int | float | None) or (isinstance(value, float) and not math.isfinite(value)):
        raise ValueError(f"{field}: expected what JSON can store, got {shortened(value)}")


def json_bytes(record: BaseModel) -> bytes:
    """What `write_json` writes."""
    return json.dumps(record.model_dump(mode="json", by_alias=True, exclude_unset=True), indent=1).encode()


def _printable(key: str) -> str:
    return key if key.isprintable() and len(key) <= 80 else shortened(key)
