from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.datasets import PVDN, Cycle, ImageCategory, Selection, Weather, write_pvdn
from foreglow.datasets.json_files import parse_json
from foreglow.datasets.pvdn.schema import BoxLabels, CategoryConfig, ImageAnnotationsFile, KeypointsFile, SequencesFile
from tests.datasets.tiny_pvdn import SIZE_PX, documents, edit, make_pvdn, tiny_image, write


@pytest.fixture
def split(tmp_path: Path) -> Path:
    return make_pvdn(tmp_path)


def test_frames_come_by_sequence_then_id_with_their_pixels(split: Path) -> None:
    dataset = PVDN(split)
    frames = list(dataset)
    assert [frame.frame for frame in frames] == [5, 7, 11, 12, 13] == list(dataset.frame_ids)
    assert [frame.sequence for frame in frames] == ["S00001"] * 2 + ["S00003"] * 3
    assert all((frame.image == tiny_image(frame.frame)).all() for frame in frames)
    assert (len(dataset), dataset.num_frames, dataset.name, dataset.rate_hz) == (5, 5, "night/val", 18.0)


def test_time_is_the_sequences_start_plus_the_place_over_18_hz(split: Path) -> None:
    times = {frame.frame: frame.timestamp_ns for frame in PVDN(split)}
    assert times == {5: 1_500_000_000, 7: 1_555_555_556, 11: 4_500_000_000, 12: 4_555_555_556, 13: 4_611_111_111}


def test_a_set_may_name_its_own_rate(split: Path) -> None:
    path = split / "labels/image_annotations.json"
    for index in range(5):
        edit(path, "images", index, "timestamp", value=None)
    edit(path, "info", "rate_hz", value=10)
    dataset = PVDN(split)
    assert dataset.rate_hz == 10.0
    assert [frame.timestamp_ns for frame in dataset][:2] == [1_500_000_000, 1_600_000_000]
    for value in (0, -5.0, "18", True, None, 2000):
        edit(path, "info", "rate_hz", value=value)
        with pytest.raises(
            ValueError, match=r"image_annotations\.json: info\.rate_hz: expected a number from 0\.01 to 1000"
        ):
            PVDN(split)


def test_images_of_a_set_with_a_rate_may_be_at_any_times(split: Path) -> None:
    """Such as pairs, a quarter of a second apart every two seconds."""
    path = split / "labels/image_annotations.json"
    content = json.loads(path.read_text())
    times_ms = {11: 700, 12: 950, 13: 2700, 5: 0, 7: 100}
    for image in content["images"]:
        image["timestamp"] = times_ms[image["id"]]
    path.write_text(json.dumps(content))
    even = [PVDN(split).time_s(image_id) for image_id in (11, 12, 13)]
    assert even == [number / 18 for number in range(3)]  # without a rate, nobody knows the unit
    edit(path, "info", "rate_hz", value=10)
    dataset = PVDN(split)
    assert [dataset.time_s(image_id) for image_id in (11, 12, 13, 5, 7)] == [0.0, 0.25, 2.0, 0.0, 0.1]
    assert [dataset.read(image_id).timestamp_ns for image_id in (11, 12)] == [4_500_000_000, 4_750_000_000]
    assert dataset.mean_rate_hz == pytest.approx(3 / 2.1)
    edit(path, "info", "rate_hz", value=1)
    assert PVDN(split).mean_rate_hz == pytest.approx(3 / 2.1)  # times count, whatever the set says beside them
    content["info"]["rate_hz"] = 10
    for image in content["images"]:
        image["timestamp"] = None
    path.write_text(json.dumps(content))
    assert [PVDN(split).time_s(image_id) for image_id in (11, 12, 13)] == [0.0, 0.1, 0.2]
    assert PVDN(split).mean_rate_hz == 10
    for value, words in {
        700: "more than 700, that of the image before in S00003, got 700",
        10: "more than 700, that of the image before in S00003, got 10",
        "later": "milliseconds, or null in all images of S00003, got 'later'",
        None: "milliseconds, or null in all images of S00003, got None",
        1e300: "milliseconds, or null in all images of S00003, got 1e+300",
    }.items():
        for image in content["images"]:
            image["timestamp"] = times_ms[image["id"]]
        content["images"][3]["timestamp"] = value  # image 12
        path.write_text(json.dumps(content))
        with pytest.raises(ValueError, match=r"image_annotations\.json: images\.3\.timestamp: expected ") as refused:
            PVDN(split)
        assert words in str(refused.value)


