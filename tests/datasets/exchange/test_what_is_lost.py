"""What an annotation tool says of a point and is not taken is counted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foreglow.datasets.exchange import read_labels_file
from foreglow.datasets.exchange.marks import Kind
from tests.cli.commands import complaint


@pytest.mark.parametrize(
    ("value", "is_true"),
    [(True, True), (1, True), (1.0, True), ("1", True), ("TRUE", True), (0, False), ("0", False), ("False", False)],
)
def test_spellings_of_a_truth_value(value: object, is_true: bool, tmp_path: Path) -> None:
    """1 and 0, as some tools write checkboxes, were refused."""
    point = {"image_id": 1, "category_id": 1, "keypoints": [1, 2, 2], "attributes": {"direct": value, "rear": value}}
    file = {"images": [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}], "annotations": [point]}
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(file | {"categories": [{"id": 1, "name": "light"}]}))
    ((mark,),) = (image.marks for image in read_labels_file(path).images)
    assert (mark.is_direct, mark.is_rear) == (is_true, is_true)


def test_what_only_points_of_other_kinds_have_is_counted(tmp_path: Path) -> None:
    """`rear` is of a light, and doubtful light is of no vehicle; `false` says nothing, nor does a track's number."""
    said = {"oid": 1, "iid": 7, "direct": True, "rear": True}
    usual = {"oid": 1, "direct": True, "rear": False}
    expected = {"'iid' of a vehicle": 1, "'rear' of a vehicle": 1, "'oid' of doubtful light": 1}
    points = [("vehicle", said), ("vehicle", usual | {"oid": 2}), ("light", said), ("doubtful", said)]
    shapes, annotations, regions = "", list[object](), list[object]()
    size = {"original_width": 96, "original_height": 72}
    for index, (label, given) in enumerate(points):
        inside = "".join(f"<attribute name='{key}'>{str(value).lower()}</attribute>" for key, value in given.items())
        shapes += f"<points label='{label}' points='1,2'>{inside}</points>"
        category = list(Kind).index(Kind(label)) + 1
        annotations.append({"image_id": 1, "category_id": category, "keypoints": [1, 2, 2], "attributes": given})
        part = {"id": f"r{index}", "type": "keypointlabels", "value": {"x": 1, "y": 2, "keypointlabels": [label]}}
        regions.append(size | part)
        for name in ("oid", "iid"):
            if name in given:
                value = {"number": given[name]}
                regions.append({"id": f"r{index}", "type": "number", "from_name": name, "value": value})
        choices = [name for name in ("direct", "rear") if given[name]]
        regions.append({"id": f"r{index}", "type": "choices", "from_name": "is", "value": {"choices": choices}})
    images = [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}]
    categories = [{"id": index, "name": str(kind)} for index, kind in enumerate(Kind, start=1)]
    file = {"images": images, "categories": categories, "annotations": annotations}
    (tmp_path / "coco.json").write_text(json.dumps(file))
    task = {"data": {"image": "a.png"}, "annotations": [{"result": regions}]}
    (tmp_path / "tasks.json").write_text(json.dumps([task]))
    image = f"<image id='0' name='a.png' width='96' height='72'>{shapes}</image>"
    (tmp_path / "labels.xml").write_text(f"<annotations>{image}</annotations>")
    for name in ("coco.json", "tasks.json", "labels.xml"):
        assert read_labels_file(tmp_path / name).lost == expected, name
    shape = "<points frame='0' points='1,2'><attribute name='rear'>false</attribute></points>"
    track = f"<track id='7' label='vehicle'>{shape}</track>"
    (tmp_path / "labels.xml").write_text(f"<annotations>{track}</annotations>")
    assert not read_labels_file(tmp_path / "labels.xml").lost


def files_of(labels: list[str], folder: Path) -> dict[str, Path]:
    """A file of each format with an image, in which there is a point of each label."""
    folder.mkdir(exist_ok=True)
    shapes = "".join(f"<points label='{label}' points='1,2'/>" for label in labels)
    tracks = "".join(f"<track label='{label}'><points frame='0' points='1,2'/></track>" for label in labels)
    numbers = range(len(labels))
    coco = {
        "images": [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}],
        "categories": [{"id": number, "name": labels[number]} for number in numbers],
        "annotations": [{"image_id": 1, "category_id": number, "keypoints": [1, 2, 2]} for number in numbers],
    }
    size = {"original_width": 96, "original_height": 72}
    regions = [
        {"id": f"r{number}", "type": "keypointlabels", "value": {"x": 1, "y": 2, "keypointlabels": [labels[number]]}}
        for number in numbers
    ]
    tasks = [{"data": {"image": "a.png"}, "annotations": [{"result": [size | region for region in regions]}]}]
    texts = {
        "images.xml": f"<annotations><image name='a.png' width='96' height='72'>{shapes}</image></annotations>",
        "video.xml": f"<annotations><meta><task><size>1</size></task></meta>{tracks}</annotations>",
        "coco.json": json.dumps(coco),
        "tasks.json": json.dumps(tasks),
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    return {name: folder / name for name in texts}


@pytest.mark.parametrize("name", ["images.xml", "video.xml", "coco.json", "tasks.json"])
def test_a_file_of_which_nothing_drawn_is_taken_is_refused(name: str, tmp_path: Path) -> None:
    """Its images would count as images without light, and teach that."""
    path = files_of(["LIGHT", "LIGHT", "VEHICLE", "car", "sign"], tmp_path)[name]
    expected = "expected points or boxes called vehicle, light, doubtful, in small letters, got 2 x "
    with pytest.raises(ValueError, match=rf"{name}: {expected}(annotation|shape|point) .*'LIGHT', .*, \.\.\. alone$"):
        read_labels_file(path)
    assert f"{path}: {expected}" in complaint("labels", "import", path, "--out", tmp_path / "own")
    some = read_labels_file(files_of(["LIGHT", "light"], tmp_path)[name])
    assert [sum(some.lost.values()), len(some.images[0].marks)] == [1, 1]
    assert not read_labels_file(files_of([], tmp_path)[name]).images[0].marks


def test_tags_of_other_names_are_no_shapes(tmp_path: Path) -> None:
    path = tmp_path / "labels.xml"
    path.write_text("<annotations><image name='a.png'><tag label='seen'/></image></annotations>")
    assert read_labels_file(path).lost == {"tag 'seen'": 1}
    polygon = "<polygon label='light' points='1,2;3,4;5,1'/>"
    path.write_text(f"<annotations><image name='a.png'>{polygon}</image></annotations>")
    with pytest.raises(ValueError, match="got 1 x shape 'polygon' alone"):
        read_labels_file(path)
