"""The drive that ships: whole, small, readable by everything, and worth seeing."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.calibration import read_calibration
from foreglow.datasets import PVDN, open_source, shipped_drive
from foreglow.datasets.pvdn.schema import Cycle
from foreglow.datasets.simulated import read_truth
from foreglow.lab.evaluation.boxes.lights import read_lights
from foreglow.lab.simulation import read_scene
from foreglow.lab.simulation.writing.scene_files import scene_of


@pytest.fixture(scope="module")
def drive() -> PVDN:
    return PVDN(shipped_drive())


def test_it_is_small_and_whole(drive: PVDN) -> None:
    files = [path for path in shipped_drive().rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 10_000_000
    assert (drive.num_frames, drive.rate_hz) == (90, 18.0)
    assert len([path for path in files if path.suffix == ".jpg"]) == 90
    for image_id in drive.frame_ids[::15]:
        assert (drive.read(image_id).width_px, drive.read(image_id).height_px) == (1280, 960)
        assert drive.cycle_of(image_id) is Cycle.DAY
    for image_id in drive.frame_ids:
        assert drive.image_path(image_id).is_file()


def test_a_command_takes_it_as_a_source() -> None:
    source = open_source(shipped_drive())
    assert (source.name, source.num_frames) == ("shipped_drives/curve", 90)


def test_its_truth_is_that_of_its_scene(drive: PVDN) -> None:
    (truth,) = read_truth(drive.root)
    assert scene_of(truth) == read_scene(drive.root / "scene.toml")
    assert (truth.camera.width_px, truth.camera.height_px) == (1280, 960)
    assert [frame.image_id for frame in truth.frames] == list(drive.frame_ids)
    with pytest.raises(FileNotFoundError):
        truth.depth_m(drive.frame_ids[0])


def test_light_comes_a_second_before_the_car_after_a_calm_beginning(drive: PVDN) -> None:
    lights = [light for its in read_lights(drive).values() for light in its]
    first_light, first_lamp = (
        min(drive.time_s(light.image_id) for light in lights if light.is_direct is is_direct)
        for is_direct in (False, True)
    )
    assert 1.5 <= first_light <= 2.0
    assert 1.0 <= first_lamp - first_light <= 1.5
    assert max(map(drive.time_s, drive.frame_ids)) - first_lamp > 1.5


def test_an_unknown_drive_is_named() -> None:
    with pytest.raises(FileNotFoundError, match="no such drive"):
        shipped_drive("nowhere")


def test_nothing_in_it_points_to_where_it_was_made() -> None:
    for path in shipped_drive().rglob("*"):
        if path.suffix in (".json", ".jsonl", ".toml", ".md"):
            assert str(Path.home()) not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("shape", ["half", "other"])
def test_images_of_another_size_have_the_calibration_scaled(tmp_path: Path, shape: str) -> None:
    """Whoever halves a data set's images need not know of its calibration."""
    split = tmp_path / "val"
    shutil.copytree(shipped_drive(), split)
    path = split / "simulation" / "S00001" / "camera.toml"
    labels = split / "labels" / "image_annotations.json"
    size_px = (640, 480) if shape == "half" else (640, 400)
    file = json.loads(labels.read_text())
    for image in file["images"]:
        image["width"], image["height"] = size_px
    labels.write_text(json.dumps(file))
    first = min((split / "images" / "S00001").iterdir())
    cv2.imwrite(str(first), np.full(size_px[::-1], 20, np.uint8))
    if shape == "other":
        words = f"{path}: image: expected the frames' size or its multiple, 640x400 px, got 1280x960 px"
        with pytest.raises(ValueError, match=re.escape(words)):
            next(iter(open_source(split)))
        return
    camera, whole = next(iter(open_source(split))).camera, read_calibration(path)
    assert camera is not None
    assert (camera.width_px, camera.height_px) == size_px
    assert camera.focal_px[0] == pytest.approx(whole.focal_px[0] / 2)
