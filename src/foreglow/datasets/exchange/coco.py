"""COCO key points: each vehicle and each light is an annotation with one key point, and attributes as CVAT writes them.

Source: the data format of COCO key points (cocodataset.org), and its field `attributes` as CVAT and datumaro have it.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from foreglow.datasets.exchange.marks import (
    MAX_NUMBER,
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
    truth,
    unknown_attributes,
    unused,
)
from foreglow.datasets.json_files import Record, read_json
from foreglow.own_files import labels_mark
from foreglow.wording import shortened

IDS = {kind: index for index, kind in enumerate(Kind, start=1)}
"""Ids of the categories that are written."""

OTHER_FIELDS = frozenset({"area", "iscrowd", "num_keypoints", "score", "ignore", "group", "group_id", "track_id"})
"""Fields of an annotation that COCO and its tools write; but for `track_id`, they say nothing of a point."""

OTHER_ATTRIBUTES = frozenset(
    {"occluded", "rotation", "track_id", "keyframe", "outside", "z_order", "is_crowd", "score", "group", "source"}
)
"""Attributes that CVAT and datumaro write beside those of the user."""

UNSEEN = "key point without visibility, in whose place the middle of the box is taken"
"""COCO gives a key point that is not labelled a visibility of 0."""

Id = Annotated[int, Field(ge=0, le=2**53)]
Numbers = tuple[float, ...]


class CocoImage(Record):
    """An image."""

    id: Id
    file_name: str
    width: Annotated[int, Field(ge=1, le=2**20)]
    height: Annotated[int, Field(ge=1, le=2**20)]


class CocoCategory(Record):
    """A category of annotations."""

    id: Id
    name: str


class CocoAnnotation(Record):
    """An annotation; of one without key points, the middle of its box is taken. Some tools leave its id out.

    Of one without a box, or whose box has no size, it is the box of its polygons: some tools write `[]` or zeros.
    """

    image_id: Id
    category_id: Id
    id: Id | None = None
    keypoints: Numbers = ()
    bbox: Numbers = ()
    segmentation: Any = None
    attributes: dict[str, Any] = Field(default_factory=dict)


class CocoFile(Record):
    """A file."""

    images: tuple[CocoImage, ...]
    categories: tuple[CocoCategory, ...]
    annotations: tuple[CocoAnnotation, ...]


def read_coco(path: Path) -> LabelSet:
    """The labels in the COCO file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such file, refers to nothing, or is beyond a bound; the message names the field.
    """
    file = read_json(path, CocoFile)
    _check_ids(file.categories, f"{path}: categories")
    _check_ids(file.images, f"{path}: images")
    names = {category.id: category.name for category in file.categories}
    marks: dict[int, list[Mark]] = {image.id: [] for image in file.images}
    lost = Lost()
    ids: set[int] = set()
    for index, annotation in enumerate(file.annotations):
        origin = f"{path}: annotations.{index}"
        if annotation.id is not None:
            if annotation.id in ids:
                raise ValueError(f"{origin}.id: expected another id for each annotation, got {annotation.id} twice")
            ids.add(annotation.id)
        if annotation.image_id not in marks:
            raise ValueError(f"{origin}.image_id: expected an id of images, got {annotation.image_id}")
        if annotation.category_id not in names:
            raise ValueError(f"{origin}.category_id: expected an id of categories, got {annotation.category_id}")
        name = names[annotation.category_id]
        if name not in set(Kind):
            lost.add_shape(f"annotation of the category {shortened(name)}")
            continue
        lost.update(unknown_attributes(annotation.attributes, OTHER_ATTRIBUTES))
        fields = (annotation.model_extra or {}).keys() - OTHER_FIELDS
        lost.update(f"field {shortened(name)} of an annotation" for name in fields)
        point = _point(annotation, origin)
        lost["further key point of an annotation"] += max(0, sum(each > 0 for each in annotation.keypoints[2::3]) - 1)
        if point is None:
            lost.add_shape("annotation without a key point or a box")
        else:
            lost[UNSEEN] += bool(annotation.keypoints) and max(annotation.keypoints[2::3]) <= 0
            given = annotation.attributes
            track = given.get("track_id", (annotation.model_extra or {}).get("track_id"))
            mark = _mark(Kind(name), pixel(*point, f"{origin}.keypoints"), given, origin, track)
            lost.update(unused(mark.kind, mark.oid, mark.iid, is_rear=mark.is_rear))
            marks[annotation.image_id].append(mark)
    images = (
        ImageLabels(
            plain_path(image.file_name, f"{path}: images.{index}.file_name"),
            (image.width, image.height),
            tuple(marks[image.id]),
            number=image.id,
        )
        for index, image in enumerate(file.images)
    )
    return label_set(images, lost, path)


def _check_ids(records: Sequence[CocoImage | CocoCategory], origin: str) -> None:
    """ValueError if two have the same id."""
    twice = next((id_ for id_, num in Counter(record.id for record in records).items() if num > 1), None)
    if twice is not None:
        raise ValueError(f"{origin}: expected another id for each, got {twice} twice")


def _point(annotation: CocoAnnotation, origin: str) -> tuple[float, float] | None:
    """The first key point that is labelled, else the middle of the box, else that of the polygons' box."""
    points = annotation.keypoints
    if len(points) % 3:
        raise ValueError(f"{origin}.keypoints: expected x, y, visibility of each, got {len(points)} numbers")
    for x, y, visibility in zip(points[0::3], points[1::3], points[2::3], strict=False):
        if visibility > 0:
            return x, y
    corners = _corners(annotation.segmentation)
    if corners and not (len(annotation.bbox) == 4 and any(annotation.bbox[2:])):
        xs, ys = corners[0::2], corners[1::2]
        return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    if len(annotation.bbox) == 4:
        x, y, width, height = annotation.bbox
        if width < 0 or height < 0:
            raise ValueError(f"{origin}.bbox: expected a width and height of at least 0, got {width:g} and {height:g}")
        return x + width / 2, y + height / 2
    return None