def test_two_images_of_a_sequence_are_two_files(split: Path) -> None:
    path = split / "labels/image_annotations.json"
    edit(path, "images", 3, "file_name", value="000011.png")
    words = (
        r"image_annotations\.json: images\.3\.file_name: expected each file of S00003 once, 000011\.png is there twice"
    )
    with pytest.raises(ValueError, match=words):
        PVDN(split)


def test_doubtful_light(split: Path) -> None:
    dataset = PVDN(split)
    assert dataset.doubtful(11) == ()
    edit(split / "labels/keypoints/000011.json", "doubtful", value=[{"pos": [3, 4], "iid": -1}])
    (light,) = dataset.doubtful(11)
    assert (light.position_px, light.iid) == ((3, 4), -1)
    assert [3, 4] not in dataset.keypoints_px(11).tolist()


def test_a_folder_above_the_only_split(split: Path) -> None:
    for folder in (split.parent, split.parents[1]):
        assert PVDN(folder).root == split
    make_pvdn(split.parents[1], "day")
    with pytest.raises(ValueError, match=r"expected one split of PVDN, such as .*day/val"):
        PVDN(split.parents[1])


def test_a_filter_does_not_move_time(split: Path) -> None:
    dataset = PVDN(split, select=Selection(categories=[ImageCategory.INDIRECT]))
    assert [(frame.frame, frame.timestamp_ns) for frame in dataset] == [(13, 4_611_111_111)]


def test_one_sequence_folder(split: Path) -> None:
    dataset = PVDN(split / "images" / "S00003")
    assert dataset.frame_ids == (11, 12, 13)
    assert dataset.name == "night/val/S00003"
    assert [sequence.id for sequence in dataset.sequences] == [3]


def test_vehicles_and_instances(split: Path) -> None:
    dataset = PVDN(split)
    (vehicle,) = dataset.annotations(11)
    assert (vehicle.position_px, vehicle.oid, vehicle.is_direct) == ((40, 30), 2, True)
    assert [(instance.iid, instance.is_direct, instance.is_rear) for instance in vehicle.instances] == [
        (0, True, False),
        (1, True, False),
        (2, False, True),
    ]
    assert dataset.keypoints_px(11).tolist() == [[38, 31], [44, 31], [20, 50]]
    assert dataset.annotations(5) == ()
    assert dataset.keypoints_px(12).shape == (0, 2)


def test_categories_and_what_they_mark(split: Path) -> None:
    dataset = PVDN(split)
    assert dataset.categories(13) == (ImageCategory.FIRST_TRIGGER_LOW_BEAM, ImageCategory.INDIRECT)
    assert dataset.categories(5) == (ImageCategory.NONE,)
    marks = CategoryConfig()
    sequence = dataset.sequence(11)
    assert dataset.first_with(sequence, marks.first_annotated) == 12
    assert dataset.first_with(sequence, marks.low_beam_trigger) == 13
    assert dataset.first_with(sequence, marks.first_direct_sight) is None
    assert [int(mark) for mark in (marks.first_annotated, marks.first_direct_sight, marks.low_beam_trigger)] == [
        1,
        5,
        6,
    ]


def test_the_folder_names_the_cycle_before_the_camera_configuration(split: Path, tmp_path: Path) -> None:
    assert PVDN(split).cycle_of(5) is Cycle.NIGHT
    assert PVDN(split).camera_configuration(5).cycle is Cycle.DAY
    moved = PVDN(split.rename(tmp_path / "elsewhere"))
    assert moved.cycle is None
    assert moved.cycle_of(5) is Cycle.DAY


