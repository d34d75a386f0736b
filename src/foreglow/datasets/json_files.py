"""JSON files that are checked against a model while they are read, and written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from foreglow.files import write_atomic

Model = TypeVar("Model", bound=BaseModel)


_NAMES_ON_DISK: dict[str, str] = {
    "directory": "dir",
    "driver_id": "proband_id",
    "driver_behaviour": "proband_behaviour",
    "is_dome": "dome",
    "position_px": "pos",
    "is_direct": "direct",
    "is_rear": "rear",
    "boxes_xyxy_px": "bounding_boxes",
    "start_time_ms": "start_time",
    "end_time_ms": "end_time",
    "height_px": "height",
    "width_px": "width",
}


class Record(BaseModel):
    """A frozen JSON object: types are strict, and keys that nobody knows are kept.

    In Python a field may have a more telling name than on disk; `_NAMES_ON_DISK` maps them, and both are accepted.
    """

    model_config = ConfigDict(
        frozen=True,
        strict=True,
        extra="allow",
        allow_inf_nan=False,
        populate_by_name=True,
        alias_generator=lambda name: _NAMES_ON_DISK.get(name, name),
    )


def parse_json(data: bytes | str, model: type[Model], origin: str) -> Model:
    """The `model` in the JSON text `data`.

    Raises:
        ValueError: If it is not JSON, or a field is missing, of the wrong type or out of range; the message names
            `origin`, the field, what was expected and what is there.
    """
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise ValueError(f"{origin}: expected JSON: {first['ctx']['error']}") from None
        field = ".".join(_printable(str(part)) for part in first["loc"]) or "document"
        got = "" if first["type"] == "missing" else f", got {_short(first['input'])}"
        message = (
            "field is missing"
            if first["type"] == "missing"
            else first["msg"].replace("Input should be", "expected").removeprefix("Value error, ")
        )
        raise ValueError(f"{origin}: {field}: {message}{got}") from None


def read_json(path: Path, model: type[Model]) -> Model:
    """The `model` in the JSON file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be read, is not JSON, or does not fit the model.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    return parse_json(data, model, str(path))


def write_json(path: Path, record: Record) -> None:
    """Writes `record` with its names on disk, without the fields that were never given; whole or not at all.

    Raises:
        OSError: If it cannot be written; `path` is then as it was before.
    """
    value = record.model_dump(mode="json", by_alias=True, exclude_unset=True)
    write_atomic(path, json.dumps(value, indent=1).encode())


def _printable(key: str) -> str:
    return key if key.isprintable() and len(key) <= 80 else _short(key)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
