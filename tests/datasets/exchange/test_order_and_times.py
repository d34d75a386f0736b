"""Images of folders in their order and at their times, whichever of them have labels."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.classifier.inputs import InputMaker, InputSpec
from foreglow.datasets import PVDN, ImageFolder
from foreglow.datasets.exchange import LABEL_FORMATS, LabelFile, Mark, labels_of, write_labels_file, write_split
from foreglow.datasets.exchange.marks import ImageLabels, Kind, LabelSet
from foreglow.datasets.images import png, read_image
from foreglow.datasets.labelled import LabelledSource
from foreglow.types import Proposals
from tests.datasets.test_sources import make_photograph
from tests.datasets.video.test_damage import make_stream


def drive_of_images(folder: Path, numbers: Iterable[int], width_px: int = 96) -> Path:
    """A folder of images, each as bright as its number."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        assert cv2.imwrite(str(folder / f"{number:06d}.png"), np.full((72, width_px), number, np.uint8))
    return folder


@pytest.mark.parametrize("is_imported", [True, False])
def test_images_without_labels_have_their_time_in_a_folder_too(tmp_path: Path, *, is_imported: bool) -> None:
    """As in a run on the folder, an image that is missing by the numbers included."""
    folder = drive_of_images(tmp_path / "drive", {*range(3, 60)} - {8, 50})
    labelled = (4, 12, 17, 40, 54)
    images = tuple(ImageLabels(f"{number:06d}.png", (96, 72)) for number in labelled)
    write_labels_file(folder / "a.xml", LabelSet(images), "cvat")
    source: LabelledSource = LabelFile(folder / "a.xml")
    if is_imported:
        assert isinstance(source, LabelFile)
        write_split(source, tmp_path / "own")
        source = PVDN(tmp_path / "own")
    times_s = {frame.frame: frame.timestamp_ns / 1e9 for frame in ImageFolder(folder)}
    assert [source.time_s(number) for number in labelled] == pytest.approx(
        [times_s[number] - times_s[4] for number in labelled], abs=1e-3
    )
    found = {
        frame.frame: None if frame.earlier is None else int(frame.earlier.image[0, 0])
        for frame in map(source.read, source.frame_ids)
    }
    assert found == {4: None, 12: 7, 17: None, 40: 36, 54: 49}  # .22 or .28 s before, by nanoseconds
    for number, before in ((12, 7), (40, 36), (54, 49)):
        earlier = source.read(number).earlier
        assert earlier is not None
        age_s = (source.read(number).timestamp_ns - earlier.timestamp_ns) / 1e9
        assert age_s == pytest.approx(times_s[number] - times_s[before], abs=1e-3)


def test_the_earlier_image_is_of_the_same_drive(tmp_path: Path) -> None:
    """Not one of another size, and not one beside another camera's labels."""
    folder = drive_of_images(tmp_path / "drive", range(10))
    drive_of_images(folder, (4, 5, 6), 80)
    write_labels_file(folder / "a.xml", LabelSet((ImageLabels("000009.png", (96, 72)),)), "cvat")
    assert LabelFile(folder / "a.xml").read(9).earlier is None


@pytest.mark.parametrize("kind", ["cvat", "coco", "label-studio"])
def test_images_are_in_the_order_of_their_names(tmp_path: Path, kind: str) -> None:
    """A tool may list them in any; two folders count their images alike."""
    names = ["b/2.png", "a/10.png", "b/1.png", "a/2.png", "a/1.png"]
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    for name in names:
        assert cv2.imwrite(str(tmp_path / name), np.zeros((72, 96), np.uint8))
    path = tmp_path / f"labels{LABEL_FORMATS[kind].suffix}"
    write_labels_file(path, LabelSet(tuple(ImageLabels(name, (96, 72)) for name in names)), kind)
    source = LabelFile(path)
    assert [
        (each.directory, [source.image(image_id).file_name for image_id in each.image_ids]) for each in source.sequences
    ] == [("a", ["1.png", "2.png", "10.png"]), ("b", ["1.png", "2.png"])]


def images_at(folder: Path, names: Iterable[str]) -> tuple[ImageLabels, ...]:
    """Images of these paths below a folder, and their labels, with a light each."""
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(png(np.full((72, 96), number, np.uint8)))
    return tuple(ImageLabels(name, (96, 72), (Mark(Kind.LIGHT, (5, 6)),)) for name in names)


