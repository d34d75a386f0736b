"""Searches on data that nobody has labelled."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foreglow.datasets import split_folder
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.night_set import make_night_set

pytestmark = [pytest.mark.torch, pytest.mark.slow]  # Optuna comes with the same extra


@pytest.mark.parametrize("split", ["train", "val"])
def test_nothing_is_chosen_by_images_that_nobody_has_labelled(split: str, tmp_path: Path) -> None:
    """Boxes without any light would be rated by their number alone, and the report would say nothing."""
    data = make_night_set(tmp_path / "data", ("train", "val", "test"), num_images=2)
    unlabel(split_folder(data, split))  # type: ignore[arg-type]
    line = complaint("tune", data, "--out", tmp_path / "out", "--trials", 2)
    assert f"night/{split}: expected labelled light to choose and judge by, found no key point in 4 of its 4 im" in line


def test_figures_of_a_test_split_that_nobody_has_labelled_are_dashes(tmp_path: Path) -> None:
    data = make_night_set(tmp_path / "data", ("train", "val", "test"), num_images=2)
    unlabel(split_folder(data, "test"))
    done = foreglow_command("tune", data, "--out", tmp_path / "out", "--trials", 2)
    assert done.exit_code == 0, done.output
    assert "test: q – (paper –), R – (paper –), boxes an image " in done.stdout


def unlabel(root: Path) -> None:
    for path in (root / "labels/keypoints").iterdir():
        path.write_text(json.dumps(json.loads(path.read_text()) | {"annotations": []}))
