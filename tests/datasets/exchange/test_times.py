"""When labelled images were taken, where only some images of a drive are labelled."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import PVDN, ImageFolder, open_labelled
from foreglow.datasets.exchange import LabelFile, write_labels_file, write_split
from foreglow.datasets.exchange.marks import ImageLabels, LabelSet
from tests.datasets.tiny_pvdn import edit, make_pvdn
from tests.datasets.video.test_video_file import make_video


def folder_of(path: Path, numbers: list[int]) -> Path:
    """Images that are as bright as their numbers say."""
    path.mkdir(parents=True)
    for number in numbers:
        assert cv2.imwrite(str(path / f"{number:06d}.png"), np.full((72, 96), number, np.uint8))
    return path


def labels_of(path: Path, names: list[str]) -> Path:
    write_labels_file(path, LabelSet(tuple(ImageLabels(name, (96, 72)) for name in names)), "cvat")
    return path


def test_labels_of_some_images_of_a_folder_have_the_times_of_a_run_on_it(tmp_path: Path) -> None:
    """Nobody labels all images of a drive: those in between took their time, and the classifier sees one of them."""
    drive = folder_of(tmp_path / "drive", [number for number in range(40, 80) if number != 61])
    chosen = [46, 57, 62, 70]
    file = labels_of(tmp_path / "a.xml", [f"drive/{number:06d}.png" for number in chosen])
    labels = open_labelled(file)
    assert labels.frame_ids == tuple(chosen)
    in_run = {frame.frame: frame.timestamp_ns for frame in ImageFolder(drive)}
    frames = list(labels)
    assert [frame.timestamp_ns for frame in frames] == [in_run[number] for number in chosen]
    assert [labels.time_s(number) for number in chosen] == pytest.approx([0.0, 11 / 18, 16 / 18, 24 / 18])
    assert labels.mean_rate_hz == pytest.approx(3 / (24 / 18))
    earlier = [frame.earlier for frame in frames]
    assert [None if each is None else int(each.image[0, 0]) for each in earlier] == [41, 52, None, 66]  # 57 is labelled
    assert earlier[0] is not None
    assert frames[0].timestamp_ns - earlier[0].timestamp_ns == pytest.approx(5e9 / 18, abs=1)
    part = list(labels.with_images({62}))
    assert part[0].earlier is not None, "what is not selected is not seen before"
    assert isinstance(labels, LabelFile)
    write_split(labels, tmp_path / "own")
    own = PVDN(tmp_path / "own")
    assert [own.time_s(number) for number in chosen] == pytest.approx([0.0, 11 / 18, 16 / 18, 24 / 18], abs=1e-3)
    times_ns = [frame.timestamp_ns for frame in own]
    assert times_ns == pytest.approx([in_run[number] for number in chosen], abs=1e6), "as a log of the drive has them"
    kept = [own.read(number).earlier for number in chosen]
    assert [None if each is None else int(each.image[0, 0]) for each in kept] == [41, 52, None, 66]


def test_each_folder_has_times_of_its_own(tmp_path: Path) -> None:
    folder_of(tmp_path / "S00001", list(range(10)))
    folder_of(tmp_path / "S00002", list(range(20, 30)))
    names = ["S00001/000003.png", "S00001/000009.png", "S00002/000022.png", "S00002/000028.png"]
    labels = open_labelled(labels_of(tmp_path / "a.xml", names))
    assert [labels.time_s(number) for number in (3, 9, 22, 28)] == pytest.approx([0.0, 6 / 18, 0.0, 6 / 18])
    assert [frame.timestamp_ns for frame in labels] == [166666667, 500000000, 111111111, 444444444]


def test_an_earlier_image_of_another_size_is_none(tmp_path: Path) -> None:
    drive = folder_of(tmp_path / "drive", list(range(10)))
    assert cv2.imwrite(str(drive / "000001.png"), np.zeros((64, 96), np.uint8))
    (frame,) = open_labelled(labels_of(tmp_path / "a.xml", ["drive/000005.png"]))
    assert frame.earlier is not None
    (frame,) = open_labelled(labels_of(tmp_path / "b.xml", ["drive/000006.png"]))
    assert frame.earlier is None


def test_images_without_numbers_have_the_order_of_their_names(tmp_path: Path) -> None:
    """Also where those of other folders have the same names, and the file has them in another order."""
    for folder in ("S00001", "S00002"):
        folder_of(tmp_path / folder, list(range(4)))
        for number in range(4):
            (tmp_path / folder / f"{number:06d}.png").rename(tmp_path / folder / f"{'dcba'[number]}.png")
    names = ["S00001/d.png", "S00001/a.png", "S00002/a.png", "S00002/d.png"]
    labels = open_labelled(labels_of(tmp_path / "a.xml", names))
    assert [labels.time_s(number) for number in range(4)] == pytest.approx([0.0, 3 / 18, 0.0, 3 / 18])


def test_images_that_were_chosen_here_and_there_have_no_earlier_ones(tmp_path: Path) -> None:
    """Nobody knows their times, and what comes before one in the folder may show another place."""
    folder_of(tmp_path / "drive", [3, 57, 60, 61, 90, 120, 200])
    labels = open_labelled(labels_of(tmp_path / "a.xml", ["drive/000120.png", "drive/000200.png"]))
    assert [labels.time_s(number) for number in (120, 200)] == pytest.approx([0.0, 1 / 18])
    assert [frame.earlier for frame in labels] == [None, None]


def test_labels_of_some_frames_of_a_video_are_as_far_apart_as_these(tmp_path: Path) -> None:
    clip = make_video(tmp_path / "clip.mp4")  # 25 Hz
    names = ["frame_000002.png", "frame_000012.png", "frame_000022.png"]
    labels = LabelFile(labels_of(tmp_path / "a.xml", names), clip)
    assert [labels.time_s(number) for number in (2, 12, 22)] == pytest.approx([0.0, 0.4, 0.8])
    assert labels.mean_rate_hz == pytest.approx(2.5)
    assert [None if each.earlier is None else each.earlier.frame for each in labels] == [None, 6, 16]


def test_in_a_pause_nobody_looks(tmp_path: Path) -> None:
    """Minutes of drives are those of their images: what lies between two labelled stretches is none of them."""
    folder_of(tmp_path / "drive", list(range(200)))
    stretches = [*range(20), *range(180, 200)]
    labels = open_labelled(labels_of(tmp_path / "a.xml", [f"drive/{number:06d}.png" for number in stretches]))
    assert labels.time_s(180) == pytest.approx(10.0)
    assert labels.mean_rate_hz == 18.0
    few = open_labelled(labels_of(tmp_path / "b.xml", [f"drive/{number:06d}.png" for number in (0, 27, 54, 108)]))
    assert few.mean_rate_hz == pytest.approx(3 / 6)  # steps of 1.5 and 3 s, but each is about as long as the others


def test_images_of_a_set_have_its_times_and_rate(tmp_path: Path) -> None:
    """A set of 6 images a second, as its labels are corrected once more."""
    root = make_pvdn(tmp_path / "set")
    edit(root / "labels/image_annotations.json", "info", value={"rate_hz": 6.0})
    for index in range(5):
        edit(root / "labels/image_annotations.json", "images", index, "timestamp", value=None)
    known = open_labelled(root)
    for images, path in ((root / "images", tmp_path / "all.xml"), (root / "images/S00003", tmp_path / "one.xml")):
        found = known if images.name == "images" else known.only("S00003")
        names = [found.image_path(image_id).relative_to(images).as_posix() for image_id in found.frame_ids]
        labels = LabelFile(labels_of(path, names), images)
        assert labels.rate_hz == 6.0
        assert [frame.timestamp_ns for frame in labels] == [frame.timestamp_ns for frame in found]
        assert [labels.time_s(k) for k in labels.frame_ids] == pytest.approx([found.time_s(k) for k in found.frame_ids])
        write_split(labels, tmp_path / path.stem)
        again = PVDN(tmp_path / path.stem)
        assert again.rate_hz == 6.0
        assert [frame.timestamp_ns for frame in again] == [frame.timestamp_ns for frame in found]
