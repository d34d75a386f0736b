"""Label Studio's JSON: a list of tasks, an image each, whose regions are key points.

Source: the documentation of Label Studio's JSON export format and of its tags KeyPointLabels, Choices and Number.
Positions are in per cent of the image. `docs/own_data.md` has the labelling configuration.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Annotated, Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from pydantic import Field, RootModel

from foreglow.datasets.exchange.marks import (
    CATEGORIES,
    ImageLabels,
    Kind,
    LabelSet,
    Lost,
    Mark,
    attributes_of,
    label_set,
    number,
    pixel,
    plain_path,
    unused,
)
from foreglow.datasets.json_files import Record, read_json
from foreglow.own_files import labels_mark
from foreglow.wording import shortened

_UPLOADED = re.compile(r"^[0-9a-f]{8}-")
"""What Label Studio puts before the name of an uploaded file."""

_TYPES = {"category": "choices", "is": "choices", "oid": "number", "iid": "number"}
"""By their names in the labelling configuration, the types of what is said of an image or a point."""

Size = Annotated[int, Field(ge=1, le=2**20)]


class Region(Record):
    """A part of an annotation: a key point, or what is said of one of the same id."""

    id: str | None = None
    type: str = ""
    from_name: str = ""
    value: dict[str, Any] = Field(default_factory=dict)
    original_width: Size | None = None
    original_height: Size | None = None
    image_rotation: float = 0.0


class Annotation(Record):
    """What one person says of an image; the ground truth is what somebody has marked as such."""

    result: tuple[Region, ...] = ()
    was_cancelled: bool = False
    ground_truth: bool = False


class Task(Record):
    """An image."""

    data: dict[str, Any] | None = None
    annotations: tuple[Annotation, ...] = ()
    predictions: tuple[Any, ...] = ()


class TasksFile(RootModel[tuple[Task, ...]]):
    """A file."""


def read_label_studio(path: Path) -> LabelSet:
    """The labels in the JSON of Label Studio at `path`; tasks that nobody has annotated are no labels.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such file, or beyond a bound; the message names the field.
    """
    lost = Lost()
    images = []
    for index, task in enumerate(read_json(path, TasksFile).root):
        origin = f"{path}: {index}"
        if task.data is None:
            words = 'expected that of a task, as in Label Studio\'s export "JSON" ("JSON-MIN" has none)'
            raise ValueError(f"{origin}.data: {words}, found none")
        given = [annotation for annotation in reversed(task.annotations) if not annotation.was_cancelled]
        lost["annotation that was cancelled"] += len(task.annotations) - len(given)
        lost["annotation that another of the same image replaces"] += max(0, len(given) - 1)
        if given:
            name = plain_path(_name_of(task.data, origin), f"{origin}.data.image")
            taken = max(given, key=lambda annotation: annotation.ground_truth)
            images.append(_image(name, taken, origin, lost))
        else:
            lost["image that nobody has annotated"] += 1
    if not images and lost["image that nobody has annotated"]:
        raise ValueError(f"{path}: expected tasks that somebody has annotated, got predictions or cancelled ones alone")
    return label_set(images, lost, path)


def _name_of(data: dict[str, Any], origin: str) -> str:
    """The path of an image below the folder of the images, by its address in Label Studio."""
    address = data.get("image")
    if not isinstance(address, str):
        raise ValueError(f"{origin}.data.image: expected the address of an image, got {shortened(address)}")
    parts = urlsplit(address)
    local = parse_qs(parts.query).get("d")
    if local:
        return local[0]
    path = unquote(parts.path)
    if parts.scheme or path.startswith("/"):
        return _UPLOADED.sub("", PurePosixPath(path).name)
    return path


def _image(name: str, annotation: Annotation, origin: str, lost: Lost) -> ImageLabels:
    said: dict[str, dict[str, Any]] = {}
    others = set[str]()  # regions of which nothing is taken
    points: dict[str, Region] = {}
    categories = []
    size_px = None
    for index, region in enumerate(annotation.result):
        key = region.id or f"#{index}"
        if region.type in ("keypointlabels", "rectanglelabels"):
            first = points.setdefault(key, region)
            if (first.type, first.value) != (region.type, region.value):
                raise ValueError(f"{origin}: region {shortened(key)}: expected one point or box, got several")
        elif _TYPES.get(region.from_name) != region.type:
            lost[f"region of the type {shortened(region.type)}"] += 1
            if region.type.endswith("labels"):
                lost.shapes.add(f"region of the type {shortened(region.type)}")
                others.add(key)
        elif region.from_name == "category":
            for choice in _texts(region.value.get("choices"), origin):
                if choice in CATEGORIES:
                    categories.append(CATEGORIES[choice])
                else:
                    lost[f"category {shortened(choice)}"] += 1
        elif region.type == "number" and region.value.get("number") is None:
            lost[f"{shortened(region.from_name)} without its number"] += 1
        else:
            found = said.setdefault(key, {}).setdefault(region.from_name, region.value)
            if found != region.value:
                field = f"{origin}: region {shortened(key)}: {region.from_name}"
                raise ValueError(f"{field}: expected one value, got {shortened(found)} and {shortened(region.value)}")
    for key in said.keys() - others - points.keys():
        lost.update(f"{shortened(name)} of a point that is not there" for name in said[key])
    marks = []
    for key, region in points.items():
        where = f"{origin}: region {shortened(key)}"
        names = _texts(region.value.get(region.type), where)
        if len(names) != 1 or names[0] not in set(Kind):
            lost.add_shape(f"point labelled {shortened(', '.join(names))}")
            continue
        if region.original_width is None or region.original_height is None:
            raise ValueError(f"{where}: expected original_width and original_height, got none")
        if region.image_rotation:
            raise ValueError(
                f"{where}: image_rotation: expected 0, an image as it is stored, got {region.image_rotation:g}"
            )
        found_px = region.original_width, region.original_height
        if size_px is not None and found_px != size_px:
            raise ValueError(f"{where}: original_width, original_height: expected {size_px} as before, got {found_px}")
        size_px = found_px
        choices = _texts(said.get(key, {}).get("is", {}).get("choices"), where)
        lost.update(f"choice {shortened(choice)}" for choice in choices if choice not in ("direct", "rear"))
        mark = _mark(Kind(names[0]), region.value, size_px, said.get(key, {}), where)
        lost.update(unused(mark.kind, mark.oid, mark.iid, is_rear=mark.is_rear))
        marks.append(mark)
    return ImageLabels(name, size_px, tuple(marks), tuple(categories))


def _mark(
    kind: Kind, value: dict[str, Any], size_px: tuple[int, int], said: dict[str, dict[str, Any]], origin: str
) -> Mark:
    x, y = (_percent(value, name, origin) for name in "xy")
    if "rectanglelabels" in value:
        if value.get("rotation"):
            raise ValueError(f"{origin}: rotation: expected 0, an upright box, got {shortened(value['rotation'])}")
        x, y = x + _percent(value, "width", origin) / 2, y + _percent(value, "height", origin) / 2
    choices = _texts(said.get("is", {}).get("choices"), origin)
    return Mark(
        kind,
        pixel(x * size_px[0] / 100, y * size_px[1] / 100, origin),
        number(said.get("oid", {}).get("number"), f"{origin}: oid"),
        number(said.get("iid", {}).get("number"), f"{origin}: iid"),
        "direct" in choices,
        "rear" in choices,
    )


def _percent(value: dict[str, Any], name: str, origin: str) -> float:
    found = value.get(name)
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise ValueError(f"{origin}: {name}: expected a number, got {shortened(found)}")
    return float(found) if abs(found) < 2**53 else math.nan


def _texts(value: object, origin: str) -> list[str]:
    if value is None:
        return []
    if not isinstance(value, list | tuple) or not all(isinstance(part, str) for part in value):
        raise ValueError(f"{origin}: expected a list of texts, got {shortened(value)}")
    return list(value)


def label_studio_text(labels: LabelSet, *, is_guess: bool = False) -> tuple[str, Counter[str]]:
    """The labels as tasks for Label Studio, and what they cannot take.

    Args:
        labels: The labels.
        is_guess: Whether they are predictions, which a person has yet to accept.
    """
    tasks: list[dict[str, Any]] = []
    for task_id, image in enumerate(labels.images, start=1):
        result: list[dict[str, Any]] = []
        for index, mark in enumerate(image.marks):
            result += _regions(mark, f"r{index}", image.size_px or (1, 1))
        if image.categories:
            choices = [category.name.lower() for category in image.categories]
            result.append(_part("categories", "choices", "category", {"choices": choices}))
        key = "predictions" if is_guess else "annotations"
        data = {"image": f"/data/local-files/?d={quote(image.name)}"}
        about = {} if tasks else {"meta": {"about": labels_mark("label-studio")}}
        tasks.append({"id": task_id, **about, "data": data, key: [{"id": task_id, "result": result}]})
    return json.dumps(tasks, indent=1) + "\n", Counter()


def _regions(mark: Mark, key: str, size_px: tuple[int, int]) -> list[dict[str, Any]]:
    (x, y), (width_px, height_px) = mark.position_px, size_px
    place = {"x": 100 * (x + 0.5) / width_px, "y": 100 * (y + 0.5) / height_px, "width": 100 / width_px}
    size = {"original_width": width_px, "original_height": height_px, "image_rotation": 0}
    point = _part(key, "keypointlabels", "point", {**place, "keypointlabels": [str(mark.kind)]})
    parts = [point]
    given = attributes_of(mark)
    parts += [_part(key, "number", name, {**place, "number": given[name]}) for name in ("oid", "iid") if name in given]
    choices = [name for name in ("direct", "rear") if given.get(name)]
    if choices:
        parts.append(_part(key, "choices", "is", {**place, "choices": choices}))
    return [part | size for part in parts]


def _part(key: str, kind: str, from_name: str, value: dict[str, Any]) -> dict[str, Any]:
    return {"id": key, "type": kind, "from_name": from_name, "to_name": "image", "value": value}
