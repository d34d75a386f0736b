"""Where the frames of a run came from, and what tells them from others."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from foreglow.datasets import PVDN, Equipped, open_source, shipped_drive
from foreglow.datasets.vehicle_data import VehicleData
from foreglow.pipeline import Pipeline
from foreglow.runs.origin import origin_digest, origin_name
from foreglow.runtime import run
from foreglow.runtime.live import Paced
from tests.cli.commands import PNG
from tests.datasets.tiny_pvdn import make_pvdn
from tests.stand_ins import REFERENCE, night_image


def images_at(path: Path) -> Path:
    path.mkdir()
    for number in range(2):
        (path / f"{number:06d}.png").write_bytes(PNG)
    return path


def split_at(path: Path) -> Path:
    return make_pvdn(path)


def video_at(path: Path) -> Path:
    path.write_bytes(PNG * 3)
    return path


@pytest.mark.parametrize("make", [images_at, split_at, video_at])
def test_a_copy_is_the_same_and_others_are_not(make: Callable[[Path], Path], tmp_path: Path) -> None:
    source = make(tmp_path / "source")
    digest = origin_digest(source)
    assert digest is not None
    elsewhere = tmp_path / "elsewhere"
    if source.is_file():
        shutil.copy(source, elsewhere)
        changed = elsewhere
    else:
        shutil.copytree(source, elsewhere)
        changed = next(elsewhere.rglob("*.png"))
        (elsewhere / "notes.txt").write_text("not an image")
    assert origin_digest(elsewhere) == digest
    changed.write_bytes(changed.read_bytes() + b"x")
    assert origin_digest(elsewhere) != digest


@pytest.mark.parametrize("num_images", [1, 3, 20])
def test_images_that_are_all_of_one_size_are_told_by_what_they_hold(num_images: int, tmp_path: Path) -> None:
    """As of another drive, whose images were written over those that a run was made from."""
    for number in range(num_images):
        assert cv2.imwrite(str(tmp_path / f"{number:06d}.pgm"), night_image(number))
    digest, sizes = origin_digest(tmp_path), {path.stat().st_size for path in tmp_path.iterdir()}
    for number in range(num_images):
        assert cv2.imwrite(str(tmp_path / f"{number:06d}.pgm"), night_image(100 + number))
    assert {path.stat().st_size for path in tmp_path.iterdir()} == sizes
    assert origin_digest(tmp_path) not in (digest, None)


def test_corrected_labels_are_no_other_images(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path / "split")
    digest = origin_digest(split)
    for labels in (split / "labels").rglob("*.json"):
        labels.write_text(labels.read_text() + " ")
    assert origin_digest(split) == digest
    labels_of_a_tool = tmp_path / "labels.json"
    labels_of_a_tool.write_text('{"images": [], "annotations": [], "categories": []}')
    assert origin_digest(labels_of_a_tool) is None


@pytest.mark.parametrize("text", ["camera:0", "rtsp://host/stream", "nowhere"])
def test_what_is_no_file_has_none(text: str) -> None:
    assert origin_digest(Path(text)) is None


def test_a_python_program_stores_the_path_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the name of the source, which may be that of another file in the working folder."""
    images = images_at(tmp_path / "night")
    (tmp_path / "else").mkdir()
    images_at(tmp_path / "else" / "night")
    monkeypatch.chdir(tmp_path / "else")
    for source in (open_source("../night"), Equipped(open_source(images), NoData())):
        assert Path(run(source, Pipeline(REFERENCE), None).source).resolve() == images
        assert Path(Paced(source).name).resolve() == images


class NoData(VehicleData):
    """A car that knew nothing."""

    def camera(self, frame: object) -> None: ...

    def motion(self, frame: object) -> None: ...

    def road(self, frame: object) -> None: ...


def test_a_split_goes_by_the_folder_that_was_given() -> None:
    part = shipped_drive() / "images" / "S00001"
    assert origin_name(PVDN(part)) == str(part)
