"""Labels as annotation tools have them: flat points in images, each with a name and a few attributes."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import PurePosixPath
from typing import Any

from foreglow.datasets.pvdn.schema import ImageCategory, Instance, Vehicle, is_plain
from foreglow.wording import shortened

MAX_IMAGES = 200_000
"""Images of a file of labels: three hours at 18 Hz; a file of a few bytes can state any number of frames."""

MAX_COORDINATE_PX = 2**20
"""As of `schema.Pixel`: no camera has more."""

MAX_PATH, MAX_PART = 500, 200
"""Characters of an image's path, and of its name or a folder's in it."""

MAX_NUMBER = 2**53
"""Numbers of vehicles and lights that every tool keeps exactly."""

EARLIER_IMAGE = "earlier image, without labels, beside a labelled one"
"""No tool's file says how much earlier it was."""

MAX_KINDS_NAMED = 3
"""Kinds of shapes that an error names."""

MAX_KINDS_LOST = 20
"""Different things that a message names as lost; the rest are counted together."""

ATTRIBUTES = frozenset({"oid", "iid", "direct", "rear"})
"""What the tools store beside a point."""


class Kind(StrEnum):
    """What a point marks; the names of labels in the tools."""

    VEHICLE = "vehicle"
    LIGHT = "light"
    DOUBTFUL = "doubtful"


CATEGORIES = {category.name.lower(): category for category in ImageCategory if category != ImageCategory.NONE}
"""The categories of an image by their names in the tools."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A marked point.

    Attributes:
        kind: What it marks.
        position_px: Column and row of the pixel. Tools have its middle: (4, 7) is 4.5, 7.5 there.
        oid: Number of the vehicle; None where the tool does not say it.
        iid: Number of the light; None where the tool does not say it, and for vehicles.
        is_direct: As in `Instance` and `Vehicle`.
        is_rear: As in `Instance`.
        track: The tool's own number of what it follows from image to image; None if it follows nothing.
    """

    kind: Kind
    position_px: tuple[int, int]
    oid: int | None = None
    iid: int | None = None
    is_direct: bool = False
    is_rear: bool = False
    track: int | None = None


@dataclass(frozen=True, slots=True)
class ImageLabels:
    """The labels of an image.

    Attributes:
        name: Its path below the folder of the images, with `/`; its folder there is its sequence.
        size_px: Width and height; None where the tool does not say it.
        marks: The points, a vehicle's before those of its lights.
        categories: As in `LabelledSource.categories`, without NONE.
        number: The id by which COCO's results name it; None where nobody gives it one.
    """

    name: str
    size_px: tuple[int, int] | None
    marks: tuple[Mark, ...] = ()
    categories: tuple[ImageCategory, ...] = ()
    number: int | None = None


@dataclass(frozen=True, slots=True)
class LabelSet:
    """The labels of a file.

    Attributes:
        images: The labelled images, also those in which nothing is marked.
        lost: By what it is, how much the file has that is not here, or could not take.
        is_video: Whether the images are the frames of a video or a folder, by their order; names are then numbers.
        origin: Where the images are, for messages; empty where nobody says it.
        gap: What is missing of a drive's frames before the last of the images, for messages; empty if nothing is.
    """

    images: tuple[ImageLabels, ...]
    lost: Mapping[str, int] = field(default_factory=dict)
    is_video: bool = False
    origin: str = ""
    gap: str = ""


