"""Whether a file holds what a command writes, or something else that only has its name, or the ending of it."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foreglow.whole_files import PARTIAL, partial_path

MAX_LINE = 1 << 24
"""Bytes that are read of a first line; one of a run holds the boxes and tracks of an image."""

MAX_HEAD = 1 << 13
"""Bytes that are read of a file whose beginning says what it is."""

_PNG_HEADER = 33
"""Bytes of a PNG before which nothing may stand."""

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


def is_left(path: Path) -> bool:
    """Whether a run that was killed left `path`, under the partial name of a result: by what it and its frames hold.

    Its frames lie beside it, also under their partial name, and there is no summary yet unless the run wrote over an
    earlier one. A link is none of ours.
    """
    begins = _BEGINNINGS.get(path.name.removesuffix(PARTIAL))
    frames = path.with_name("frames.jsonl")
    try:
        if begins is None or not _begins(path, begins):
            return False
        if partial_path(frames).exists():
            return _begins(partial_path(frames), _FRAMES)
        return _begins(frames, _FRAMES) and not path.with_name("summary.json").exists()
    except OSError:  # the file may be anything
        return False


def is_row(path: Path) -> bool:
    """Whether a file begins as a row of the table of detectors does, with its name."""
    try:
        return path.is_file() and _head(path).startswith(f'{{\n "name": "{path.stem}",\n "title": '.encode())
    except OSError:  # as in `is_own`
        return False


def is_result_of_run(name: str) -> bool:
    """Whether a run writes the result called `name` under its partial name."""
    return name in _BEGINNINGS


def _begins(path: Path, begins: re.Pattern[bytes]) -> bool:
    """Whether a file is ours by how it begins, or empty."""
    return path.is_file() and not path.is_symlink() and (not _head(path) or begins.match(_head(path)) is not None)


@dataclass(frozen=True, slots=True)
class FileKind:
    """What an option writes into a single file, whose name the user chooses.

    Attributes:
        words: What it is, with its article.
        suffixes: How the names of such files end.
        holds: Whether the file at a path holds this, as a command wrote it; may raise what reading it raises.
    """

    words: str
    suffixes: tuple[str, ...]
    holds: Callable[[Path], bool]

    def may_replace(self, path: Path) -> bool:
        """Whether nothing of anybody else's is lost if such a file is written to `path`: an empty one holds nothing."""
        if not path.is_file() or path.stat().st_size == 0:
            return True
        try:
            return self.holds(path)
        except (OSError, ValueError, RecursionError, TypeError, AttributeError):  # the file may be anything
            return False


def with_digest(toml: str) -> str:
    """TOML text with a first line by which it is known as ours, until somebody changes it by hand."""
    return f"# Written by Foreglow, {_digest(toml.encode())}: after a change by hand it is not overwritten\n{toml}"


def labels_mark(name: str) -> str:
    """A text for the beginning of a file of labels in the format called `name`, with room for its digest."""
    return f"Written by Foreglow as {name}, {_NO_DIGEST}: after a change it is not overwritten"


def with_labels_digest(text: str) -> bytes:
    """A file of labels that has the `labels_mark`, with the digest of the whole file in it."""
    data = text.encode()
    return data.replace(_NO_DIGEST.encode(), _digest(data).encode(), 1)


def labels_format(path: Path) -> str | None:
    """The format in which `labels export` wrote the file at `path`; None if it did not, or it was changed since.

    Raises:
        OSError: If there is no such file, or it cannot be read.
    """
    head = _head(path)
    found = _LABELS_MARK.search(head)
    if found is None:
        return None
    digest = hashlib.sha256(head[: found.start(2)] + _NO_DIGEST.encode() + head[found.end(2) :])
    with path.open("rb") as file:
        file.seek(len(head))
        while piece := file.read(MAX_LINE):
            digest.update(piece)
    return found[1].decode() if digest.hexdigest()[: len(_NO_DIGEST)].encode() == found[2] else None


def named_png(png: bytes, title: str) -> bytes:
    """A PNG with its title, by which it is known as ours."""
    body = b"tEXtTitle\0" + title.encode("latin-1")
    chunk = (len(body) - 4).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")
    return png[:_PNG_HEADER] + chunk + png[_PNG_HEADER:]


def has_title(path: Path, title: str) -> bool:
    """Whether the file at `path` begins as a PNG with this title, as `named_png` makes it.

    Raises:
        OSError: If there is no such file, or it cannot be read.
    """
    head = _head(path)
    return named_png(head[:_PNG_HEADER], title) == head[: _PNG_HEADER + 18 + len(title)]


_NO_DIGEST = "0" * 16
"""In place of a file's digest, while that is made."""

_LABELS_MARK = re.compile(rb"Written by Foreglow as ([a-z-]+), ([0-9a-f]{16}): ")


