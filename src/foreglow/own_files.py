"""Whether a file holds what a command writes under its name, or something else that is only called so."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

MAX_LINE = 1 << 24
"""Bytes that are read of a first line; one of a run holds the boxes and tracks of an image."""

MAX_FILE = 1 << 26
"""Bytes of a file that is read whole; a larger one is none of ours."""


def is_own(path: Path) -> bool:
    """Whether `path` is a file that a command has written, by what it holds; names that are not known never are.

    It need not be whole or complete: what begins as ours is ours.
    """
    known = _CONTENTS.get(path.name)
    if known is None or not path.is_file():
        return False
    try:
        return known(path)
    except (OSError, ValueError, RecursionError):  # the file may be anything
        return False


def _first_line(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.readline(MAX_LINE)


def _whole(path: Path) -> str:
    if path.stat().st_size > MAX_FILE:
        raise ValueError(f"{path}: expected at most {MAX_FILE} bytes")
    return path.read_text(encoding="utf-8")


def _has(value: Any, *keys: str) -> bool:
    return isinstance(value, dict) and value.keys() >= set(keys)


def _is_of_frames(path: Path) -> bool:
    return _has(json.loads(_first_line(path)), "frame", "timestamp_ns")


def _is_state(path: Path) -> bool:
    state = json.loads(_whole(path))
    return isinstance(state, dict) and all(_has(known, "seconds") for known in state.values())


_CONTENTS: Mapping[str, Callable[[Path], bool]] = {
    "frames.jsonl": _is_of_frames,
    "times.jsonl": _is_of_frames,
    "summary.json": lambda path: _has(json.loads(_whole(path)), "is_complete", "num_frames"),
    "recipe.toml": lambda path: _has(tomllib.loads(_whole(path)), "network", "epochs"),
    "checkpoint.pt": lambda path: _first_line(path).startswith(b"PK\3\4"),
    "best.toml": lambda path: _first_line(path).startswith(b"# Found by foreglow tune"),
    "study.journal": lambda path: _has(json.loads(_first_line(path)), "op_code"),
    "plan.json": lambda path: _has(json.loads(_whole(path)), "plan", "digest"),
    "experiments.json": _is_state,
    "results.json": lambda path: _has(json.loads(_whole(path)), "made_with"),
}
"""By name; of the files by which an earlier run, training, search or report is known."""