@pytest.mark.parametrize(
    ("select", "expected"),
    [
        (Selection(), (5, 7, 11, 12, 13)),
        (Selection(scenes=["S00001"]), (5, 7)),
        (Selection(scenes={3, "S00001"}), (5, 7, 11, 12, 13)),
        (Selection(scenes=[]), ()),
        (Selection(cycle=Cycle.NIGHT), (5, 7, 11, 12, 13)),
        (Selection(cycle=Cycle.DAY), ()),
        (Selection(weathers=[Weather.RAIN, Weather.FOG]), (11, 12, 13)),
        (Selection(has_keypoints=True), (11,)),
        (Selection(has_keypoints=False, scenes=[3]), (12, 13)),
        (Selection(categories=[ImageCategory.NONE]), (5, 7, 11)),
    ],
)
def test_selection(split: Path, select: Selection, expected: tuple[int, ...]) -> None:
    assert PVDN(split, select=select).frame_ids == expected


def test_a_scene_that_does_not_exist_is_named(split: Path) -> None:
    with pytest.raises(ValueError, match="scenes: expected ids or folders of sequences, got 'S00009'"):
        PVDN(split, select=Selection(scenes=["S00009"]))


def test_boxes(split: Path) -> None:
    boxes = PVDN(split).boxes(11)
    assert boxes is not None
    assert boxes.boxes_xyxy_px == ((36, 29, 46, 33), (60, 60, 70, 64))
    assert boxes.labels == (1.0, 0.0)
    assert PVDN(split).boxes(5) is None


SEQUENCES, IMAGES, KEYPOINTS = "labels/sequences.json", "labels/image_annotations.json", "labels/keypoints/000011.json"


def _edit(name: str, *keys: str | int, value: Any) -> Callable[[Path], None]:
    return lambda root: edit(root / name, *keys, value=value)


def _text(name: str, text: str) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        (root / name).write_text(text)

    return damage