class Lost(Counter[str]):
    """How much a file has that is not taken, by what it is.

    Attributes:
        shapes: Which of it are points, boxes and other shapes that somebody has drawn, or annotations of them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.shapes: set[str] = set()

    def add_shape(self, what: str) -> None:
        """Counts a shape."""
        self[what] += 1
        self.shapes.add(what)


def label_set(images: Iterable[ImageLabels], lost: Lost, path: object, *, is_video: bool = False) -> LabelSet:
    """The labels of the file at `path`.

    Raises:
        ValueError: If an image is there twice, there are none, or too many; or if shapes are drawn, and none is taken,
            so that all images would count as images without light.
    """
    found = checked_images(images, path)
    if lost.shapes and not any(image.marks for image in found):
        shapes = [f"{count} x {what}" for what, count in lost.most_common() if what in lost.shapes]
        got = ", ".join([*shapes[:MAX_KINDS_NAMED], *(["..."] if len(shapes) > MAX_KINDS_NAMED else [])])
        raise ValueError(
            f"{path}: expected points or boxes called {', '.join(Kind)}, in small letters, got {got} alone"
        )
    return LabelSet(found, +lost, is_video=is_video)


def lost_lines(lost: Mapping[str, int]) -> list[str]:
    """A line for each thing that was lost, the most frequent first."""
    counts = Counter(lost).most_common()
    lines = [f"not taken: {count} x {what}" for what, count in counts[:MAX_KINDS_LOST]]
    rest = sum(count for _, count in counts[MAX_KINDS_LOST:])
    return [*lines, f"not taken: {rest} x something else"] if rest else lines


def unknown_attributes(given: Mapping[str, object], ignored: Collection[str] = ()) -> list[str]:
    """What is said of a point and not taken, for `LabelSet.lost`: attributes of other names that have a value.

    >>> unknown_attributes({"oid": 3, "Rear": True, "note": "", "occluded": False}, ["occluded"])
    ["attribute 'Rear'"]
    """
    names = (name for name, value in given.items() if value is not None and value != "")
    return [f"attribute {shortened(name)}" for name in names if name not in ATTRIBUTES and name not in ignored]


def unused(kind: Kind, oid: int | None, iid: int | None, *, is_rear: bool) -> list[str]:
    """What is said of a point of this kind and not taken, for `LabelSet.lost`: what only other kinds have.

    >>> unused(Kind.VEHICLE, 3, 7, is_rear=True), unused(Kind.DOUBTFUL, 3, 7, is_rear=True)
    (["'iid' of a vehicle", "'rear' of a vehicle"], ["'oid' of doubtful light"])
    """
    if kind == Kind.VEHICLE:
        return [f"'{name}' of a vehicle" for name, is_said in (("iid", iid is not None), ("rear", is_rear)) if is_said]
    return ["'oid' of doubtful light"] if kind == Kind.DOUBTFUL and oid is not None else []


def marks_of(vehicles: Iterable[Vehicle], doubtful: Iterable[Instance] = ()) -> tuple[Mark, ...]:
    """The points of vehicles, of their lights, and of doubtful light."""
    marks = []
    for vehicle in vehicles:
        marks.append(Mark(Kind.VEHICLE, vehicle.position_px, vehicle.oid, None, vehicle.is_direct))
        marks += [_mark(Kind.LIGHT, instance, vehicle.oid) for instance in vehicle.instances]
    return (*marks, *(_mark(Kind.DOUBTFUL, instance, None) for instance in doubtful))


def _mark(kind: Kind, instance: Instance, oid: int | None) -> Mark:
    return Mark(kind, instance.position_px, oid, instance.iid, instance.is_direct, instance.is_rear)


def numbered(images: Sequence[ImageLabels]) -> list[ImageLabels]:
    """`images` with numbers for all vehicles and lights.

    What a tool follows through the images of a folder is one there, and lights of a folder with the same number are of
    one vehicle: where some of their points have the number that others lack, it is that of all. Everything else without
    a number is another one than all others.
    """
    marks = [mark for image in images for mark in image.marks]
    given = {mark.iid for mark in marks if mark.iid is not None}
    tracks = {mark.track for mark in marks if mark.track is not None}
    iids, oids = _free(given | tracks), _free({mark.oid for mark in marks if mark.oid is not None})

    def new_iid(mark: Mark) -> int:
        return next(iids) if mark.track is None or mark.track in given else mark.track

    def vehicle_known_by(mark: Mark) -> int | None:
        return mark.track if mark.kind == Kind.VEHICLE else mark.iid

    lights = _filled(images, "iid", (Kind.LIGHT, Kind.DOUBTFUL), lambda mark: mark.track, new_iid)
    return _filled(lights, "oid", (Kind.LIGHT, Kind.VEHICLE), vehicle_known_by, lambda _: next(oids))


def _free(taken: Collection[int]) -> Iterator[int]:
    """Numbers that are not taken: above all of these, or from 0 on where not every tool keeps numbers above."""
    first = 1 + max(taken, default=-1)
    return itertools.count(first) if first < MAX_NUMBER // 2 else (n for n in itertools.count() if n not in taken)


def _filled(
    images: Sequence[ImageLabels],
    name: str,
    kinds: Collection[Kind],
    known_by: Callable[[Mark], int | None],
    new: Callable[[Mark], int],
) -> list[ImageLabels]:
    """`images` with the number called `name` in all points of these `kinds`.

    Points of the same kind that are `known_by` the same are of one thing in their folder, unless an image has several.
    """
    keys: list[list[Hashable]] = []
    given: dict[Hashable, set[int]] = {}
    for place, image in enumerate(images):
        known = [(mark.kind, image.name.rpartition("/")[0], known_by(mark)) for mark in image.marks]
        counts = Counter(known)
        keys.append([(place, k) if key[2] is None or counts[key] > 1 else key for k, key in enumerate(known)])
        for key, mark in zip(keys[-1], image.marks, strict=True):
            given.setdefault(key, set()).update({getattr(mark, name)} - {None})
    numbers = {key: found.pop() for key, found in given.items() if len(found) == 1}

    def filled(key: Hashable, mark: Mark) -> Mark:
        if mark.kind not in kinds or getattr(mark, name) is not None:
            return mark
        if key not in numbers:
            numbers[key] = new(mark)
        value: dict[str, Any] = {name: numbers[key]}
        return dataclasses.replace(mark, **value)

    return [
        dataclasses.replace(image, marks=tuple(map(filled, its_keys, image.marks)))
        for its_keys, image in zip(keys, images, strict=True)
    ]


def vehicles_of(marks: Sequence[Mark], origin: str) -> tuple[Vehicle, ...]:
    """The vehicles that the points of an image mark, which are `numbered`.

    A vehicle without a point lies amid its lights.

    Raises:
        ValueError: If a vehicle has several points; the message begins with `origin`.
    """
    marks = [mark for mark in marks if mark.kind != Kind.DOUBTFUL]
    points: dict[int, Mark] = {}
    lights: dict[int, list[Instance]] = {}
    for mark in marks:
        oid = mark.oid
        assert oid is not None
        instances = lights.setdefault(oid, [])
        if mark.kind == Kind.VEHICLE:
            if oid in points:
                raise ValueError(f"{origin}: vehicle {oid}: expected one point, got several")
            points[oid] = mark
            continue
        instances.append(_instance(mark))
    return tuple(
        Vehicle(
            position_px=points[oid].position_px if oid in points else _middle(instances),
            oid=oid,
            instances=tuple(instances),
            is_direct=points[oid].is_direct if oid in points else any(light.is_direct for light in instances),
        )
        for oid, instances in lights.items()
    )


def doubtful_of(marks: Iterable[Mark]) -> tuple[Instance, ...]:
    """The doubtful light among the points of an image, which are `numbered`."""
    return tuple(_instance(mark) for mark in marks if mark.kind == Kind.DOUBTFUL)


def _instance(mark: Mark) -> Instance:
    assert mark.iid is not None
    return Instance(position_px=mark.position_px, iid=mark.iid, is_direct=mark.is_direct, is_rear=mark.is_rear)


def _middle(instances: Sequence[Instance]) -> tuple[int, int]:
    columns, rows = zip(*(instance.position_px for instance in instances), strict=True)
    return round(sum(columns) / len(columns)), round(sum(rows) / len(rows))


def pixel(x: float, y: float, origin: str) -> tuple[int, int]:
    """The pixel at a point of a tool.

    Raises:
        ValueError: If the point lies beyond any image, or is none; the message begins with `origin`.
    """
    if not (abs(x) < MAX_COORDINATE_PX and abs(y) < MAX_COORDINATE_PX):  # false for NaN
        raise ValueError(f"{origin}: expected a point within {MAX_COORDINATE_PX} px, got {x:g}, {y:g}")
    return math.floor(x), math.floor(y)


def check_near(image: ImageLabels, size_px: tuple[int, int], origin: object) -> None:
    """Passes an image whose points lie in it, or no farther outside than it is wide and high, as PVDN's may.

    Raises:
        ValueError: If one lies farther away; the message begins with `origin`.
    """
    width_px, height_px = size_px
    for mark in image.marks:
        x, y = mark.position_px
        if not (-width_px <= x < 2 * width_px and -height_px <= y < 2 * height_px):
            wanted = f"points in or near an image of {width_px}x{height_px} px"
            raise ValueError(f"{origin}: {image.name}: expected {wanted}, got {x}, {y}")


def num_outside(image: ImageLabels) -> int:
    """How many points lie outside the image, if its size is known."""
    width_px, height_px = image.size_px or (2 * MAX_COORDINATE_PX,) * 2
    points = (mark.position_px for mark in image.marks)
    return sum(not (0 <= x < width_px and 0 <= y < height_px) for x, y in points)


def number(value: object, origin: str) -> int | None:
    """The number of a vehicle or a light in an attribute; None for nothing, or an empty text.

    Raises:
        ValueError: If it is no whole number; the message begins with `origin`.
    """
    if value is None or value == "":
        return None
    text = str(value) if isinstance(value, int | str) and not isinstance(value, bool) else ""
    if isinstance(value, float) and value.is_integer() and abs(value) <= MAX_NUMBER:
        text = str(int(value))
    if not re.fullmatch(r"-?[0-9]{1,16}", text.strip()) or abs(int(text)) > MAX_NUMBER:
        raise ValueError(f"{origin}: expected a whole number, got {shortened(value)}")
    return int(text)


def truth(value: object, origin: str) -> bool:
    """The truth value in an attribute that is there, also as 1 or 0. An empty text or nothing says neither.

    Raises:
        ValueError: If it is none; the message begins with `origin`.
    """
    values = {False: False, True: True, "false": False, "true": True, "0": False, "1": True}  # False == 0, True == 1
    key = value.strip().lower() if isinstance(value, str) else value
    if not isinstance(key, int | float | str) or key not in values:
        raise ValueError(f"{origin}: expected true or false, got {shortened(value)}")
    return values[key]


def plain_path(name: str, origin: str) -> str:
    """`name`, if it is a path below a folder that stays there.

    Raises:
        ValueError: If it is absolute, climbs, is too long, or has characters that not every format keeps: those that
            cannot be printed, such as tabs and escape characters, backslashes, and bytes that are no UTF-8; the
            message begins with `origin`.
    """
    parts = PurePosixPath(name).parts
    is_bad = not parts or not is_plain(name) or len(name) > MAX_PATH or re.match("[A-Za-z]:", name)
    if is_bad or any(part in ("/", "//", "..") or len(part) > MAX_PART for part in parts):
        raise ValueError(
            f"{origin}: expected a path below the folder of the images, of printable UTF-8 without backslashes, "
            f"at most {MAX_PATH} characters and {MAX_PART} in each part, got {shortened(name)}"
        )
    return "/".join(parts)


def checked_images(images: Iterable[ImageLabels], path: object) -> tuple[ImageLabels, ...]:
    """The images of the file at `path`.

    Raises:
        ValueError: If one is there twice, there are none, or too many.
    """
    found: dict[str, ImageLabels] = {}
    for image in images:
        if image.name in found:
            raise ValueError(f"{path}: expected each image once, {shortened(image.name)} is there twice")
        if len(found) == MAX_IMAGES:
            raise ValueError(f"{path}: expected at most {MAX_IMAGES} images, got more")
        found[image.name] = image
    if not found:
        raise ValueError(f"{path}: expected labelled images, found none")
    return tuple(found.values())


def attributes_of(mark: Mark) -> dict[str, int | bool]:
    """What the tools store beside a point."""
    numbers = {name: value for name, value in (("oid", mark.oid), ("iid", mark.iid)) if value is not None}
    is_vehicle = mark.kind == Kind.VEHICLE
    return {**numbers, "direct": mark.is_direct} | ({} if is_vehicle else {"rear": mark.is_rear})
