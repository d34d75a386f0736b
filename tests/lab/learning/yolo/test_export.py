"""The YOLO data set: which boxes, in which numbers, and what an interrupted export leaves."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.config import preset
from foreglow.datasets import PVDN
from foreglow.lab.learning.annotation import RECORD_NAME, annotate_split, label_boxes, splits_to_annotate
from foreglow.lab.learning.yolo import export as export_module
from foreglow.lab.learning.yolo.export import export_yolo, is_export, label_lines, positive_boxes, read_export, squashed
from foreglow.own_folders import UNFINISHED_EXPORT
from foreglow.proposals import make_proposer
from foreglow.whole_files import write_atomic
from tests.datasets.tiny_pvdn import IDS, make_pvdn, write
from tests.lab.learning.yolo.night_data import HEIGHT_PX, WIDTH_PX, make_night_data
from tests.stand_ins import night_image


@pytest.fixture
def annotated(tmp_path: Path) -> Path:
    """The tiny split with boxes of every image; those of image 11 are a positive and a negative one."""
    root = make_pvdn(tmp_path / "data")
    for image_id in itertools.chain(*IDS.values()):
        if image_id != 11:
            write(root / f"labels/bounding_boxes/{image_id:06d}.json", {"bounding_boxes": [], "labels": []})
    return tmp_path / "data"


def test_boxes_as_annotated(annotated: Path, tmp_path: Path) -> None:
    export = export_yolo(annotated, tmp_path / "out", size_px=48)
    assert export.settings.boxes == "as annotated"
    assert export.num_images == {"val": 5}
    assert export.num_boxes == {"val": 1}
    # The box 36, 29, 46, 33 of an image of 96 x 72 pixels.
    expected = f"0 {41 / 96:.6f} {31 / 72:.6f} {10 / 96:.6f} {4 / 72:.6f}\n"
    assert (tmp_path / "out/labels/val/000011.txt").read_text() == expected
    assert (tmp_path / "out/labels/val/000005.txt").read_text() == ""
    image = cv2.imread(str(tmp_path / "out/images/val/000011.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == (48, 48)
    assert (tmp_path / "out/data.yaml").read_text() == "val: images/val\nnc: 1\nnames:\n  0: light_artifact\n"


def test_boxes_of_an_annotation_that_was_interrupted_are_not_exported(tmp_path: Path) -> None:
    """Those of two calls, perhaps with other parameters, would be one data set."""
    make_night_data(tmp_path / "data", ("train",))
    (split,) = splits_to_annotate(tmp_path / "data")
    annotate_split(split, preset("paper"))
    record = split / "labels" / RECORD_NAME
    write_atomic(record, record.read_bytes().replace(b"is_complete = true", b"is_complete = false"))
    with pytest.raises(ValueError, match=r"expected boxes of a finished `annotate`, got a part of them: run it again"):
        export_yolo(tmp_path / "data", tmp_path / "out", size_px=48)
    assert export_yolo(tmp_path / "data", tmp_path / "out", preset_name="paper", size_px=48).num_boxes["train"]


def test_boxes_of_key_points_that_were_corrected_since_are_not_exported(tmp_path: Path) -> None:
    make_night_data(tmp_path / "data", ("train",))
    (split,) = splits_to_annotate(tmp_path / "data")
    annotate_split(split, preset("paper"))
    shutil.copytree(tmp_path / "data", tmp_path / "copy", copy_function=shutil.copyfile)
    assert export_yolo(tmp_path / "copy", tmp_path / "copied", size_px=48).num_boxes["train"]
    keypoints = min((split / "labels/keypoints").glob("*.json"))
    content = json.loads(keypoints.read_bytes())
    keypoints.write_text(json.dumps(content | {"annotations": []}))
    with pytest.raises(ValueError, match=r"these were made before a change: run `annotate` again"):
        export_yolo(tmp_path / "data", tmp_path / "out", size_px=48)
    image_id = int(keypoints.stem)
    boxes = split / f"labels/bounding_boxes/{image_id:06d}.json"
    boxes.write_text(boxes.read_text().replace("1.0", "0.0"))  # somebody corrects both
    export_yolo(tmp_path / "data", tmp_path / "out", size_px=48)
    assert (tmp_path / f"out/labels/train/{image_id:06d}.txt").read_text() == ""


def test_boxes_that_another_version_proposed_are_exported_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_night_data(tmp_path / "data", ("train",))
    monkeypatch.setattr(export_module, "version", lambda _: "0.0.1")
    monkeypatch.setattr(export_module, "positive_boxes", lambda *_: np.zeros((0, 4)))
    assert export_yolo(tmp_path / "data", tmp_path / "out", preset_name="paper", size_px=48).num_boxes["train"] == 0
    monkeypatch.undo()
    assert export_yolo(tmp_path / "data", tmp_path / "out", preset_name="paper", size_px=48).num_boxes["train"]


def test_boxes_of_a_preset_take_precedence(annotated: Path, tmp_path: Path) -> None:
    export = export_yolo(annotated, tmp_path / "out", preset_name="baseline", size_px=48)
    assert export.settings.boxes == "preset baseline"


@pytest.mark.parametrize("name", ["data.yaml", "labels/val/000011.txt"])
def test_another_data_set_is_neither_overwritten_nor_taken_for_ours(name: str, annotated: Path, tmp_path: Path) -> None:
    write(tmp_path / "out" / name, "mine")
    with pytest.raises(ValueError, match="expected a folder without a YOLO data set that is not of export-yolo"):
        export_yolo(annotated, tmp_path / "out", size_px=48)
    assert [path.name for path in (tmp_path / "out").rglob("*") if path.is_file()] == [Path(name).name]


@pytest.mark.parametrize("name", ["notes.txt", "summary.json", "photos/a.jpg"])
def test_an_export_goes_into_a_new_folder(name: str, annotated: Path, tmp_path: Path) -> None:
    write(tmp_path / "out" / name, "mine")
    with pytest.raises(ValueError, match="out: expected a new folder, or one with earlier results of this command; "):
        export_yolo(annotated, tmp_path / "out", size_px=48)
    assert [path.name for path in (tmp_path / "out").rglob("*") if path.is_file()] == [Path(name).name]


def test_labels_that_changed_since_are_exported_again(annotated: Path, tmp_path: Path) -> None:
    export_yolo(annotated, tmp_path / "out", size_px=48)
    exported = tmp_path / "out/labels/val/000011.txt"
    boxes = annotated / "night/val/labels/bounding_boxes/000011.json"
    write(boxes, {"bounding_boxes": [], "labels": []})
    later_ns = exported.stat().st_mtime_ns + 1
    os.utime(boxes, ns=(later_ns, later_ns))
    assert export_yolo(annotated, tmp_path / "out", size_px=48).num_boxes == {"val": 0}
    assert exported.read_text() == ""


def test_labels_that_are_older_than_the_export_are_others_too(annotated: Path, tmp_path: Path) -> None:
    """As after a restored backup, or an archive that keeps times."""
    export_yolo(annotated, tmp_path / "out", size_px=48)
    boxes = annotated / "night/val/labels/bounding_boxes/000011.json"
    before_ns = boxes.stat().st_mtime_ns - 10**9
    write(boxes, {"bounding_boxes": [], "labels": []})
    os.utime(boxes, ns=(before_ns, before_ns))
    assert export_yolo(annotated, tmp_path / "out", size_px=48).num_boxes == {"val": 0}


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("labels/val/000011.txt", b""),
        ("labels/val/000005.txt", b"0 0.5 0.5 0.1 0.1\n"),
        ("images/val/000011.png", b"mine"),
        ("checksums.json", b"[]"),
        ("checksums.json", b'{"labels/val/000011.txt": 1}'),
    ],
)
@pytest.mark.parametrize("is_source_newer", [False, True])
def test_what_was_changed_in_an_export_is_neither_counted_nor_replaced(
    name: str, data: bytes, is_source_newer: bool, annotated: Path, tmp_path: Path
) -> None:
    whole = export_yolo(annotated, tmp_path / "out", size_px=48)
    path = tmp_path / "out" / name
    path.write_bytes(data)
    if is_source_newer:
        later_ns = path.stat().st_mtime_ns + 1
        os.utime(annotated / "night/val/labels/bounding_boxes/000011.json", ns=(later_ns, later_ns))
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    for call in (lambda: export_yolo(annotated, tmp_path / "out", size_px=48), lambda: read_export(tmp_path / "out")):
        with pytest.raises(
            ValueError,
            match=rf"{name}: expected (the file that Foreglow wrote|checksums of what Foreglow wrote here), got",
        ):
            call()
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()} == before
    path.unlink()
    assert export_yolo(annotated, tmp_path / "out", size_px=48).num_boxes == whole.num_boxes
    read_export(tmp_path / "out")


@pytest.mark.parametrize("name", ["labels/val/000011.txt", "images/val/000011.png"])
def test_what_an_export_has_lost_is_exported_again(name: str, annotated: Path, tmp_path: Path) -> None:
    whole = export_yolo(annotated, tmp_path / "out", size_px=48)
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    (tmp_path / "out" / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"{name}: no such file, expected a complete export"):
        read_export(tmp_path / "out")
    assert export_yolo(annotated, tmp_path / "out", size_px=48) == whole
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()} == before


def test_an_export_that_is_killed_while_it_replaces_an_earlier_one_goes_on(
    annotated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any of its renames; the files that it has replaced are not taken for edited ones."""
    boxes = annotated / "night/val/labels/bounding_boxes/000011.json"
    texts = boxes.read_bytes(), b'{"bounding_boxes": [], "labels": []}'
    folder, replace = tmp_path / "out", Path.replace
    export_yolo(annotated, folder, size_px=48)
    for num_moves in range(20):
        boxes.write_bytes(texts[(num_moves + 1) % 2])
        later_ns = (folder / "labels/val/000011.txt").stat().st_mtime_ns + 1
        os.utime(boxes, ns=(later_ns, later_ns))
        moves = itertools.count()

        def replaced(path: Path, target: Path, moves: itertools.count[int] = moves, last: int = num_moves) -> Path:
            if UNFINISHED_EXPORT in path.parts and target.parent != path.parent and next(moves) == last:
                raise KeyboardInterrupt
            return replace(path, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", replaced)
            with contextlib.suppress(KeyboardInterrupt):
                export_yolo(annotated, folder, size_px=48)
        export = export_yolo(annotated, folder, size_px=48)
        assert export.num_boxes == {"val": 1 - (num_moves + 1) % 2}
        read_export(folder)
    assert next(moves) < num_moves  # the last ones were not interrupted


def test_a_missing_annotation(annotated: Path, tmp_path: Path) -> None:
    (annotated / "night/val/labels/bounding_boxes/000007.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"000007\.json: no such file, expected boxes of every image"):
        export_yolo(annotated, tmp_path / "out", size_px=48)


def test_boxes_that_are_proposed_are_those_of_the_detector(tmp_path: Path) -> None:
    data = make_night_data(tmp_path / "data")
    export = export_yolo(data, tmp_path / "out", size_px=64)
    assert export.settings.boxes == "preset paper"
    assert export.settings.splits == ("train", "val", "test")
    assert export.num_boxes["train"] > 0
    dataset = PVDN(data / "train")
    proposer = make_proposer(preset("paper").proposals)
    for frame in dataset:
        proposed = proposer.propose(frame.image).boxes_xyxy_px
        is_positive = label_boxes(proposed, dataset.keypoints_px(frame.frame)) == 1
        assert np.array_equal(positive_boxes(dataset, frame, proposer), proposed[is_positive])
        text = (tmp_path / f"out/labels/train/{frame.frame:06d}.txt").read_text()
        assert text == label_lines(proposed[is_positive], WIDTH_PX, HEIGHT_PX)


def test_an_interrupted_export_goes_on(tmp_path: Path) -> None:
    data = make_night_data(tmp_path / "data", ("train", "val"))
    whole = export_yolo(data, tmp_path / "whole", size_px=64)

    def stop(num_done: int, num_images: int) -> None:
        if num_done == 5:
            raise KeyboardInterrupt
        assert num_images == 16

    folder = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        export_yolo(data, folder, size_px=64, progress=stop)
    assert is_export(folder)
    assert [path.name for path in folder.iterdir()] == [".export.partial"]
    with pytest.raises(FileNotFoundError, match=r"export\.json: no such file, expected a complete export"):
        read_export(folder)
    (folder / ".export.partial/labels/train/000010.txt").write_text("0 0.5 0.5 0.1 0.1\n")  # is kept
    done = folder / "labels/train/000010.txt"
    calls: list[int] = []
    export = export_yolo(data, folder, size_px=64, progress=lambda num_done, _: calls.append(num_done))
    assert calls == list(range(1, 17))
    assert done.read_text() == "0 0.5 0.5 0.1 0.1\n"
    assert export.num_boxes == whole.num_boxes
    assert read_export(folder) == export.settings
    names = {path.relative_to(folder) for path in folder.rglob("*")}
    assert names == {path.relative_to(tmp_path / "whole") for path in (tmp_path / "whole").rglob("*")}


@pytest.mark.parametrize("is_interrupted", [False, True])
def test_images_that_left_the_data_set_leave_the_export(tmp_path: Path, *, is_interrupted: bool) -> None:
    """They stayed there, and were trained on, though they were not counted."""
    data, folder = make_night_data(tmp_path / "data", ("train", "val")), tmp_path / "out"

    def stop(num_done: int, num_images: int) -> None:
        if is_interrupted and num_done == num_images:
            raise KeyboardInterrupt

    with contextlib.suppress(KeyboardInterrupt):
        export_yolo(data, folder, size_px=64, progress=stop)
    shutil.rmtree(data)
    make_night_data(tmp_path / "data", ("train", "val"), num_images=3)
    export = export_yolo(data, folder, size_px=64)
    assert export.num_images == {"train": 6, "val": 6}
    for kind in ("images", "labels"):
        assert len(list((folder / kind / "train").iterdir())) == len(list((folder / kind / "val").iterdir())) == 6
    assert read_export(folder) == export.settings


@pytest.mark.parametrize("name", ["mine.png", "mine.JPG"])
def test_an_image_that_was_added_is_named(annotated: Path, tmp_path: Path, name: str) -> None:
    whole = export_yolo(annotated, tmp_path / "out", size_px=48)
    path = tmp_path / "out/images/val" / name
    path.write_bytes(b"mine")
    for call in (lambda: export_yolo(annotated, tmp_path / "out", size_px=48), lambda: read_export(tmp_path / "out")):
        with pytest.raises(ValueError, match=rf"{name}: expected images that were exported here, and no others"):
            call()
    assert path.read_bytes() == b"mine"
    path.unlink()
    (path.parent / "mine.npy").touch()  # as libraries keep images
    assert export_yolo(annotated, tmp_path / "out", size_px=48) == whole
    read_export(tmp_path / "out")


def test_an_interrupted_export_with_other_settings_is_replaced(tmp_path: Path) -> None:
    data = make_night_data(tmp_path / "data", ("val",))

    def stop(_num_done: int, _num_images: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_yolo(data, tmp_path / "out", size_px=64, progress=stop)
    export_yolo(data, tmp_path / "out", size_px=96)
    assert not (tmp_path / "out/.export.partial").exists()
    for path in (tmp_path / "out/images").rglob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.shape == (96, 96)


def _fill(disk_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on, what is written to the file of this name fails."""
    write = write_atomic

    def write_until(path: Path, data: bytes) -> None:
        if path.name == disk_path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        write(path, data)

    monkeypatch.setattr(export_module, "write_atomic", write_until)


@pytest.mark.parametrize("last", ["000007.png", "000011.txt", "data.yaml", "export.json"])
def test_a_full_disk_leaves_nothing(
    last: str, annotated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _fill(tmp_path / last, monkeypatch)
    with pytest.raises(OSError, match="No space left on device"):
        export_yolo(annotated, tmp_path / "out", size_px=48)
    assert not (tmp_path / "out").exists()


def test_a_full_disk_leaves_an_earlier_export_as_it_was(
    annotated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_yolo(annotated, tmp_path / "out", size_px=48)
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    boxes = annotated / "night/val/labels/bounding_boxes/000011.json"
    write(boxes, {"bounding_boxes": [], "labels": []})
    later_ns = (tmp_path / "out/labels/val/000011.txt").stat().st_mtime_ns + 1
    os.utime(boxes, ns=(later_ns, later_ns))
    with monkeypatch.context() as patch:
        _fill(tmp_path / "data.yaml", patch)
        with pytest.raises(OSError, match="No space left on device"):
            export_yolo(annotated, tmp_path / "out", size_px=48)
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()} == before
    assert export_yolo(annotated, tmp_path / "out", size_px=48).num_boxes == {"val": 0}
    assert {path for path in (tmp_path / "out").rglob("*") if path.is_file()} == set(before)


def test_another_export_needs_another_folder(tmp_path: Path) -> None:
    data = make_night_data(tmp_path / "data", ("val",))
    export_yolo(data, tmp_path / "out", size_px=64)
    with pytest.raises(ValueError, match=r"export\.json: size_px: expected 96 to go on with this export, it has 64"):
        export_yolo(data, tmp_path / "out", size_px=96)
    with pytest.raises(ValueError, match=r"boxes: expected 'preset baseline'"):
        export_yolo(data, tmp_path / "out", preset_name="baseline", size_px=64)


def test_no_such_data_set(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such folder, expected a data set"):
        export_yolo(tmp_path / "absent", tmp_path / "out")
    with pytest.raises(FileNotFoundError, match="expected one of the splits train, val, test, found none"):
        export_yolo(tmp_path, tmp_path / "out")
    data = make_night_data(tmp_path / "data", ("val",))
    with pytest.raises(ValueError, match="expected one of paper"):
        export_yolo(data, tmp_path / "out", preset_name="papers")


@given(
    st.lists(st.tuples(*[st.integers(-50, 250)] * 4), max_size=6),
    st.integers(1, 200),
    st.integers(1, 200),
)
def test_lines_are_relative_and_inside(boxes: list[tuple[int, int, int, int]], width_px: int, height_px: int) -> None:
    lines = label_lines(np.array(boxes).reshape(-1, 4), width_px, height_px).splitlines()
    inside = [b for b in boxes if max(b[0], 0) < min(b[2], width_px) and max(b[1], 0) < min(b[3], height_px)]
    assert len(lines) == len(inside)
    for line, (x1, y1, x2, y2) in zip(lines, inside, strict=True):
        number, *values = line.split()
        centre_x, centre_y, width, height = map(float, values)
        assert number == "0"
        assert 0 < width <= 1
        assert 0 < height <= 1
        assert (centre_x - width / 2) * width_px == pytest.approx(max(x1, 0), abs=2e-4)
        assert (centre_x + width / 2) * width_px == pytest.approx(min(x2, width_px), abs=2e-4)
        assert (centre_y - height / 2) * height_px == pytest.approx(max(y1, 0), abs=2e-4)
        assert (centre_y + height / 2) * height_px == pytest.approx(min(y2, height_px), abs=2e-4)


def test_squashing_averages_each_axis_on_its_own() -> None:
    image = np.zeros((60, 80), np.uint8)
    image[:30, :40] = 200
    assert squashed(image, 2).tolist() == [[200, 0], [0, 0]]
    with pytest.raises(ValueError, match=r"frame\.png: expected an image of 8 bits for a YOLO, got uint16"):
        squashed(night_image(dtype=np.uint16), 64, "frame.png")