def test_every_folder_is_a_drive_of_its_own(tmp_path: Path) -> None:
    """Also where their names differ by a slash, or only at their ends."""
    long = f"{'a' * 150}/{'b' * 150}"
    names = ("a/b/1.png", "a_b/1.png", f"{long}/1.png", f"{long}c/1.png", "1.png", "labels/1.png")
    write_labels_file(tmp_path / "labels.xml", LabelSet(images_at(tmp_path, names)), "cvat")
    source = LabelFile(tmp_path / "labels.xml")
    assert len({each.directory for each in source.sequences}) == len(names)
    assert [each.num_images for each in source.sequences] == [1] * len(names)
    write_split(source, tmp_path / "own")
    assert len(PVDN(tmp_path / "own").sequences) == len(names)


@pytest.mark.parametrize("kind", ["cvat", "coco", "label-studio"])
def test_labels_of_a_tool_in_another_tools_format_are_for_the_same_images(tmp_path: Path, kind: str) -> None:
    names = ("1.png", "a/b/2.png", "a/b/10.00\u202fPM.png")
    write_labels_file(tmp_path / "labels.xml", LabelSet(images_at(tmp_path, names)), "cvat")
    path = tmp_path / f"converted{LABEL_FORMATS[kind].suffix}"
    write_labels_file(path, labels_of(LabelFile(tmp_path / "labels.xml")), kind)
    source = LabelFile(path)
    assert {source.image_path(k).relative_to(tmp_path).as_posix() for k in source.frame_ids} == set(names)
    assert {source.image(k).file_name for k in source.frame_ids} == {"1.png", "2.png", "10.00\u202fPM.png"}


def test_recordings_in_one_video_are_drives_of_their_own(tmp_path: Path) -> None:
    """Two that were appended to each other: times begin anew, and no moment before is one of the first."""
    path = tmp_path / "two.ts"
    path.write_bytes(2 * make_stream(tmp_path / "first.ts"))  # 60 frames each, 25 a second
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (128, 96)) for number in (3, 58, 62, 80))
    write_labels_file(tmp_path / "labels.xml", LabelSet(images, is_video=True), "cvat")
    assert write_split(LabelFile(tmp_path / "labels.xml", path, on_error="mark"), tmp_path / "own") == 4
    own = PVDN(tmp_path / "own")
    assert [(each.directory, each.image_ids) for each in own.sequences] == [
        ("labels", (3, 58)), ("labels_frame_60", (62, 80)),
    ]  # fmt: skip
    assert [own.time_s(image_id) for image_id in own.frame_ids] == pytest.approx([0.0, 2.2, 0.0, 0.72])
    earlier = {frame.frame: frame.earlier for frame in own}
    assert {number: frame is not None for number, frame in earlier.items()} == {3: False, 58: True, 62: False, 80: True}


def test_photographs_are_no_moments_of_one_drive(tmp_path: Path) -> None:
    """None is what was there shortly before another, whether or not that has labels."""
    for number, minute in enumerate((0, 0, 1, 2, 3, 4, 5, 6, 7, 7)):
        make_photograph(tmp_path / f"{number}.jpg", f"2026:11:27 18:{minute:02d}:00", seed=number)
    height_px, width_px = read_image(tmp_path / "0.jpg").shape
    images = tuple(ImageLabels(f"{number}.jpg", (width_px, height_px)) for number in (0, 1, 5, 8, 9))
    write_labels_file(tmp_path / "labels.xml", LabelSet(images), "cvat")
    source = LabelFile(tmp_path / "labels.xml")
    assert [source.time_s(number) for number in source.frame_ids] == pytest.approx(
        [0, 1 / 18, 5 / 18 + 2, 8 / 18 + 4, 9 / 18 + 4]
    )
    assert all(frame.earlier is None for frame in source)
    maker = InputMaker(InputSpec(size_px=8, lag_s=0.25, num_features=7))
    boxes = Proposals(np.array([[1, 1, 9, 9]], np.int32))
    assert [maker.make(frame, boxes).features[0, 6] for frame in source] == [0] * 5
