"""A copy of PVDN is counted against what its authors state."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.datasets.pvdn import download
from foreglow.datasets.pvdn.download import PVDN_COUNTS, count_pvdn
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import IDS, make_pvdn

NUM_SCENES, NUM_IMAGES = len(IDS), sum(map(len, IDS.values()))


def test_the_splits_add_up_to_what_the_paper_states() -> None:
    scenes, images = (sum(column) for column in zip(*PVDN_COUNTS.values(), strict=True))
    assert (scenes, images) == (346, 59_746)


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A whole copy of a smaller data set: two splits, each of two scenes and five images."""
    stated = dict.fromkeys(("day/val", "night/val"), (NUM_SCENES, NUM_IMAGES))
    monkeypatch.setattr(download, "PVDN_COUNTS", stated)
    for cycle in ("day", "night"):
        make_pvdn(tmp_path, cycle)
    return tmp_path


def test_a_whole_copy_lacks_nothing(copy: Path) -> None:
    for found in count_pvdn(copy):
        assert (found.num_scenes, found.num_images, found.missing) == (NUM_SCENES, NUM_IMAGES, ())
    result = foreglow_command("download", "pvdn", "--check", copy)
    assert result.exit_code == 0
    assert "nothing is missing" in result.stdout


def test_what_is_missing_is_named(copy: Path) -> None:
    image = next((copy / "day/val/images/S00003").iterdir())
    image.unlink()
    (copy / "day/val/labels/keypoints/000007.json").unlink()
    (copy / "night/val/labels/sequences.json").unlink()
    day, night = count_pvdn(copy)
    assert (day.num_images, night.num_images) == (NUM_IMAGES - 1, 0)
    assert day.missing == (
        f"{copy}/day/val: 1 images missing, the first is images/S00003/{image.name}",
        f"{copy}/day/val: 1 files of key points missing, the first is labels/keypoints/000007.json",
    )
    assert "sequences.json: no such file" in night.missing[0]
    result = foreglow_command("download", "pvdn", "--check", copy)
    assert result.exit_code == 2
    assert day.missing[0] in result.stdout


def test_fewer_scenes_and_images_than_stated(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(download, "PVDN_COUNTS", {"day/val": (9, 99)})
    (found,) = count_pvdn(copy)
    assert found.missing == (
        f"{copy}/day/val: expected 9 scenes in the labels, got {NUM_SCENES}",
        f"{copy}/day/val: expected 99 images in the labels, got {NUM_IMAGES}",
    )


def test_a_folder_that_is_no_copy(tmp_path: Path) -> None:
    assert f"{tmp_path}: expected a copy of PVDN" in complaint("download", "pvdn", "--check", tmp_path)
    assert "expected --out or --check" in complaint("download", "pvdn", "--check", tmp_path, "--out", tmp_path / "new")