def _digest(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[: len(_NO_DIGEST)]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(MAX_HEAD)


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


def _is_of_mot(path: Path) -> bool:
    known = json.loads(_whole(path))
    return isinstance(known, dict) and any(name.startswith(("gt/", "trackers/")) for name in known)


def _is_state(path: Path) -> bool:
    state = json.loads(_whole(path))
    begun_or_done = state.values() if isinstance(state, dict) else [None]
    return all(_has(known, "key") or _has(known, "seconds") for known in begun_or_done)


_CONTENTS: Mapping[str, Callable[[Path], bool]] = {
    "frames.jsonl": _is_of_frames,
    "times.jsonl": _is_of_frames,
    "summary.json": lambda path: _has(json.loads(_whole(path)), "is_complete", "num_frames"),
    "recipe.toml": lambda path: _has(tomllib.loads(_whole(path)), "network", "epochs"),
    "checkpoint.pt": lambda path: _first_line(path).startswith(b"PK\3\4"),
    "best.toml": lambda path: _first_line(path).startswith(b"# Found by foreglow tune"),
    "study.journal": lambda path: _has(json.loads(_first_line(path)), "op_code"),
    "config.json": lambda path: _has(json.loads(_whole(path)), "training", "boxes", "export_size_px"),
    "plan.json": lambda path: _has(json.loads(_whole(path)), "plan", "digest"),
    "experiments.json": _is_state,
    "results.json": lambda path: _has(json.loads(_whole(path)), "made_with"),
    "export.json": lambda path: _has(json.loads(_whole(path)), "data", "boxes", "size_px", "splits"),
    "checksums.json": _is_of_mot,
}
"""By name; of the files by which an earlier run, training, search or report is known."""

_FRAMES = re.compile(rb'\{"frame":\s?-?\d+,\s?"')
_PICTURE = re.compile(rb"\x89PNG\r\n")
_VIDEO = re.compile(rb"....ftyp", re.DOTALL)
_BEGINNINGS: Mapping[str, re.Pattern[bytes]] = {
    "frames.jsonl": _FRAMES,
    "times.jsonl": _FRAMES,
    "overlay.mp4": _VIDEO,
    "overlay.png": _PICTURE,
    "beam.mp4": _VIDEO,
    "beam.png": _PICTURE,
    "beam.asc": re.compile(rb"date "),
    "beam.blf": re.compile(rb"LOGG"),
    "beam.log": re.compile(rb"\(\d"),
    "config.toml": re.compile(rb"\[proposals\]\n"),
    "summary.json": re.compile(rb' +\Z|\{\n  "source"'),  # spaces keep room
}
"""By name, how the results of a run begin, also while they are written."""


def _is_picture(title: str) -> Callable[[Path], bool]:
    return lambda path: has_title(path, title)


def _is_unchanged(path: Path) -> bool:
    """Whether a TOML file has the line `with_digest` and nobody changed it since."""
    first, _, rest = _whole(path).encode().partition(b"\n")
    found = re.match(rb"# Written by Foreglow, ([0-9a-f]{16}):", first)
    return found is not None and found[1].decode() == _digest(rest)


def _is_range_model(path: Path) -> bool:
    return _has(tomllib.loads(_whole(path)), "origin", "range_log_sigma", "kinds")


def _is_annotation(path: Path) -> bool:
    splits = json.loads(_whole(path))
    return (
        _has(splits) and bool(splits) and all(_has(split, "root", "num_boxes", "quality") for split in splits.values())
    )


def _is_predictions(path: Path) -> bool:
    found = json.loads(_whole(path))
    return _has(found) and all(_has(image, "boxes", "scores") for image in found.values())


def _is_coco_results(path: Path) -> bool:
    boxes = json.loads(_whole(path))
    return isinstance(boxes, list) and all(
        each.keys() == {"image_id", "category_id", "bbox", "score"} for each in boxes
    )


RUN_PAGE = FileKind(
    "a page about a run",
    (".html", ".htm"),
    lambda path: _head(path).startswith(
        b'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Run of '  # as `Page.html` begins
    ),
)
STAGES, CHECK = "Foreglow: stages of a frame", "Foreglow: check of a calibration"
"""Titles of pictures."""
STAGE_PICTURE = FileKind("a picture of the stages", (".png",), _is_picture(STAGES))
CHECK_PICTURE = FileKind("a picture of a calibration", (".png",), _is_picture(CHECK))
CALIBRATION = FileKind(
    "an unchanged calibration", (".toml",), lambda path: _is_unchanged(path) and not _is_range_model(path)
)
QUALITY = FileKind(
    "figures of `evaluate`",
    (".json",),
    lambda path: _has(json.loads(_whole(path)), "precision", "q_k", "num_images", "is_complete"),
)
ANNOTATION = FileKind("numbers of `annotate`", (".json",), _is_annotation)
LABELS = FileKind("unchanged labels", (".xml", ".json"), lambda path: labels_format(path) is not None)
PREDICTIONS = FileKind("predictions of the same form", (".json",), _is_predictions)
RANGE_MODEL = FileKind(
    "an unchanged model of the ranges", (".toml",), lambda path: _is_unchanged(path) and _is_range_model(path)
)
MODEL = FileKind("a model", (".onnx",), lambda path: b"\x12\x08foreglow" in _head(path)[:64])
RECORDING = FileKind(
    "a recording",
    (".mcap",),
    lambda path: _head(path).startswith(b"\x89MCAP0\r\n") and b"\x08\0\0\0foreglow" in _head(path),
)
VIEW = FileKind("a view", (".rrd",), lambda path: _head(path).startswith(b"RRF") and b"foreglow" in _head(path))

TABLE = FileKind("a table", (".parquet",), lambda path: _head(path).startswith(b"PAR1"))
COCO_RESULTS = FileKind("results in COCO's form", (".json",), _is_coco_results)
