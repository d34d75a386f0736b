"""CVAT's XML 1.1, for images and for video: points with attributes, and tags of an image.

Source: CVAT's documentation of its XML annotation format, version 1.1.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from foreglow.datasets.exchange.marks import (
    CATEGORIES,
    MAX_IMAGES,
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
from foreglow.datasets.pvdn.schema import ImageCategory
from foreglow.files import number_in
from foreglow.maps.xml_file import number_of, read_xml
from foreglow.own_files import labels_mark
from foreglow.wording import shortened

MAX_SIZE_PX = 2**20

SHAPES = frozenset({"points", "box", "polygon", "polyline", "ellipse", "cuboid", "mask", "skeleton"})
"""What CVAT draws; points and boxes are taken."""

ABOUT = frozenset({"version", "meta"})
"""Elements beside the images or tracks that mark nothing."""


def read_cvat(path: Path) -> LabelSet:
    """The labels in CVAT's XML at `path`, of images or of a video.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such file, or beyond a bound; the message names the element.
    """
    root = read_xml(path, "annotations")
    lost = Lost()
    images = root.findall("image")
    taken = {*ABOUT, "image" if images else "track"}
    lost.update(f"element {shortened(each.tag)}" for each in root if each.tag not in taken)
    if not images:
        return _read_video(root, path, lost)
    found = [_read_image(element, f"{path}: image {index}", lost) for index, element in enumerate(images)]
    return label_set(found, lost, path)


def _read_image(element: Element, origin: str, lost: Lost) -> ImageLabels:
    marks: list[Mark] = []
    categories: list[ImageCategory] = []
    for shape in element:
        if shape.tag == "tag" and shape.get("label") in CATEGORIES:
            categories.append(CATEGORIES[shape.get("label", "")])
            lost.update(f"element {shortened(each.tag)} of a tag" for each in shape)
        elif shape.tag == "tag":
            lost[f"tag {shortened(shape.get('label'))}"] += 1
        else:
            marks += _marks(shape, shape.get("label"), {}, origin, lost)
    name = plain_path(element.get("name") or "", f"{origin}: name")
    return ImageLabels(name, _size_px(element, "width", "height", origin), tuple(marks), tuple(categories))


def _size_px(element: Element, width: str, height: str, origin: str) -> tuple[int, int] | None:
    if element.get(width) is None or element.get(height) is None:
        return None
    size_px = tuple(number(element.get(name), f"{origin}: {name}") or 0 for name in (width, height))
    if not all(1 <= side_px <= MAX_SIZE_PX for side_px in size_px):
        raise ValueError(f"{origin}: {width}, {height}: expected 1 to {MAX_SIZE_PX} px, got {size_px[0]}x{size_px[1]}")
    return size_px[0], size_px[1]


def _marks(
    shape: Element,
    label: str | None,
    common: Mapping[str, str],
    origin: str,
    lost: Lost,
    track_id: str | None = None,
) -> Iterator[Mark]:
    """The points of a shape that has this label; `track_id` is the number of its track."""
    if shape.tag not in ("points", "box"):
        lost.add_shape(f"shape {shortened(shape.tag)}")
    elif label not in set(Kind):
        lost.add_shape(f"shape labelled {shortened(label)}")
    else:
        where = f"{origin}: <{shape.tag}>"
        given = _attributes(shape, where, common)
        lost.update(unknown_attributes(given))
        lost.update(f"element {shortened(each.tag)} of a shape" for each in shape if each.tag != "attribute")
        oid, iid = (number(given.get(name), f"{where} {name}") for name in ("oid", "iid"))
        is_direct, is_rear = (truth(given.get(name, False), f"{where} {name}") for name in ("direct", "rear"))
        lost.update(unused(Kind(label), oid, iid, is_rear=is_rear))
        track = number(track_id, f"{where} id")
        points = _points(shape, where)
        light = track if iid is None else iid
        if len(points) > 1 and light is not None and label != Kind.VEHICLE:
            raise ValueError(f"{where} points: expected one point of light {light}, got {len(points)}")
        for x, y in points:
            yield Mark(Kind(label), pixel(x, y, where), oid, iid, is_direct, is_rear, track)


def _attributes(element: Element, origin: str, common: Mapping[str, str] | None = None) -> dict[str, str]:
    """The values of attributes by name: those of an element, and those that hold for all elements like it.

    Raises:
        ValueError: If an attribute has two values; the message begins with `origin`.
    """
    given = dict(common or {})
    for each in element.findall("attribute"):
        name, value = each.get("name", ""), each.text or ""
        if given.setdefault(name, value) != value:
            one = f"{origin} {shortened(name)}: expected one value"
            raise ValueError(f"{one}, got {shortened(given[name])} and {shortened(value)}")
    return given


def _points(shape: Element, origin: str) -> list[tuple[float, float]]:
    if shape.tag == "box":
        left, top, right, bottom = (number_of(shape, name, origin) for name in ("xtl", "ytl", "xbr", "ybr"))
        if left > right or top > bottom:
            corners = f"{left:g}, {top:g}, {right:g}, {bottom:g}"
            raise ValueError(f"{origin}: expected xtl up to xbr and ytl up to ybr, got {corners}")
        return [((left + right) / 2, (top + bottom) / 2)]
    text = shape.get("points", "")
    try:
        return [(number_in(x), number_in(y)) for x, y in (pair.split(",") for pair in text.split(";"))]
    except ValueError:
        raise ValueError(f"{origin} points: expected x,y;x,y;..., got {shortened(text)}") from None


def _read_video(root: Element, path: Path, lost: Lost) -> LabelSet:
    """Each track is a vehicle or a light; every frame of the task is labelled, and no other.

    Where a track goes on and has no shape, the frame is left out: it was deleted in CVAT, or is for interpolation. A
    track goes on to where it is outside, or else to the end of the task.
    """
    frames = _frames(root, path)
    size = root.find("meta/task/original_size")
    size = root.find("meta/original_size") if size is None else size
    size_px = None
    if size is not None:
        texts = {name: size.findtext(name) for name in ("width", "height")}
        given = Element("original_size", {name: text for name, text in texts.items() if text is not None})
        size_px = _size_px(given, "width", "height", f"{path}: original_size")
    marks: dict[int, list[Mark]] = {frame: [] for frame in frames}
    unknown: set[int] = set()
    for index, track in enumerate(root.findall("track")):
        origin = f"{path}: track {index}"
        common = _attributes(track, f"{origin}: <track>")
        seen: dict[int, bool] = {}  # by frame, whether it is outside there
        for shape in track:
            if shape.tag not in SHAPES:
                lost[f"element {shortened(shape.tag)} of a track"] += shape.tag != "attribute"
                continue
            frame = number(shape.get("frame"), f"{origin}: frame")
            if frame is None:
                raise ValueError(f"{origin}: frame: missing, expected the number of a frame")
            if (outside := shape.get("outside", "0")) not in ("0", "1"):
                raise ValueError(f"{origin}: outside: expected 0 or 1, got {shortened(outside)}")
            if frame in seen:
                raise ValueError(f"{origin}: frame {frame}: expected one shape of a track in each frame, got several")
            seen[frame] = outside == "1"
            if seen[frame]:
                continue
            if frame not in marks:
                steps = f" in steps of {frames.step}" if frames.step > 1 else ""
                raise ValueError(f"{origin}: frame: expected {frames[0]} to {frames[-1]}{steps}, got {frame}")
            where = f"{origin}: frame {frame}"
            found = [*_marks(shape, track.get("label"), common, where, lost, track.get("id"))]
            if len(found) > 1:
                raise ValueError(f"{where}: expected one point of a track in each frame, got {len(found)}")
            marks[frame] += found
        for frame, after in itertools.pairwise([*sorted(seen), frames.stop]):
            if not seen[frame]:
                unknown.update(range(frame + frames.step, min(after, frames.stop), frames.step))
    for frame in unknown:
        del marks[frame]
    lost["frame in which a track goes on, but has no shape"] += len(unknown)
    images = (ImageLabels(str(frame), size_px, tuple(found)) for frame, found in marks.items())
    return label_set(images, lost, path, is_video=True)


def _frames(root: Element, path: Path) -> range:
    """The frames of a video's task, perhaps every so manieth; up to the last that has a shape if it is not said."""
    task = root.find("meta/task")
    task = root.find("meta/job") if task is None else task
    texts = {name: None if task is None else task.findtext(name) for name in ("size", "start_frame", "stop_frame")}
    first = number(texts["start_frame"], f"{path}: start_frame") or 0
    stop = number(texts["stop_frame"], f"{path}: stop_frame")
    size = number(texts["size"], f"{path}: size")
    step = _step(None if task is None else task.findtext("frame_filter"), path)
    if stop is None and size is not None:
        stop = first + (size - 1) * step
    if stop is None:
        numbers = [number(shape.get("frame"), f"{path}: frame") or 0 for shape in root.iterfind("track/*")]
        if not numbers:
            raise ValueError(f"{path}: expected images, tracks with shapes, or the size of a task in meta, found none")
        stop = max(numbers)
    count = (stop - first) // step + 1
    if first < 0 or not 1 <= count <= MAX_IMAGES:
        raise ValueError(f"{path}: meta: expected 1 to {MAX_IMAGES} frames, got {count} from {first}")
    return range(first, stop + 1, step)


