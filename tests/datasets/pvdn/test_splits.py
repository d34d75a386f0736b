"""Finding the splits of a data set."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.datasets import open_labelled, open_source, shipped_drive, split_folder, split_in
from foreglow.datasets.pvdn.splits import found_name
from foreglow.lab.learning.annotation import splits_to_annotate


def make_split(path: Path) -> Path:
    (path / "labels").mkdir(parents=True)
    (path / "labels" / "sequences.json").write_text("{}")
    return path


def test_split_beside_others(tmp_path: Path) -> None:
    make_split(tmp_path / "train")
    assert split_folder(tmp_path, "train") == tmp_path / "train"


def test_split_of_the_only_cycle(tmp_path: Path) -> None:
    make_split(tmp_path / "day" / "val")
    assert split_folder(str(tmp_path), "val") == tmp_path / "day" / "val"


def test_several_cycles_are_named(tmp_path: Path) -> None:
    for cycle in ("day", "night"):
        make_split(tmp_path / cycle / "val")
    with pytest.raises(ValueError, match=r"expected a single split val.*day.*night"):
        split_folder(tmp_path, "val")


def test_missing_split_or_folder(tmp_path: Path) -> None:
    make_split(tmp_path / "day" / "val")
    with pytest.raises(FileNotFoundError, match="split test"):
        split_folder(tmp_path, "test")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        split_folder(tmp_path / "nowhere", "test")


def test_a_split_itself_or_one_of_a_data_set(tmp_path: Path) -> None:
    split = make_split(tmp_path / "night" / "val")
    assert split_in(split, "test") == split_in(split, "val") == split
    with pytest.raises(ValueError, match=r"split: expected a whole data set with train, .* is a single split"):
        split_in(split, "train")
    assert split_in(tmp_path, "val") == split
    with pytest.raises(FileNotFoundError, match="expected the split test in it"):
        split_in(tmp_path, "test")


def test_what_a_path_stands_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    split = make_split(tmp_path / "night" / "val")
    (split / "images" / "S00001").mkdir(parents=True)
    assert found_name(tmp_path) == found_name(split) == str(split)
    assert found_name(split / "images" / "S00001") == str(split / "images" / "S00001")
    monkeypatch.chdir(tmp_path)
    assert found_name(Path()) == "night/val"
    monkeypatch.chdir(split)
    assert found_name(Path()) == str(split.resolve())
    assert found_name(Path("labels.json")) == "labels.json"


@pytest.mark.parametrize("inner", ["", "day", "day/train"])
def test_a_simulation_that_was_interrupted_is_named_as_such(inner: str, tmp_path: Path) -> None:
    """It was "no such file" of a label file, or a folder without images."""
    split = tmp_path / "day/train"
    (split / "simulation").mkdir(parents=True)
    (split / "simulation/info.json").write_text("{}")
    expected = pytest.raises(FileNotFoundError, match="day/train: expected a simulated data set that is complete")
    for read in (open_source, open_labelled, splits_to_annotate):
        with expected:
            read(tmp_path / inner)
    if inner != "day/train":
        with expected:
            split_folder(tmp_path / inner, "train")
    (tmp_path / inner / "1.png").write_bytes(next(shipped_drive().glob("images/*/*")).read_bytes())
    assert open_source(tmp_path / inner).num_frames == 1, "images of one's own beside it"