def _corners(segmentation: object) -> list[float]:
    """The corners, x and y in turn, of COCO's polygons; empty without any, such as for a mask."""
    polygons = segmentation if isinstance(segmentation, list) else []
    if not all(isinstance(polygon, list) and len(polygon) % 2 == 0 for polygon in polygons):
        return []
    numbers = [each for polygon in polygons for each in polygon]
    is_plain = all(type(each) in (int, float) and abs(each) <= MAX_NUMBER for each in numbers)
    return numbers if is_plain else []


def _mark(kind: Kind, position_px: tuple[int, int], given: Mapping[str, Any], origin: str, track: object) -> Mark:
    return Mark(
        kind,
        position_px,
        number(given.get("oid"), f"{origin}.attributes.oid"),
        number(given.get("iid"), f"{origin}.attributes.iid"),
        truth(given.get("direct", False), f"{origin}.attributes.direct"),
        truth(given.get("rear", False), f"{origin}.attributes.rear"),
        track if type(track) is int and abs(track) <= MAX_NUMBER else None,
    )


def _ids(images: Sequence[ImageLabels]) -> Sequence[int]:
    """The images' own numbers, which results of a run have, too; where one has none that COCO takes, from 1 on."""
    numbers = [image.number for image in images if image.number is not None and image.number >= 0]
    return numbers if len(set(numbers)) == len(images) else range(1, len(images) + 1)


def coco_text(labels: LabelSet) -> tuple[str, Counter[str]]:
    """The labels as a COCO file, and what it cannot take."""
    lost: Counter[str] = Counter()
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for image_id, image in zip(_ids(labels.images), labels.images, strict=True):
        width_px, height_px = image.size_px or (1, 1)
        images.append({"id": image_id, "file_name": image.name, "width": width_px, "height": height_px})
        lost["category of an image"] += len(image.categories)
        for mark in image.marks:
            x, y = mark.position_px
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": IDS[mark.kind],
                    "keypoints": [x + 0.5, y + 0.5, 2],
                    "num_keypoints": 1,
                    "bbox": [x, y, 1, 1],
                    "area": 1,
                    "iscrowd": 0,
                    "segmentation": [],
                    "attributes": attributes_of(mark),
                }
            )
    categories = [
        {"id": index, "name": str(kind), "supercategory": "", "keypoints": ["point"], "skeleton": []}
        for kind, index in IDS.items()
    ]
    info = {"description": labels_mark("coco")}
    file = {"info": info, "licenses": [], "images": images, "categories": categories, "annotations": annotations}
    return json.dumps(file, indent=1) + "\n", +lost