def _step(text: str | None, path: Path) -> int:
    """Of every so manieth frame a task was made; nobody has labelled those between."""
    found = re.fullmatch("step=([1-9][0-9]{0,5})", (text or "step=1").replace(" ", ""))
    if found is None:
        raise ValueError(f"{path}: meta: frame_filter: expected step=N, got {shortened(text)}")
    return int(found[1])


def cvat_text(labels: LabelSet) -> tuple[str, Counter[str]]:
    """The labels as CVAT's XML for images, and what it cannot take."""
    root = _root(len(labels.images), "annotation", None)
    for index, image in enumerate(labels.images):
        width_px, height_px = image.size_px or (1, 1)
        about = {"id": str(index), "name": image.name, "width": str(width_px), "height": str(height_px)}
        element = SubElement(root, "image", about)
        for category in image.categories:
            SubElement(element, "tag", {"label": category.name.lower(), "source": "manual"})
        for mark in image.marks:
            _add_point(element, mark, {"label": str(mark.kind), "source": "manual"})
    return _text(root, "cvat"), Counter()


def cvat_video_text(labels: LabelSet) -> tuple[str, Counter[str]]:
    """The labels as CVAT's XML for a video: a track for each vehicle and light, a key frame wherever it is seen.

    Raises:
        ValueError: If the images are of several sequences, which are no one video.
    """
    folders = {image.name.rpartition("/")[0] for image in labels.images}
    if len(folders) > 1:
        raise ValueError(f"cvat-video: expected the images of one sequence, got {len(folders)} sequences")
    root = _root(len(labels.images), "interpolation", labels.images[0].size_px)
    tracks: dict[tuple[Kind, int | None, int | None, int], dict[int, Mark]] = {}
    for frame, image in enumerate(labels.images):
        seen: Counter[tuple[Kind, int | None, int | None]] = Counter()
        for mark in image.marks:
            key = mark.kind, mark.oid, mark.iid
            tracks.setdefault((*key, seen[key]), {})[frame] = mark
            seen[key] += 1
    for index, ((kind, *_), marks) in enumerate(tracks.items()):
        track = SubElement(root, "track", {"id": str(index), "label": str(kind), "source": "manual"})
        for frame, mark in marks.items():
            _add_point(track, mark, {"frame": str(frame), "keyframe": "1", "outside": "0"})
            if frame + 1 not in marks and frame + 1 < len(labels.images):
                _add_point(track, mark, {"frame": str(frame + 1), "keyframe": "1", "outside": "1"})
    lost = Counter({"category of an image": sum(len(image.categories) for image in labels.images)})
    return _text(root, "cvat-video"), +lost