def _delete_key(name: str, *keys: str | int) -> Callable[[Path], None]:
    def without(old: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in old.items() if key != keys[-1]}

    return _edit(name, *keys[:-1], value=without)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_text(SEQUENCES, "{"), "sequences.json: expected JSON"),
        (_text(SEQUENCES, ""), "sequences.json: expected JSON"),
        (_text(IMAGES, "[]"), "image_annotations.json: document: expected an object, got"),
        (_edit(SEQUENCES, "sequences", 0, "weather", value=9), "sequences.0.weather: expected 0, 1, 2, 3 or 4, got 9"),
        (_edit(SEQUENCES, "sequences", 1, "direction", value="x"), "sequences.1.direction: expected 0, 1, .*got 'x'"),
        (_edit(SEQUENCES, "sequences", 1, "start_time", value="1"), "sequences.1.start_time.*got '1'"),
        (_edit(SEQUENCES, "sequences", 1, "dir", value="../../etc"), "sequences.1.dir: expected a plain name"),
        (_edit(SEQUENCES, "sequences", 1, "image_ids", value=[5, 7, 11]), "each image in one sequence once, 11 is in"),
        (_edit(SEQUENCES, "sequences", 1, "image_ids", value=[5, 7, 5]), "each image in one sequence once, 5 is in"),
        (_edit(SEQUENCES, "sequences", 1, "image_ids", value=[5]), "expected image 7 of .* in a sequence"),
        (_edit(SEQUENCES, "sequences", 1, "image_ids", value=[5, 7, 99]), "image_ids: expected images of .*99"),
        (_edit(SEQUENCES, "sequences", 1, "id", value=3), "sequences.1.id: expected each sequence once, 3"),
        (_edit(SEQUENCES, "sequences", 1, "dir", value="S00003"), "sequences.1.dir: expected each folder once, S00003"),
        (_delete_key(IMAGES, "images", 0, "file_name"), "images.0.file_name: field is missing"),
        (_edit(IMAGES, "images", 0, "height", value=1.5), "images.0.height: expected a valid integer, got 1.5"),
        (_edit(IMAGES, "images", 0, "file_name", value="/a.png"), "images.0.file_name: expected a plain name"),
        (
            _edit(IMAGES, "images", 0, "timestamp", value=[1]),
            r"images.0.timestamp: expected text or a number, got \[1\]",
        ),
        (_edit(IMAGES, "images", 0, "id", value=12), "images.3.id: expected each image once, 12 is there twice"),
        (
            _edit(IMAGES, "images", 0, "camera_configuration", value=1),
            "camera_configuration: expected an index in a list",
        ),
        (_edit(IMAGES, "annotations", 0, "category", value=8), "annotations.0.category: expected 0, 1, .*got 8"),
        (_edit(IMAGES, "annotations", 0, "image_id", value=99), "annotations.0.image_id: expected an id of images"),
        (_edit(IMAGES, "camera_configurations", 0, "cycle", value="dusk"), "cycle: expected 'day' or 'night'"),
        (
            lambda root: write(root / "labels/keypoints/000099.json", {"image_id": 99, "annotations": []}),
            "000099.json: keypoint file without its image, 99",
        ),
        (lambda root: write(root / "labels/keypoints/x.json", {}), "x.json: name: expected an image id of six digits"),
        (_edit(KEYPOINTS, "image_id", value=12), "000011.json: image_id: expected 11 as in the file's name, got 12"),
        (_edit(KEYPOINTS, "annotations", 0, "pos", value=[1]), "annotations.0.pos.1: expected one more entry"),
        (
            _edit(KEYPOINTS, "annotations", 0, "pos", value=[1, 2, 3]),
            "annotations.0.pos: expected at most 2 entries, got 3",
        ),
        (_edit(KEYPOINTS, "annotations", 0, "pos", value=[1, 2, 3]), "annotations.0.pos: "),
        (_edit(KEYPOINTS, "annotations", 0, "pos", value=[10**12, 2]), "annotations.0.pos.0: .*got 1000000000000"),
        (_edit(KEYPOINTS, "annotations", 0, "instances", 0, "direct", value=1), "instances.0.direct: .*got 1"),
        (
            _edit("labels/bounding_boxes/000011.json", "labels", value=[1.0]),
            "000011.json: document: labels: expected 2, one for each box, got 1",
        ),
        (_edit(IMAGES, "images", 2, "height", value=73), "000011.png: image size: expected 96x73 px .* got 96x72 px"),
    ],
)
def test_bad_labels_give_one_clear_line(split: Path, damage: Callable[[Path], None], message: str) -> None:
    damage(split)
    with pytest.raises(ValueError, match=message) as caught:
        _read_all(split)
    assert "\n" not in str(caught.value)
    assert str(caught.value).count(", got ") <= 1
    assert str(caught.value).startswith(str(split))


@pytest.mark.parametrize("name", [SEQUENCES, IMAGES, KEYPOINTS, "images/S00003/000011.png"])
def test_a_missing_file_is_named(split: Path, name: str) -> None:
    (split / name).unlink()
    with pytest.raises(FileNotFoundError, match=str(split / name)):
        _read_all(split)


