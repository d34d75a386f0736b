"""Files that lie, climb or never end are one line each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets.exchange import read_labels_file

ENTITIES = """<?xml version="1.0"?><!DOCTYPE annotations [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]><annotations><image id="0" name="&c;"/></annotations>"""
EXTERNAL = """<!DOCTYPE annotations [<!ENTITY a SYSTEM "file:///etc/passwd">]>
<annotations><image id="0" name="&a;"/></annotations>"""


def image(name: str = "a.png", inside: str = "", size: str = 'width="96" height="72"') -> str:
    return f'<annotations><image id="0" name="{name}" {size}>{inside}</image></annotations>'


def video(meta: str = "<size>3</size>", frame: str = "1", inside: str = "") -> str:
    return (
        f"<annotations><meta><task>{meta}</task></meta><track id='1' label='light'>{inside}"
        f"<points frame='{frame}' points='1,2'/></track></annotations>"
    )


def light(name: str, value: str) -> str:
    """A light with an attribute."""
    return image(inside=f'<points label="light" points="1,2"><attribute name="{name}">{value}</attribute></points>')


def coco(**changes: Any) -> str:
    annotation = {"id": 1, "image_id": 1, "category_id": 1, "keypoints": [1.5, 2.5, 2]}
    file = {
        "images": [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}],
        "categories": [{"id": 1, "name": "light"}],
        "annotations": [annotation | changes.pop("annotation", {})],
    }
    file["images"][0] |= changes.pop("image", {})
    return json.dumps(file | changes)


def sized(width_px: int, x: int = 1, **region: Any) -> dict[str, Any]:
    value = {"x": x, "y": 2, "keypointlabels": ["light"]}
    return {"type": "keypointlabels", "original_width": width_px, "original_height": 72, "value": value, **region}


def said_twice(*numbers: int) -> str:
    """A point that Label Studio gives several numbers of a vehicle."""
    said = [{"id": "r", "type": "number", "from_name": "oid", "value": {"number": number}} for number in numbers]
    return annotated(sized(96, id="r"), *said)


def annotated(*regions: dict[str, Any]) -> str:
    """An image of Label Studio with these regions."""
    return json.dumps([{"data": {"image": "a.png"}, "annotations": [{"result": regions}]}])


def task(value: Any = None, address: Any = "a.png", **region: Any) -> str:
    point = {"id": "r", "type": "keypointlabels", "original_width": 96, "original_height": 72}
    point["value"] = {"x": 1, "y": 2, "keypointlabels": ["light"]} | (value or {})
    return json.dumps([{"data": {"image": address}, "annotations": [{"result": [point | region]}]}])


FILES = {
    "entities of entities": (".xml", ENTITIES, "without a document type"),
    "another file": (".xml", EXTERNAL, "without a document type"),
    "a path that climbs": (".xml", image("../../etc/passwd"), "name: expected a path below the folder"),
    "a path that climbs later": (".xml", image("a/../../b.png"), "name: expected a path below the folder"),
    "an absolute path": (".json", coco(image={"file_name": "/etc/passwd"}), "file_name: expected a path below"),
    "a path of Windows": (".json", coco(image={"file_name": "C:\\a.png"}), "file_name: expected a path below"),
    "a path with a line": (".json", coco(image={"file_name": "a\nb.png"}), "file_name: expected a path below"),
    "an address that climbs": (".json", task(address="/data/local-files/?d=../../x.png"), "image: expected a path"),
    "no address": (".json", task(address=7), "data.image: expected the address of an image, got 7"),
    "no size": (".json", task(original_width=None), "expected original_width and original_height"),
    "a rotated image": (".json", task(image_rotation=90), "image_rotation: expected 0, an image as it is stored"),
    "a rotated box": (
        ".json",
        task({"rectanglelabels": ["light"], "width": 1, "height": 2, "rotation": 30}, type="rectanglelabels"),
        "rotation: expected 0, an upright box, got 30",
    ),
    "two sizes of an image": (
        ".json",
        annotated(sized(96), sized(1)),
        "original_width, original_height: expected (96, 72) as before, got (1, 72)",
    ),
    "a point that is none": (".xml", image(inside='<points label="light" points="1,nan"/>'), "expected a point within"),
    "a point without end": (".xml", image(inside='<points label="light" points="1e99,1"/>'), "expected a point within"),
    "points of a text": (".xml", image(inside='<points label="light" points="left"/>'), "points: expected x,y;x,y"),
    "a negative size": (".xml", image(size='width="-96" height="72"'), "width, height: expected 1 to"),
    "a number of a million digits": (".xml", light("oid", "9" * 10**6), "oid: expected a whole number"),
    "no truth value": (".xml", light("rear", "maybe"), "rear: expected true or false, got 'maybe'"),
    "no truth value, but a number": (".xml", light("rear", "2"), "rear: expected true or false, got '2'"),
    "no truth value, but an empty text": (".xml", light("direct", ""), "direct: expected true or false, got ''"),
    "an empty text for a truth value": (
        ".json",
        coco(annotation={"attributes": {"rear": ""}}),
        "annotations.0.attributes.rear: expected true or false, got ''",
    ),
    "nothing for a truth value": (
        ".json",
        coco(annotation={"attributes": {"direct": None}}),
        "annotations.0.attributes.direct: expected true or false, got None",
    ),
    "neither images nor tracks": (
        ".xml",
        "<annotations><version>1.1</version></annotations>",
        "expected images, tracks with shapes, or the size of a task in meta, found none",
    ),
    "a track without shapes": (
        ".xml",
        "<annotations><meta/><track id='1' label='light'/></annotations>",
        "expected images, tracks with shapes, or the size of a task in meta, found none",
    ),
    "an attribute twice": (
        ".xml",
        light("oid", "3").replace("</points>", '<attribute name="oid">4</attribute></points>'),
        "image 0: <points> 'oid': expected one value, got '3' and '4'",
    ),
    "an attribute of a track twice": (
        ".xml",
        video(inside="<attribute name='rear'>true</attribute><attribute name='rear'>false</attribute>"),
        "track 0: <track> 'rear': expected one value, got 'true' and 'false'",
    ),
    "an attribute of a track and another of its shape": (
        ".xml",
        video().replace("<points", "<attribute name='oid'>1</attribute><points").replace(
            "points='1,2'/>", "points='1,2'><attribute name='oid'>2</attribute></points>"
        ),
        "track 0: frame 1: <points> 'oid': expected one value, got '1' and '2'",
    ),
    "an attribute of COCO twice": (
        ".json",
        coco(annotation={"attributes": {"oid": 1}}).replace('{"oid": 1}', '{"oid": 1, "oid": 2}'),
        "oid",
    ),
    "an attribute of Label Studio twice": (".json", said_twice(1, 2), "0: region 'r': oid: expected one value, got "),
    "a region twice": (
        ".json",
        annotated(sized(96, id="r"), sized(96, 7, id="r")),
        "0: region 'r': expected one point or box, got several",
    ),
    "a video of a billion frames": (".xml", video("<size>1000000000</size>"), "expected 1 to 200000 frames"),
    "a video that ends before it begins": (".xml", video("<start_frame>9</start_frame><size>0</size>"), "frames"),
    "a frame behind the end": (".xml", video(frame="7"), "track 0: frame: expected 0 to 2, got 7"),
    "a shape of no frame": (".xml", video(frame=""), "track 0: frame: missing, expected the number of a frame"),
    "an image twice": (".xml", image().replace("</image>", '</image><image id="1" name="a.png"/>'), "is there twice"),
    "an id twice": (
        ".json",
        coco(images=[{"id": 1, "file_name": f"{name}.png", "width": 96, "height": 72} for name in "ab"]),
        "images: expected another id for each, got 1 twice",
    ),
    "a category twice": (
        ".json",
        coco(categories=[{"id": 1, "name": "light"}, {"id": 1, "name": "vehicle"}]),
        "categories: expected another id for each, got 1 twice",
    ),
    "half of a key point": (
        ".json",
        coco(annotation={"keypoints": [1.5, 2.5]}),
        "annotations.0.keypoints: expected x, y, visibility of each, got 2 numbers",
    ),
    "a box from right to left": (
        ".xml",
        image(inside='<box label="light" xtl="60" ytl="50" xbr="50" ybr="52"/>'),
        "<box>: expected xtl up to xbr and ytl up to ybr, got 60, 50, 50, 52",
    ),
    "two points of a light": (
        ".xml",
        light("iid", "3").replace("1,2", "1,2;5,6"),
        "<points> points: expected one point of light 3, got 2",
    ),
    "two points of a track": (
        ".xml",
        video().replace("1,2", "1,2;5,6"),
        "track 0: frame 1: <points> points: expected one point of light 1, got 2",
    ),
    "two points of a vehicle's track": (
        ".xml",
        video().replace("1,2", "1,2;5,6").replace("label='light'", "label='vehicle'"),
        "track 0: frame 1: expected one point of a track in each frame, got 2",
    ),
    "two shapes of a track in a frame": (
        ".xml",
        video(inside="<points frame='1' points='7,8'/>"),
        "track 0: frame 1: expected one shape of a track in each frame, got several",
    ),
    "outside of a text": (
        ".xml",
        video().replace("points='1,2'", "points='1,2' outside='yes'"),
        "track 0: outside: expected 0 or 1, got 'yes'",
    ),
    "an annotation twice": (
        ".json",
        coco(annotations=2 * [{"id": 1, "image_id": 1, "category_id": 1, "keypoints": [1.5, 2.5, 2]}]),
        "annotations.1.id: expected another id for each annotation, got 1 twice",
    ),
    "a box of less than nothing": (
        ".json",
        coco(annotation={"keypoints": [], "bbox": [10, 10, -4, 3]}),
        "annotations.0.bbox: expected a width and height of at least 0, got -4 and 3",
    ),
    "no image": (".json", coco(annotation={"image_id": 9}), "annotations.0.image_id: expected an id of images"),
    "no category": (".json", coco(annotation={"category_id": 9}), "category_id: expected an id of categories"),
    "infinity": (".json", coco().replace("1.5", "Infinity"), "keypoints.0: "),
    "a wrong type": (".json", coco(annotations=7), "annotations: "),
    "attributes of a wrong type": (".json", coco(annotation={"attributes": {"oid": [1]}}), "oid: expected a whole"),
    "per cent of a text": (".json", task({"x": "left"}), "x: expected a number, got 'left'"),
    "names of a wrong type": (".json", task({"keypointlabels": "light"}), "expected a list of texts"),
    "brackets without end": (".json", "[" * 1_000_000, ""),
    "objects without end": (".json", '{"images":' * 100_000, ""),
    "something else": (".json", "7", "expected labels of CVAT (.xml), COCO or Label Studio (.json)"),
    "XML of something else": (".xml", "<map/>", "expected labels of CVAT"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_hostile_file_is_one_line(name: str, tmp_path: Path) -> None:
    suffix, content, said = FILES[name]
    path = tmp_path / f"labels{suffix}"
    path.write_text(content)
    with pytest.raises(ValueError, match="labels") as caught:
        read_labels_file(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert said in message
    assert "\n" not in message
    assert len(message) < 600


def test_the_plain_files_behind_these_can_be_read(tmp_path: Path) -> None:
    for suffix, content in ((".xml", image()), (".xml", video()), (".json", coco()), (".json", task())):
        path = tmp_path / f"labels{suffix}"
        path.write_text(content)
        assert read_labels_file(path).images


@pytest.mark.parametrize("name", ["a.xml", "a.json"])
@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_labels_in_utf_16_are_told(tmp_path: Path, name: str, encoding: str) -> None:
    path = tmp_path / name
    path.write_bytes(("\ufeff" + (image() if name == "a.xml" else coco())).encode(encoding))
    with pytest.raises(ValueError, match=rf"{name}: expected UTF-8 text, is UTF-16: save it as UTF-8$"):
        read_labels_file(path)
