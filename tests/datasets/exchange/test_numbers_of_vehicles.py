"""Which points of different images are of one vehicle, and of one light."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import open_labelled
from foreglow.datasets.exchange import LabelFile, Mark, write_labels_file
from foreglow.datasets.exchange.marks import ImageLabels, Kind, LabelSet, numbered
from tests.datasets.video.test_video_file import make_video


@pytest.mark.parametrize("kind", ["cvat", "coco", "label-studio"])
def test_lights_without_numbers_are_other_vehicles_in_every_image(tmp_path: Path, kind: str) -> None:
    clip = make_video(tmp_path / "clip.mp4")
    marks = {2: (Mark(Kind.LIGHT, (5, 8), oid=3, iid=7), Mark(Kind.LIGHT, (20, 8))), 4: (Mark(Kind.LIGHT, (30, 8)),)}
    marks[6] = (Mark(Kind.LIGHT, (40, 8)), Mark(Kind.LIGHT, (9, 9), oid=3, iid=7))
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (96, 72), found) for number, found in marks.items())
    path = tmp_path / ("a.xml" if kind == "cvat" else "a.json")
    write_labels_file(path, LabelSet(images, is_video=True), kind)
    source = LabelFile(path, clip)
    vehicles = [vehicle for image_id in source.frame_ids for vehicle in source.annotations(image_id)]
    assert sorted(vehicle.oid for vehicle in vehicles) == [3, 3, 4, 5, 6]
    assert sorted(light.iid for vehicle in vehicles for light in vehicle.instances) == [7, 7, 8, 9, 10]


def test_what_a_tool_follows_is_one_vehicle_and_one_light(tmp_path: Path) -> None:
    """In CVAT a track is one thing; its attributes may be empty, or set in a later frame only."""
    clip = make_video(tmp_path / "clip.mp4")
    shape = '<points frame="{}" outside="{}" points="5,5">{}</points>'
    number = '<attribute name="{}">{}</attribute>'
    tracks = {
        "light": [(1, 0, ""), (2, 0, ""), (3, 1, "")],
        "vehicle": [(2, 0, ""), (3, 0, ""), (4, 1, "")],
        "light ": [(1, 0, ""), (2, 0, number.format("oid", 2)), (3, 0, number.format("oid", 2)), (4, 1, "")],
        "light  ": [(2, 0, number.format("iid", 0)), (3, 0, ""), (4, 1, "")],
    }
    shapes = "".join(
        f'<track id="{k}" label="{label.strip()}">{"".join(shape.format(*each) for each in its)}</track>'
        for k, (label, its) in enumerate(tracks.items())
    )
    path = tmp_path / "a.xml"
    path.write_text(f"<annotations><meta><task><size>5</size></task></meta>{shapes}</annotations>")
    source = LabelFile(path, clip)
    found = {
        image_id: {(each.oid, light.iid) for each in source.annotations(image_id) for light in each.instances}
        for image_id in source.frame_ids
    }
    (first,) = found[1] - {(2, 2)}
    (last,) = found[3] - {(2, 2)}
    assert last[1] == 0
    assert found == {0: set(), 1: {first, (2, 2)}, 2: {first, (2, 2), last}, 3: {(2, 2), last}, 4: set()}
    assert len({first[0], 2, last[0]}) == len({first[1], 2, 0}) == 3
    (alone,) = ({each.oid for each in source.annotations(k) if not each.instances} for k in (2,))
    assert alone == {each.oid for each in source.annotations(3) if not each.instances}
    assert alone.isdisjoint({first[0], 2, last[0]})


def test_tracks_in_coco_are_one_light(tmp_path: Path) -> None:
    """CVAT's tracks keep their numbers in COCO; the same number in another folder is another vehicle's."""
    names = ["a/1.png", "a/2.png", "b/3.png"]
    images = [{"id": k, "file_name": name, "width": 96, "height": 72} for k, name in enumerate(names)]
    boxes = [(0, 4, 10), (1, 4, 12), (2, 4, 14), (1, 5, 40), (1, 5, 50)]
    annotations = [
        {"image_id": image, "category_id": 1, "bbox": [x, 10, 5, 5], "attributes": {"track_id": track}}
        for image, track, x in boxes
    ]
    file = {"images": images, "categories": [{"id": 1, "name": "light"}], "annotations": annotations}
    (tmp_path / "a.json").write_text(json.dumps(file))
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(tmp_path / name), np.zeros((72, 96), np.uint8))
    source = open_labelled(tmp_path / "a.json")
    numbers = [
        [(each.oid, light.iid) for each in source.annotations(k) for light in each.instances] for k in source.frame_ids
    ]
    assert numbers[0][0] == numbers[1][0]
    assert numbers[0][0][0] != numbers[2][0][0]
    assert len({oid for oid, _ in numbers[1]}) == 3, "one track has one point in an image, so that these are two lights"


@pytest.mark.parametrize("kind", ["cvat", "coco", "label-studio"])
def test_a_light_that_is_numbered_is_of_one_vehicle(tmp_path: Path, kind: str) -> None:
    clip = make_video(tmp_path / "clip.mp4")
    marks = {
        2: (Mark(Kind.LIGHT, (5, 8), iid=7), Mark(Kind.LIGHT, (20, 8), iid=8)),
        4: (Mark(Kind.LIGHT, (6, 8), iid=7), Mark(Kind.LIGHT, (21, 8), oid=3, iid=8)),
    }
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (96, 72), found) for number, found in marks.items())
    path = tmp_path / ("a.xml" if kind == "cvat" else "a.json")
    write_labels_file(path, LabelSet(images, is_video=True), kind)
    source = LabelFile(path, clip)
    vehicles = [{each.oid: each.instances[0].iid for each in source.annotations(image_id)} for image_id in (2, 4)]
    assert vehicles[0] == vehicles[1] == {4: 7, 3: 8}


def test_new_numbers_are_such_as_every_tool_keeps() -> None:
    marks = (Mark(Kind.LIGHT, (5, 8), oid=2**53, iid=0), Mark(Kind.LIGHT, (9, 8), oid=0), Mark(Kind.LIGHT, (20, 8)))
    (image,) = numbered([ImageLabels("a.png", (96, 72), marks)])
    assert [(mark.oid, mark.iid) for mark in image.marks] == [(2**53, 0), (0, 1), (1, 2)]
