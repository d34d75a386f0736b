"""Labels of a drive of which some frames are damaged: those that have no labels do not matter."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import av
import cv2
import pytest

from foreglow.datasets import PVDN, shipped_drive
from foreglow.datasets.exchange import LabelFile, Mark, read_labels_file, write_labels_file
from foreglow.datasets.exchange.marks import ImageLabels, Kind, LabelSet
from foreglow.datasets.images import read_image
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.video.test_damage import packets_of

NUM_FRAMES = 24
LIGHT = (Mark(Kind.LIGHT, (9, 8), oid=1, iid=1),)


def done(*words: object) -> str:
    result = foreglow_command(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(name="film")
def fixture_film(tmp_path: Path) -> Path:
    """A drive in FFV1, every sixth frame a key frame, with a wrong bit in frames 8 and 15: 8 to 11 and 15 to 17."""
    path = tmp_path / "drive.mkv"
    images = sorted((shipped_drive() / "images").glob("*/*"))
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("ffv1", rate=18, options={"g": "6"})
        stream.width, stream.height, stream.pix_fmt = 640, 480, "gray"
        for index in range(NUM_FRAMES):
            image: Any = cv2.resize(read_image(images[index % len(images)]), (640, 480))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode(None))
    data = bytearray(path.read_bytes())
    for number in (8, 15):
        position, size = packets_of(path)[number]
        data[position + size // 2] ^= 0x10
    path.write_bytes(bytes(data))
    return path


def labels_at(path: Path, marks: Mapping[str, tuple[Mark, ...]], size_px: tuple[int, int]) -> Path:
    images = tuple(ImageLabels(name, size_px, found) for name, found in marks.items())
    write_labels_file(path, LabelSet(images), "cvat")
    return path


def frames_at(path: Path, *numbers: int, empty: tuple[int, ...] = ()) -> Path:
    """Labels of frames of the film; those of `empty` are listed without a point."""
    marks = {f"frame_{number:06d}.png": () if number in empty else LIGHT for number in sorted((*numbers, *empty))}
    return labels_at(path, marks, (640, 480))


@pytest.mark.parametrize("on_error", ["skip", "mark"])
def test_labels_of_a_run_that_went_over_damage(film: Path, on_error: str, tmp_path: Path) -> None:
    """What a run on a damaged film was corrected to becomes a data set, to which every run on it is compared."""
    run, guess, own = tmp_path / on_error, tmp_path / "guess.xml", tmp_path / "own"
    for each in ("skip", "mark"):
        done("run", film, "--out", tmp_path / each, "--on-error", each)
    said = done("labels", "export", film, "--run", run, "--out", guess)
    assert ("point in a damaged frame" in said) == (on_error == "mark")
    assert len(read_labels_file(guess).images) == {"skip": 17, "mark": 24}[on_error]
    assert not any(image.marks for image in read_labels_file(guess).images if image.name == "frame_000009.png")
    said = done("labels", "import", guess, "--images", film, "--out", own)
    assert said.startswith("17 images, ")
    first = f"{film}: frame 8: expected an undamaged frame, decoder reports damage"
    assert f"\n7 skipped as unreadable, the first: {first}\n" in said
    undamaged = {*range(NUM_FRAMES)} - {8, 9, 10, 11, 15, 16, 17}
    assert set(PVDN(own).frame_ids) == undamaged
    for each in ("skip", "mark"):
        figures = tmp_path / "figures.json"
        done("evaluate", own, "--predictions", tmp_path / each / "frames.jsonl", "--json", figures)
        assert json.loads(figures.read_text())["num_images"] == 17


def test_a_damaged_frame_with_labels_is_refused(film: Path, tmp_path: Path) -> None:
    """A frame that is only listed, as tools list all frames of a film, is passed over."""
    labels, out = tmp_path / "labels.xml", tmp_path / "own"
    frames_at(labels, 2, 9, 10, 20)
    said = complaint("labels", "import", labels, "--images", film, "--out", out)
    words = "expected an undamaged frame, decoder reports damage"
    assert f"{film}: frame 9: {words}; {labels} has labels of it; 1 more of its frames are missing" in said
    assert not list(out.rglob("*.*"))
    with pytest.raises(ValueError, match=f"frame 9: {words}; {re.escape(str(labels))} has labels of it"):
        LabelFile(labels, film).read(9)
    skipping = LabelFile(labels, film, on_error="skip")
    assert [frame.frame for frame in skipping] == [2, 20]
    assert [line.partition(":")[0] for line in skipping.skipped] == [str(film)] * 2
    marking = [(frame.frame, frame.is_damaged) for frame in LabelFile(labels, film, on_error="mark")]
    assert marking == [(2, False), (9, True), (10, True), (20, False)]
    frames_at(labels, 2, 20, empty=(3, 9, 10))
    said = done("labels", "import", labels, "--images", film, "--out", out)
    assert said.startswith("3 images, 0 vehicle points, 2 lights\n7 skipped as unreadable")
    assert "1 of the images has no point" in said
    assert PVDN(out).frame_ids == (2, 3, 20)


def test_labels_of_nothing_that_can_be_read(film: Path, tmp_path: Path) -> None:
    labels = frames_at(tmp_path / "labels.xml", empty=(9, 10))
    said = complaint("labels", "import", labels, "--images", film, "--out", tmp_path / "own")
    assert f"{labels}: expected at least one labelled image that can be read, found none" in said
    frames_at(labels, 2, 400)
    said = complaint("labels", "import", labels, "--images", film, "--out", tmp_path / "own")
    assert f"{film}: expected frame 400 as in {labels}, the video ends before; {film}: frame 8: " in said


def test_the_earlier_image_is_the_next_best_one(film: Path, tmp_path: Path) -> None:
    """A quarter of a second before frame 12 are frames 7 and 8, before 15 are 10 and 11: a run takes what it has."""
    frames = list(LabelFile(frames_at(tmp_path / "labels.xml", 12, 14), film))
    earlier = [None if frame.earlier is None else frame.earlier.path for frame in frames]
    assert earlier == [f"{film}, frame {number}" for number in (7, 7)]  # 8 to 11 are damaged, 12 is labelled


@pytest.mark.parametrize("in_split", [False, True])
def test_a_truncated_image_without_labels(tmp_path: Path, *, in_split: bool) -> None:
    folder = tmp_path / "drive"
    if in_split:
        shutil.copytree(shipped_drive(), tmp_path / "set")
        folder = next((tmp_path / "set" / "images").iterdir())
    else:
        shutil.copytree(next((shipped_drive() / "images").iterdir()), folder)
    now = max(folder.iterdir())
    height_px, width_px = read_image(now).shape
    labels = labels_at(tmp_path / "labels.xml", {now.name: LIGHT}, (width_px, height_px))
    whole = next(iter(LabelFile(labels, folder))).earlier
    assert whole is not None
    broken = Path(whole.path)
    broken.write_bytes(broken.read_bytes()[:300])
    said = done("labels", "import", labels, "--images", folder, "--out", tmp_path / "own")
    assert f"\n1 skipped as unreadable, the first: {broken}: " in said
    found = PVDN(tmp_path / "own").read(PVDN(tmp_path / "own").frame_ids[0])
    assert found.earlier is not None
    assert 0 < abs(found.earlier.timestamp_ns - whole.timestamp_ns) < 0.1e9
    labels_at(labels, {now.name: LIGHT, broken.name: ()}, (width_px, height_px))
    said = complaint("labels", "import", labels, "--images", folder, "--out", tmp_path / "other")
    assert f"{broken}: " in said
    assert f"; {labels} has labels of it" in said


def test_a_truncated_earlier_image_of_a_set(film: Path, tmp_path: Path) -> None:
    """The set around the images knows no other image of then, so that there is none."""
    labels, own = frames_at(tmp_path / "labels.xml", 7, 20), tmp_path / "own"
    done("labels", "import", labels, "--images", film, "--out", own)
    done("labels", "export", own, "--out", tmp_path / "again.xml")
    folder = next((own / "images").iterdir())
    broken = folder / "000020_earlier.png"
    broken.write_bytes(broken.read_bytes()[:300])
    said = done("labels", "import", tmp_path / "again.xml", "--images", own / "images", "--out", tmp_path / "copy")
    assert f"\n1 skipped as unreadable, the first: {broken}: " in said
    found = PVDN(tmp_path / "copy")
    assert [found.read(image_id).earlier is None for image_id in found.frame_ids] == [False, True]
