"""Labels that go to an annotation tool and come back are the same, and what is lost is counted."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import open_labelled, open_source
from foreglow.datasets.exchange import (
    LABEL_FORMATS,
    LabelFile,
    Mark,
    labels_of,
    read_labels_file,
    write_labels_file,
    write_split,
)
from foreglow.datasets.exchange.marks import CATEGORIES, ImageLabels, Kind, LabelSet, vehicles_of
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn.schema import ImageCategory

CATEGORIES_ARE_KEPT = {"cvat", "label-studio"}


def exported(split: Path, path: Path, name: str) -> dict[str, int]:
    return dict(write_labels_file(path, labels_of(open_labelled(split)), name))


def facts(dataset: LabelledSource, image_id: int) -> object:
    vehicles = [vehicle.model_copy(update={"instances": ()}) for vehicle in dataset.annotations(image_id)]
    lights = [(each.oid, light) for each in dataset.annotations(image_id) for light in each.instances]
    return (
        sorted((each.oid, each.position_px, each.is_direct) for each in vehicles),
        sorted((oid, each.iid, each.position_px, each.is_direct, each.is_rear) for oid, each in lights),
        [(each.iid, each.position_px) for each in dataset.doubtful(image_id)],
    )


@pytest.mark.parametrize("name", LABEL_FORMATS)
def test_a_round_trip_loses_nothing_that_both_know(name: str, split: Path, tmp_path: Path) -> None:
    path = tmp_path / f"labels{LABEL_FORMATS[name].suffix}"
    whole, sequence = open_labelled(split), split / "images/S00001"
    images = sequence if name == "cvat-video" else split / "images"
    lost = exported(sequence if name == "cvat-video" else split, path, name)
    write_split(LabelFile(path, images), tmp_path / "back")
    back = open_labelled(tmp_path / "back")
    assert set(back.frame_ids) == ({5, 7} if name == "cvat-video" else set(whole.frame_ids))
    for image_id in back.frame_ids:
        assert facts(back, image_id) == facts(whole, image_id)
        np.testing.assert_array_equal(back.read(image_id).image, whole.read(image_id).image)
        if name in CATEGORIES_ARE_KEPT:
            assert back.categories(image_id) == whole.categories(image_id)
    if name != "cvat-video":
        assert [(each.id, each.directory) for each in back.sequences] == [(1, "S00001"), (3, "S00003")]
        assert lost.pop("field confidence") == lost.pop("field note") == lost.pop("file of generated boxes") == 1
        assert lost.pop("category of an image", 0) == (0 if name in CATEGORIES_ARE_KEPT else 3)
    assert lost.pop("sequence with attributes (weather, road, driver, times, ...)") == len(back.sequences)
    assert not lost


def test_a_drive_of_several_sequences_is_no_video(split: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="the images of one sequence, got 2 sequences"):
        exported(split, tmp_path / "labels.xml", "cvat-video")


@pytest.mark.parametrize("form", ["cvat", "coco", "label-studio"])
@pytest.mark.parametrize("name", ["a+b & c#d.png", "100%25?d=x;y.png", "S1/10.00\u202fPM.png", '<Nacht> "1".png'])
def test_names_of_all_kinds_come_back(form: str, name: str, tmp_path: Path) -> None:
    path, images = tmp_path / f"labels{LABEL_FORMATS[form].suffix}", (ImageLabels(name, (96, 72)),)
    write_labels_file(path, LabelSet(images), form)
    assert [image.name for image in read_labels_file(path).images] == [name]


@pytest.mark.parametrize("form", ["cvat", "coco", "label-studio"])
@pytest.mark.parametrize(
    "name",
    ["a\tb.png", "a\nb.png", "a\x01.png", "a\x1bb.png", "a\\b.png", "C:a.png", "a" * 201, os.fsdecode(b"a\xff.png")],
)
def test_names_that_could_not_be_read_again_are_not_written(form: str, name: str, tmp_path: Path) -> None:
    path, images = tmp_path / f"labels{LABEL_FORMATS[form].suffix}", (ImageLabels(name, (96, 72)),)
    for origin in ("", "drive/night"):
        expected = f"{origin or path}: name of an image: expected a path below the folder of the images, of "
        expected += "printable UTF-8 without backslashes, at most 500 characters and 200 in each part, got "
        with pytest.raises(ValueError, match=re.escape(expected)) as caught:
            write_labels_file(path, LabelSet(images, origin=origin), form)
        assert str(caught.value).isprintable()
    assert not path.exists()


@pytest.mark.parametrize("name", ["cvat", "coco", "label-studio"])
def test_a_file_beside_its_images_is_a_data_set(name: str, split: Path) -> None:
    path = split / f"labels{LABEL_FORMATS[name].suffix}"
    exported(split, path, name)
    found = open_labelled(path)
    assert found.frame_ids == open_labelled(split).frame_ids
    assert found.keypoints_px(11).tolist() == [[38, 31], [44, 31], [20, 50]]
    frames = list(open_source(path))
    assert [(frame.frame, frame.sequence) for frame in frames] == [
        (5, "S00001"), (7, "S00001"), (11, "S00003"), (12, "S00003"), (13, "S00003"),
    ]  # fmt: skip
    assert [frame.timestamp_ns for frame in frames] == [frame.timestamp_ns for frame in open_labelled(split)]
    record = found.image(11)
    assert (record.width_px, record.height_px) == (96, 72)


def test_labels_by_hand_need_neither_numbers_nor_all_points(tmp_path: Path) -> None:
    """As a person draws them in a new project: a light without attributes, boxes, shapes that mean nothing here."""
    (tmp_path / "drive").mkdir()
    assert cv2.imwrite(str(tmp_path / "drive/a.png"), np.zeros((72, 96), np.uint8))
    (tmp_path / "annotations.xml").write_text(
        """<annotations><image id="0" name="drive/a.png" width="96" height="72">
        <points label="light" points="10.9,20.1;30,40"/><box label="light" xtl="50" ytl="50" xbr="60" ybr="52"/>
        <polygon label="road" points="1,1;2,2;3,1"/><points label="tree" points="1,1"/><tag label="nice"/>
        <points label="light" points="70,60"><attribute name="oid">5</attribute>
        <attribute name="iid"></attribute><attribute name="direct">true</attribute></points>
        </image></annotations>"""
    )
    dataset = LabelFile(tmp_path / "annotations.xml")
    own, *others = sorted(dataset.annotations(0), key=lambda vehicle: vehicle.oid)
    assert own.oid == 5
    assert own.is_direct
    assert own.position_px == (70, 60), "a vehicle without a point lies amid its lights"
    assert [each.position_px for each in others] == [(10, 20), (30, 40), (55, 51)]
    assert len({light.iid for each in (own, *others) for light in each.instances}) == 4
    assert dataset.labels.lost == {"shape 'polygon'": 1, "shape labelled 'tree'": 1, "tag 'nice'": 1}


def test_a_video_s_labels_follow_its_tracks(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(4):
        assert cv2.imwrite(str(folder / f"f{number + 9}.png"), np.zeros((72, 96), np.uint8))
    (tmp_path / "v.xml").write_text(
        """<annotations><meta><task><size>4</size></task></meta><track id="6" label="light">
        <points frame="1" outside="0" points="10.5,20.5"/><points frame="2" outside="0" points="11.5,20.5"/>
        <points frame="3" outside="1" points="11.5,20.5"/></track></annotations>"""
    )
    dataset = LabelFile(tmp_path / "v.xml", folder)
    assert [dataset.image_path(number).name for number in dataset.frame_ids] == [
        "f9.png",
        "f10.png",
        "f11.png",
        "f12.png",
    ]
    lights = [[light for vehicle in dataset.annotations(k) for light in vehicle.instances] for k in dataset.frame_ids]
    assert [[(light.iid, *light.position_px) for light in each] for each in lights] == [
        [], [(6, 10, 20)], [(6, 11, 20)], [],
    ]  # fmt: skip


def test_frames_that_nobody_has_labelled_are_not_empty(tmp_path: Path) -> None:
    """Those that a task left out by its step, were deleted, or are for interpolation teach nothing."""
    meta = "<meta><task><size>5</size><start_frame>10</start_frame><stop_frame>30</stop_frame>{}</task></meta>"
    every = meta.format("<frame_filter>step=5</frame_filter>")
    shapes = {10: 0, 20: 0, 25: 1, 30: 0}
    points = "".join(f'<points frame="{at}" outside="{is_out}" points="5,5"/>' for at, is_out in shapes.items())
    path = tmp_path / "labels.xml"
    path.write_text(f'<annotations>{every}<track id="6" label="light">{points}</track></annotations>')
    found = read_labels_file(path)
    assert [(image.name, len(image.marks)) for image in found.images] == [("10", 1), ("20", 1), ("25", 0), ("30", 1)]
    assert dict(found.lost) == {"frame in which a track goes on, but has no shape": 1}
    path.write_text(path.read_text().replace('frame="20"', 'frame="21"'))
    with pytest.raises(ValueError, match="track 0: frame: expected 10 to 30 in steps of 5, got 21"):
        read_labels_file(path)
    path.write_text(path.read_text().replace("step=5", "step=0"))
    with pytest.raises(ValueError, match="frame_filter: expected step=N, got 'step=0'"):
        read_labels_file(path)


def test_frames_deleted_at_the_end_of_a_track_are_not_empty(tmp_path: Path) -> None:
    """A track that is nowhere outside goes on to the end of the task."""
    path = tmp_path / "labels.xml"
    shapes = "".join(f'<points frame="{at}" outside="0" points="5,5"/>' for at in (3, 4, 6, 7))
    track = f'<track id="6" label="light">{shapes}{{}}</track>'
    path.write_text(f"<annotations><meta><task><size>10</size></task></meta>{track.format('')}</annotations>")
    found = read_labels_file(path)
    assert [image.name for image in found.images] == ["0", "1", "2", "3", "4", "6", "7"]
    assert dict(found.lost) == {"frame in which a track goes on, but has no shape": 3}
    outside = '<points frame="8" outside="1" points="5,5"/>'
    path.write_text(f"<annotations><meta><task><size>10</size></task></meta>{track.format(outside)}</annotations>")
    assert [image.name for image in read_labels_file(path).images] == ["0", "1", "2", "3", "4", "6", "7", "8", "9"]


def test_points_beyond_the_first_of_an_annotation_are_counted(split: Path, tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    write_labels_file(path, labels_of(open_labelled(split)), "coco")
    file = json.loads(path.read_text())
    file["annotations"][0]["keypoints"] += [3, 4, 2, 0, 0, 0]
    path.write_text(json.dumps(file))
    assert read_labels_file(path).lost == {"further key point of an annotation": 1}


@pytest.mark.parametrize("name", ["cvat", "coco"])
def test_images_may_be_named_by_their_sequence(name: str, split: Path, tmp_path: Path) -> None:
    """What a first guess for a run on a sequence is about: its names begin with the sequence."""
    path = tmp_path / f"labels{LABEL_FORMATS[name].suffix}"
    exported(split / "images/S00001", path, name)
    alone, beside = (LabelFile(path, images) for images in (split / "images/S00001", split / "images"))
    assert alone.frame_ids == beside.frame_ids == (5, 7)
    for image_id in alone.frame_ids:
        np.testing.assert_array_equal(alone.read(image_id).image, beside.read(image_id).image)
    with pytest.raises(FileNotFoundError, match="S00003/S00001"):
        LabelFile(path, split / "images/S00003").read(5)


@pytest.mark.parametrize(
    ("box", "polygons", "point"),
    [
        ([], [[10, 20, 30, 20, 30, 26]], (20, 23)),
        ([0, 0, 0, 0], [[10, 20, 30, 20], [31.5, 30, 4, 2]], (17, 16)),
        ([40, 40, 4, 4], [[10, 20, 30, 20]], (42, 42)),
        ([40, 40, 0, 0], [], (40, 40)),
        ([], [[10, 20, 30]], None),
        ([], [["a", "b"], [1, 1e400]], None),
        ([], {"size": [4, 4], "counts": [16]}, None),
        ([], None, None),
    ],
)
def test_a_polygon_without_a_box_has_its_own(
    box: object, polygons: object, point: tuple[int, int] | None, tmp_path: Path
) -> None:
    common = {"image_id": 1, "category_id": 1}
    annotations = [common | {"bbox": box, "segmentation": polygons}, common | {"keypoints": [1, 2, 2]}]
    file = {
        "images": [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}],
        "categories": [{"id": 1, "name": "light"}],
        "annotations": annotations,
    }
    (tmp_path / "labels.json").write_text(json.dumps(file).replace("Infinity", "1e400"))
    found = read_labels_file(tmp_path / "labels.json")
    assert [mark.position_px for mark in found.images[0].marks] == [*([] if point is None else [point]), (1, 2)]
    assert bool(found.lost) == (point is None)


def test_attributes_of_other_names_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "labels.xml"
    path.write_text(
        """<annotations><image id="0" name="a.png" width="96" height="72">
        <points label="light" points="70,60"><attribute name="Rear">true</attribute>
        <attribute name="vehicle">5</attribute><attribute name="note"></attribute></points>
        <points label="light" points="30,60" z_order="0"><attribute name="vehicle">6</attribute></points>
        </image></annotations>"""
    )
    assert read_labels_file(path).lost == {"attribute 'vehicle'": 2, "attribute 'Rear'": 1}


def test_attributes_of_other_names_in_coco_are_counted(tmp_path: Path) -> None:
    """What COCO and CVAT always write beside a point is no attribute of it."""
    usual = {"occluded": False, "rotation": 0.0, "track_id": 3, "keyframe": True}
    common = {"image_id": 1, "category_id": 1, "keypoints": [1.5, 2.5, 2], "num_keypoints": 1, "bbox": [1, 2, 1, 1]}
    common |= {"area": 1, "iscrowd": 0, "segmentation": [], "score": 1.0}
    given = [usual | {"oid": 1}, usual | {"Rear": True, "vehicle_id": 3, "note": ""}, {}]
    annotations = [common | {"id": index, "attributes": each} for index, each in enumerate(given)]
    annotations[2] |= {"oid": 4, "keypoints": [0, 0, 0]}
    file = {
        "images": [{"id": 1, "file_name": "a.png", "width": 96, "height": 72, "license": 1}],
        "categories": [{"id": 1, "name": "light"}],
        "annotations": annotations,
    }
    (tmp_path / "labels.json").write_text(json.dumps(file))
    found = read_labels_file(tmp_path / "labels.json")
    assert [mark.position_px for mark in found.images[0].marks] == [(1, 2)] * 3
    assert found.lost == {
        "attribute 'Rear'": 1,
        "attribute 'vehicle_id'": 1,
        "field 'oid' of an annotation": 1,
        "key point without visibility, in whose place the middle of the box is taken": 1,
    }


def test_what_is_said_twice_alike_is_said_once(tmp_path: Path) -> None:
    size = {"original_width": 96, "original_height": 72}
    point = size | {"id": "a", "type": "keypointlabels", "value": {"x": 1, "y": 2, "keypointlabels": ["light"]}}
    oid = {"id": "a", "type": "number", "from_name": "oid", "value": {"number": 3}}
    task = {"data": {"image": "a.png"}, "annotations": [{"result": [point, oid, point, oid]}]}
    (tmp_path / "labels.json").write_text(json.dumps([task]))
    attribute = '<attribute name="oid">3</attribute>'
    (tmp_path / "labels.xml").write_text(
        f"""<annotations><image id="0" name="a.png" width="96" height="72">
        <points label="light" points="1,2">{attribute}{attribute}</points></image></annotations>"""
    )
    for name in ("labels.json", "labels.xml"):
        (image,) = read_labels_file(tmp_path / name).images
        assert [mark.oid for mark in image.marks] == [3]


def test_elements_that_mean_nothing_here_are_counted(tmp_path: Path) -> None:
    """A child of a shape, of a tag, of a track or of the file may hold what somebody took for a label."""
    image, point = '<image id="0" name="a.png"><points label="light" points="1,2">{}</points>{}</image>', "<points/>"
    path = tmp_path / "labels.xml"
    category = next(iter(CATEGORIES))
    tag = f'<tag label="{category}"><attribute name="a">1</attribute></tag>'
    more = f"<folder>{image}</folder><Image/><track id='1'/>"
    path.write_text(f"<annotations><version/><meta/>{image.format(point + '<Attribute/>', tag)}{more}</annotations>")
    assert read_labels_file(path).lost == {
        "element 'points' of a shape": 1,
        "element 'Attribute' of a shape": 1,
        "element 'attribute' of a tag": 1,
        "element 'folder'": 1,
        "element 'Image'": 1,
        "element 'track'": 1,
    }
    inside = "<attribute name='oid'>1</attribute><Points/><points frame='0' points='1,2'/>"
    track = f"<track id='1' label='light'>{inside}</track>"
    path.write_text(f"<annotations><version/><Meta/>{track}</annotations>")
    assert read_labels_file(path).lost == {"element 'Meta'": 1, "element 'Points' of a track": 1}


def test_choices_and_numbers_without_a_point_are_counted(tmp_path: Path) -> None:
    size = {"original_width": 96, "original_height": 72}
    result = [
        size | {"id": "a", "type": "keypointlabels", "value": {"x": 1, "y": 2, "keypointlabels": ["light"]}},
        {"id": "a", "type": "choices", "from_name": "is", "value": {"choices": ["Rear", "direct"]}},
        {"id": "gone", "type": "number", "from_name": "oid", "value": {"number": 3}},
        {"id": "a", "type": "choices", "from_name": "oid", "value": {"choices": ["3"]}},
        {"id": "a", "type": "number", "from_name": "iid", "value": {}},
        {"id": "road", "type": "polygonlabels", "from_name": "area", "value": {}},
        {"id": "road", "type": "number", "from_name": "oid", "value": {"number": 3}},
    ]
    path = tmp_path / "labels.json"
    path.write_text(json.dumps([{"data": {"image": "a.png"}, "annotations": [{"result": result}]}]))
    found = read_labels_file(path)
    assert found.lost == {
        "choice 'Rear'": 1,
        "'oid' of a point that is not there": 1,
        "'iid' without its number": 1,
        "region of the type 'choices'": 1,
        "region of the type 'polygonlabels'": 1,
    }
    assert found.images[0].marks[0].is_direct


def test_no_image_is_no_set(split: Path) -> None:
    with pytest.raises(ValueError, match="frames: expected at least one image"):
        labels_of(open_labelled(split), ())


def test_predictions_of_label_studio_are_no_labels(split: Path, tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    write_labels_file(path, labels_of(open_labelled(split)), "label-studio", is_guess=True)
    with pytest.raises(ValueError, match="expected tasks that somebody has annotated, got predictions or cancelled"):
        LabelFile(path, split / "images")
    tasks = json.loads(path.read_text())
    tasks[0] |= {"annotations": [{"result": []}], "data": {"image": "/data/upload/3/0a1b2c3d-000005.png"}}
    path.write_text(json.dumps(tasks))
    dataset = LabelFile(path, split / "images/S00001")
    assert dataset.frame_ids == (5,)
    assert dataset.annotations(5) == ()
    assert dataset.image(5).width_px == 96, "a task without a region does not say the size"
    assert dataset.labels.lost == {"image that nobody has annotated": 4}


@pytest.mark.parametrize(("marked", "taken"), [((), 3), ((0,), 1), ((1,), 2), ((0, 1), 2)])
def test_one_of_several_annotations_counts(marked: tuple[int, ...], taken: int, split: Path, tmp_path: Path) -> None:
    """The last, or the last that is marked as ground truth."""
    path = tmp_path / "labels.json"
    write_labels_file(path, labels_of(open_labelled(split)), "label-studio")
    tasks = json.loads(path.read_text())
    (task,) = (task for task in tasks if "000007" in task["data"]["image"])
    points = [part for part in task["annotations"][0]["result"] if part["type"] == "keypointlabels"]
    others = [part for part in task["annotations"][0]["result"] if part["type"] != "keypointlabels"]
    kept = {part["id"] for part in points}
    assert len(kept) >= 3
    task["annotations"] = [
        {
            "result": [part for part in points + others if part["id"] in sorted(kept)[:number]],
            "ground_truth": index in marked,
        }
        for index, number in enumerate((1, 2, 3))
    ]
    path.write_text(json.dumps([task]))
    found = LabelFile(path, split / "images").labels
    assert len(found.images[0].marks) == taken
    assert found.lost["annotation that another of the same image replaces"] == 2


def test_cancelled_annotations_are_told(split: Path, tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    write_labels_file(path, labels_of(open_labelled(split)), "label-studio")
    tasks = json.loads(path.read_text())
    cancelled = {"result": [], "was_cancelled": True}
    tasks[0]["annotations"] += [cancelled, {"result": []}]
    tasks[1]["annotations"] = [cancelled]
    path.write_text(json.dumps(tasks))
    assert LabelFile(path, split / "images").labels.lost == {
        "annotation that was cancelled": 2,
        "annotation that another of the same image replaces": 1,
        "image that nobody has annotated": 1,
    }


def test_the_smaller_export_of_label_studio_is_refused_with_the_name_of_the_other(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps([{"image": "/data/upload/1/a.png", "id": 1, "annotator": 1, "annotation_id": 1}]))
    with pytest.raises(ValueError, match=r'json: 0\.data: .* export "JSON" \("JSON-MIN" has none\), found none$'):
        LabelFile(path, tmp_path)


def test_a_vehicle_has_one_point() -> None:
    marks = [Mark(Kind.VEHICLE, (1, 2), 3), Mark(Kind.VEHICLE, (5, 6), 3)]
    with pytest.raises(ValueError, match=r"a\.xml: vehicle 3: expected one point, got several"):
        vehicles_of(marks, "a.xml")


def test_images_of_another_size_are_refused(split: Path) -> None:
    path = split / "labels.xml"
    exported(split, path, "cvat")
    path.write_text(path.read_text().replace('width="96"', 'width="95"'))
    with pytest.raises(ValueError, match=r"image size: expected 95x72 px as in .*labels\.xml, got 96x72 px"):
        list(open_labelled(path))


def test_an_empty_set_cannot_be_read_again(tmp_path: Path) -> None:
    write_labels_file(tmp_path / "a.json", LabelSet(()), "coco")
    with pytest.raises(ValueError, match="expected labelled images, found none"):
        LabelFile(tmp_path / "a.json")


def test_the_categories_of_the_tools_are_ours() -> None:
    assert set(CATEGORIES.values()) == set(ImageCategory) - {ImageCategory.NONE}
