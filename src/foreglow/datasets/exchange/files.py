"""The formats of annotation tools, and which of them a file has."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from foreglow.datasets.exchange.coco import coco_text, read_coco
from foreglow.datasets.exchange.cvat import cvat_text, cvat_video_text, read_cvat
from foreglow.datasets.exchange.label_studio import label_studio_text, read_label_studio
from foreglow.datasets.exchange.marks import LabelSet
from foreglow.files import check_encoding, checked_path

_HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class LabelFormat:
    """A format of labels.

    Attributes:
        suffix: Ending of its files.
        begins: What such a file begins with, by which it is told from others of the same ending.
        read: The labels in the file at a path.
        text: The file that holds the labels, and what it cannot take.
        guess_text: As `text`, for labels that a person has yet to accept.
        has_names: Whether its files have the images' names.
    """

    suffix: str
    begins: re.Pattern[bytes]
    read: Callable[[Path], LabelSet]
    text: Callable[[LabelSet], tuple[str, Counter[str]]]
    guess_text: Callable[[LabelSet], tuple[str, Counter[str]]]
    has_names: bool = True


_XML = re.compile(rb"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*(<!DOCTYPE.*)?<annotations\b", re.DOTALL)
LABEL_FORMATS: dict[str, LabelFormat] = {
    "cvat": LabelFormat(".xml", _XML, read_cvat, cvat_text, cvat_text),
    "cvat-video": LabelFormat(".xml", _XML, read_cvat, cvat_video_text, cvat_video_text, has_names=False),
    "coco": LabelFormat(".json", re.compile(rb"\s*\{"), read_coco, coco_text, coco_text),
    "label-studio": LabelFormat(
        ".json",
        re.compile(rb"\s*\["),
        read_label_studio,
        label_studio_text,
        partial(label_studio_text, is_guess=True),
    ),
}
"""The formats by name; a file has the first whose ending and beginning it has."""


def label_format_of(path: Path | str) -> str | None:
    """The name of the format of the file at `path`; None if it is none of them."""
    path = checked_path(path)
    if path.suffix.lower() not in (".xml", ".json") or not path.is_file():
        return None
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf")
    return next(
        (
            name
            for name, each in LABEL_FORMATS.items()
            if each.suffix == path.suffix.lower() and each.begins.match(head)
        ),
        None,
    )


def is_labels(path: Path | str) -> bool:
    """Whether `path` is a file of an annotation tool, by its ending and its beginning."""
    return label_format_of(path) is not None


def read_labels_file(path: Path | str) -> LabelSet:
    """The labels in the file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it has none of the formats, or is broken.
    """
    path = checked_path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file, expected labels of CVAT, COCO or Label Studio")
    name = label_format_of(path)
    if name is None and path.is_file():
        with path.open("rb") as file:
            check_encoding(file.read(2), path)
    if name is None:
        raise ValueError(f"{path}: expected labels of CVAT (.xml), COCO or Label Studio (.json), got another file")
    return LABEL_FORMATS[name].read(path)
