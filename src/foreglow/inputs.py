"""What a command reads beside the files that it is given: those that a configuration, a run or a model names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from foreglow.outputs import exists
from foreglow.own_folders import RESULT_NAMES

SPLIT_PARTS = ("images", "labels")
"""Folders of a split in PVDN's format; one sequence of it is read with the labels of all."""


def named_by(inputs: Mapping[str, Path]) -> dict[str, Path]:
    """By label, the files and folders that the inputs name, and those that these name, as far as they exist.

    A configuration names models and lamps; the folder of a run, or a file in it, names what the run was made from and
    the files of its configuration; a sequence of a split belongs to its labels. What cannot be read names nothing: its
    reader will say what is wrong.

    Args:
        inputs: By option or argument, files and folders that are read.
    """
    found: dict[str, Path] = {}
    waiting = list(inputs.items())
    known: set[Path] = set()
    while waiting:
        label, path = waiting.pop()
        with contextlib.suppress(OSError, RuntimeError, ValueError):  # a loop of links, a broken file
            if path.resolve() in known:
                continue
            known.add(path.resolve())
            for name, each in _named_in(label, path):
                if exists(each):
                    found.setdefault(name, each)
                    waiting.append((name, each))
    return found


def _named_in(label: str, path: Path) -> Iterator[tuple[str, Path]]:
    if path.suffix.lower() == ".toml" and path.is_file():
        yield from _files_in_toml(label, path)
    if path.is_dir() and path.parent.name == SPLIT_PARTS[0]:
        labels = path.parent.with_name(SPLIT_PARTS[1])
        if labels.is_dir():
            yield f"the labels of {label}", labels
    if path.is_file() and path.absolute().parent.parent.name == SPLIT_PARTS[0]:
        yield f"the sequence of {label}", path.parent
    home = path if path.is_dir() else path.parent
    if path.is_dir() or path.name in RESULT_NAMES:
        yield from _source_of_run(label, home)
        if (home / "config.toml").is_file():
            yield from _files_in_toml(label, home / "config.toml")


def _source_of_run(label: str, run: Path) -> Iterator[tuple[str, Path]]:
    from foreglow.files import path_from_unicode, read_plain_json

    summary = run / "summary.json"
    with contextlib.suppress(OSError, ValueError):
        record = read_plain_json(summary) if summary.is_file() else None
        if isinstance(record, dict) and isinstance(record.get("source"), str):
            yield f"the source of {label}", Path(path_from_unicode(record["source"]).removeprefix("simulate:"))


def _files_in_toml(label: str, path: Path) -> Iterator[tuple[str, Path]]:
    from foreglow.files import read_toml

    with contextlib.suppress(OSError, ValueError):
        for text in _texts(read_toml(path)):
            named = {f"{text!r} of {label}": Path(text), f"{text!r} beside {label}": path.parent / text}
            yield from ((name, each) for name, each in named.items() if exists(each) and each.is_file())


def _texts(value: object) -> Iterator[str]:
    """All texts in what a TOML file holds."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from _texts(part)
    elif isinstance(value, list):
        for part in value:
            yield from _texts(part)
