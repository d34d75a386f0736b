"""Labels that somebody has corrected stay, when `simulate` is called again."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from tests.lab.simulation.stub_drive import drive, scene

pytestmark = pytest.mark.slow

SCENES = [scene(1), scene(2, num_frames=2)]


def contents(folder: Path) -> dict[Path, bytes]:
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set made in one go."""
    folder = tmp_path_factory.mktemp("whole") / "DATA"
    simulate_dataset(folder, SCENES, drive)
    return folder


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("keypoints/020001.json", '"pos": [', '"pos": [\n 1, '),
        ("keypoints/020000.json", '"image_id": ', '"note": "mine", "image_id": '),
        ("sequences.json", '"weather": ', '"weather": 1'),
        ("sequences.json", "{", ""),
        ("image_annotations.json", '"timestamp": ', '"timestamp": 1'),
        ("image_annotations.json", '"annotations": [', '"annotations": [{"id": 99}, '),
    ],
)
@pytest.mark.parametrize("lost", [None, "images/S00002/020001.png"])
def test_labels_that_were_corrected_since_stay(
    name: str, old: str, new: str, lost: str | None, whole: Path, tmp_path: Path
) -> None:
    """They were made again without a word; also with a drive that is made again."""
    root = Path(shutil.copytree(whole, tmp_path / "DATA")) / "night/train"
    path = root / "labels" / name
    before = path.read_text()
    path.write_text(changed := before.replace(old, new, 1))
    if lost is not None:
        (root / lost).unlink()
    for _ in range(2):
        with pytest.raises(ValueError, match=rf"{re.escape(str(path))}: expected the labels that simulate wrote, got "):
            simulate_dataset(tmp_path / "DATA", SCENES, drive)
        assert path.read_text() == changed != before
    path.unlink()
    simulate_dataset(tmp_path / "DATA", SCENES, drive)
    assert contents(tmp_path / "DATA") == contents(whole)


def test_corrected_labels_are_told_before_anything_is_driven(tmp_path: Path) -> None:
    simulate_dataset(tmp_path, SCENES[:1], drive)
    path = tmp_path / "night/train/labels/keypoints/010001.json"
    path.write_text("{}")
    driven: list[int] = []

    def noted(given: Scene) -> Iterator[DriveFrame]:
        driven.append(given.seed)
        return drive(given)

    with pytest.raises(ValueError, match=r"010001.json: expected the labels that simulate wrote"):
        simulate_dataset(tmp_path, SCENES, noted)
    assert not driven


def test_labels_that_are_as_they_were_are_not_written_again(tmp_path: Path) -> None:
    """`annotate` goes by their times."""
    simulate_dataset(tmp_path, SCENES, drive)
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "night/train/labels").rglob("*.json")}
    simulate_dataset(tmp_path, SCENES, drive)
    assert {path: path.stat().st_mtime_ns for path in times} == times
