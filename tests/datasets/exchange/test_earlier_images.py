"""The image of a quarter of a second before, which labels of a part of a drive bring along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.classifier.inputs import InputMaker, InputSpec
from foreglow.datasets import PVDN, ImageFolder, Video, open_labelled, write_pvdn
from foreglow.datasets.exchange import (
    LabelFile,
    Mark,
    labels_of,
    write_labels_file,
    write_split,
)
from foreglow.datasets.exchange.marks import ImageLabels, Kind, LabelSet, marks_of
from foreglow.types import Proposals
from tests.datasets.video.test_video_file import make_video


def test_earlier_images_are_no_frames(tmp_path: Path) -> None:
    """A labelled part of a video as a data set, and that as a video's frames again: labels stay on their images."""
    clip = make_video(tmp_path / "clip.mp4")
    marks = {number: (Mark(Kind.LIGHT, (number, 8)),) for number in (2, 10, 16, 22)}
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (96, 72), found) for number, found in marks.items())
    write_labels_file(tmp_path / "a.xml", LabelSet(images, is_video=True), "cvat")
    write_split(LabelFile(tmp_path / "a.xml", clip), tmp_path / "own")
    folder = next((tmp_path / "own/images").iterdir())
    assert [path.name for path in folder.glob("*_earlier.png")] == ["000010_earlier.png"]
    beside = "earlier image, without labels, beside a labelled one"
    times = "sequence with attributes (weather, road, driver, times, ...)"
    assert dict(write_labels_file(tmp_path / "b.xml", labels_of(open_labelled(tmp_path / "own")), "cvat-video")) == {
        beside: 1,
        times: 1,
    }
    again = LabelFile(tmp_path / "b.xml", folder)
    assert not again.lost, "the set around the images says how old the earlier one is"
    (other := tmp_path / "other").mkdir()
    for path in folder.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    alone = LabelFile(tmp_path / "b.xml", other)
    assert alone.lost == labels_of(alone).lost == labels_of(alone, {2, 10}).lost == {beside: 1}
    assert not labels_of(alone, {2, 22}).lost
    write_split(again, tmp_path / "back")
    own, back = PVDN(tmp_path / "own"), PVDN(tmp_path / "back")
    assert back.frame_ids == own.frame_ids == tuple(marks)
    for image_id in own.frame_ids:
        frame, expected = back.read(image_id), own.read(image_id)
        assert frame.timestamp_ns == expected.timestamp_ns
        assert (frame.earlier is None) == (expected.earlier is None) == (image_id != 10)
        np.testing.assert_array_equal(frame.image, expected.image)
        if frame.earlier is not None and expected.earlier is not None:
            assert frame.earlier.timestamp_ns == expected.earlier.timestamp_ns
            np.testing.assert_array_equal(frame.earlier.image, expected.earlier.image)
        assert [mark.position_px for mark in marks_of(back.annotations(image_id)) if mark.kind == Kind.LIGHT] == [
            (image_id, 8)
        ]
    assert [frame.frame for frame in ImageFolder(folder)] == list(marks)


def test_the_earlier_image_of_a_frame_is_chosen_by_its_time(tmp_path: Path) -> None:
    """A phone's video has fewer frames a second where it is dark."""
    clip = make_video(tmp_path / "clip.mp4", times=[*range(12), *range(12, 36, 3)])
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (96, 72)) for number in (9, 15, 19))
    write_labels_file(tmp_path / "a.xml", LabelSet(images, is_video=True), "cvat")
    frames = list(LabelFile(tmp_path / "a.xml", clip))
    ages_s = [(each.timestamp_ns - each.earlier.timestamp_ns) / 1e9 for each in frames if each.earlier is not None]
    assert ages_s == pytest.approx([0.24, 0.24, 0.24])


def test_frames_of_a_video_keep_their_times_and_a_moment_of_the_past(tmp_path: Path) -> None:
    """Nobody labels every frame; what a classifier sees in the car is there all the same."""
    clip = make_video(tmp_path / "clip.mp4")  # 25 Hz, brighter by 8 levels a frame
    images = tuple(ImageLabels(f"frame_{number:06d}.png", (96, 72)) for number in (2, 10, 16, 22))
    write_labels_file(tmp_path / "a.xml", LabelSet(images, is_video=True), "cvat")
    write_split(LabelFile(tmp_path / "a.xml", clip), tmp_path / "own")
    own = PVDN(tmp_path / "own")
    assert own.frame_ids == (2, 10, 16, 22)
    assert [own.time_s(image_id) for image_id in own.frame_ids] == [0.0, 0.32, 0.56, 0.8]
    assert own.read(2).earlier is None  # the video begins too late
    assert own.read(16).earlier is None  # it is labelled itself, as frame 10
    assert own.read(22).earlier is None  # likewise, as frame 16
    now = own.read(10)
    before = now.earlier
    assert before is not None
    assert now.timestamp_ns - before.timestamp_ns == 240_000_000
    np.testing.assert_array_equal(before.image, next(f.image for f in Video(clip) if f.frame == 4))
    write_pvdn(own, tmp_path / "copy")
    copied = PVDN(tmp_path / "copy").read(10).earlier
    assert copied is not None
    np.testing.assert_array_equal(copied.image, before.image)
    maker = InputMaker(InputSpec(size_px=8, lag_s=0.25, num_features=7))
    boxes = Proposals(np.array([[10, 10, 30, 30]], np.int32))
    assert maker.make(now, boxes).features[0, 6] == 1  # whoever reads an image has the earlier one
    Path(before.path).unlink()
    with pytest.raises(
        FileNotFoundError,
        match=r"image_annotations\.json: image 10: earlier\.file_name: expected an image.*000010_earlier\.png",
    ):
        own.read(10)