def _root(num_images: int, mode: str, size_px: tuple[int, int] | None) -> Element:
    """The document with its description of the task, by which CVAT's own readers know the labels."""
    root = Element("annotations")
    SubElement(root, "version").text = "1.1"
    task = SubElement(SubElement(root, "meta"), "task")
    about = {"name": "foreglow", "size": num_images, "mode": mode, "start_frame": 0, "stop_frame": num_images - 1}
    for name, value in about.items():
        SubElement(task, name).text = str(value)
    if size_px is not None:
        size = SubElement(task, "original_size")
        SubElement(size, "width").text, SubElement(size, "height").text = map(str, size_px)
    labels = SubElement(task, "labels")
    for kind in Kind:
        _add_label(labels, str(kind), ("oid", "direct") if kind == Kind.VEHICLE else ("oid", "iid", "direct", "rear"))
    for name in CATEGORIES:
        _add_label(labels, name, ())
    return root


def _add_label(labels: Element, name: str, attributes: tuple[str, ...]) -> None:
    label = SubElement(labels, "label")
    SubElement(label, "name").text = name
    listed = SubElement(label, "attributes")
    for attribute in attributes:
        element = SubElement(listed, "attribute")
        is_number = attribute in ("oid", "iid")
        SubElement(element, "name").text = attribute
        SubElement(element, "mutable").text = "True"
        SubElement(element, "input_type").text = "text" if is_number else "checkbox"
        SubElement(element, "default_value").text = "" if is_number else "false"
        SubElement(element, "values").text = "" if is_number else "false"


def _add_point(parent: Element, mark: Mark, about: dict[str, str]) -> None:
    x, y = mark.position_px
    points = {"points": f"{x + 0.5:.2f},{y + 0.5:.2f}", "occluded": "0", "z_order": "0"}
    element = SubElement(parent, "points", about | points)
    for name, value in attributes_of(mark).items():
        SubElement(element, "attribute", {"name": name}).text = str(value).lower()


def _text(root: Element, name: str) -> str:
    ElementTree.indent(root)
    head = f'<?xml version="1.0" encoding="utf-8"?>\n<!-- {labels_mark(name)} -->\n'
    return head + ElementTree.tostring(root, encoding="unicode") + "\n"