def test_a_missing_image_stops_before_the_first_frame(split: Path) -> None:
    (split / "images/S00003/000013.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"000013\.png: no such image"):
        iter(PVDN(split))


def test_skip_leaves_bad_images_out_and_names_them(split: Path) -> None:
    (split / "images/S00003/000013.png").unlink()
    (split / "images/S00001/000005.png").write_bytes(b"not an image")
    dataset = PVDN(split, on_error="skip")
    for _ in range(2):
        assert [frame.frame for frame in dataset] == [7, 11, 12]
        assert [line.split(": ")[0].split("/")[-1] for line in dataset.skipped] == ["000005.png", "000013.png"]


def test_an_unknown_image_id_is_an_error(split: Path) -> None:
    dataset = PVDN(split)
    dataset.labels.images[1] = dataset.labels.images[5]
    for read in (dataset.read, dataset.annotations, dataset.boxes, dataset.sequence, dataset.categories):
        with pytest.raises(ValueError, match="expected an image of this split, got 99"):
            read(99)
        for equal in (True, 1.0, 5.0, "5", None):  # a dict takes the first three for 1 and 5
            with pytest.raises(ValueError, match=f"expected an image of this split, got {equal}"):
                read(equal)  # type: ignore[arg-type]


def test_a_folder_that_is_no_split(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected a PVDN split"):
        PVDN(tmp_path / "absent")
    with pytest.raises(FileNotFoundError, match=r"sequences\.json"):
        PVDN(tmp_path)


def test_a_sequence_folder_that_the_labels_do_not_know(split: Path) -> None:
    (split / "images" / "S00009").mkdir()
    with pytest.raises(ValueError, match="expected a sequence with dir S00009"):
        PVDN(split / "images" / "S00009")


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


def _all_keys(document: Any, prefix: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The path of every value in a JSON document."""
    inner: list[tuple[str | int, Any]] = []
    if isinstance(document, dict):
        inner = list(document.items())
    elif isinstance(document, list):
        inner = list(enumerate(document))
    return [prefix] + [keys for key, value in inner for keys in _all_keys(value, (*prefix, key))]


_KEYPOINTS = {"image_id": 11, "annotations": [{"pos": [1, 2], "oid": 1, "instances": [{"pos": [3, 4], "iid": 0}]}]}
_DOCUMENTS: list[tuple[Any, Any]] = [
    (SequencesFile, documents()[0]),
    (ImageAnnotationsFile, documents()[1]),
    (KeypointsFile, _KEYPOINTS),
    (BoxLabels, {"bounding_boxes": [[1, 2, 3, 4]], "labels": [1.0]}),
]


@settings(derandomize=True, max_examples=150)
@given(st.sampled_from(_DOCUMENTS), st.data())
def test_any_value_anywhere_is_read_or_refused(case: tuple[Any, Any], data: st.DataObject) -> None:
    model, document = case
    keys = data.draw(st.sampled_from(_all_keys(document)))
    changed = json.loads(json.dumps(document))
    if keys:
        target = changed
        for key in keys[:-1]:
            target = target[key]
        target[keys[-1]] = data.draw(_JSON)
    else:
        changed = data.draw(_JSON)
    _only_value_errors(lambda: parse_json(json.dumps(changed), model, "fuzz"))


@settings(derandomize=True, max_examples=150)
@given(st.sampled_from(_DOCUMENTS), st.data())
def test_any_damage_to_the_text_is_read_or_refused(case: tuple[Any, Any], data: st.DataObject) -> None:
    model, document = case
    text = bytearray(json.dumps(document).encode())
    for index in data.draw(st.lists(st.integers(0, len(text) - 1), min_size=1, max_size=4)):
        text[index] = data.draw(st.integers(0, 255))
    _only_value_errors(lambda: parse_json(bytes(text[: data.draw(st.integers(0, len(text)))]), model, "fuzz"))


def _only_value_errors(read: Callable[[], object]) -> None:
    message = "fuzz: "
    try:
        read()
    except ValueError as error:
        message = str(error)
    assert message.startswith("fuzz: ")
    assert len(message) < 500
    assert message.isprintable()


def _read_all(split: Path) -> None:
    dataset = PVDN(split)
    for frame in dataset:
        assert frame.image.shape == SIZE_PX
        dataset.annotations(frame.frame)
        dataset.boxes(frame.frame)


def test_reading_and_writing_give_equal_values(split: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy" / "night" / "val"
    write_pvdn(PVDN(split), copy)
    files = sorted(path.relative_to(split) for path in split.rglob("*") if path.is_file())
    assert sorted(path.relative_to(copy) for path in copy.rglob("*") if path.is_file()) == files
    for name in files:
        if name.suffix == ".json":
            assert json.loads((copy / name).read_text()) == json.loads((split / name).read_text())
    for original, copied in zip(PVDN(split), PVDN(copy), strict=True):
        assert np.array_equal(original.image, copied.image)
        assert (original.timestamp_ns, original.frame) == (copied.timestamp_ns, copied.frame)


def test_a_copy_never_overwrites_a_data_set(split: Path) -> None:
    with pytest.raises(ValueError, match="expected a folder without a data set"):
        write_pvdn(PVDN(split), split)
