"""Results of a search that a user has changed since stay as they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

pytest.importorskip("optuna")

from foreglow.lab.learning.tuning import TuningSettings, tune
from foreglow.lab.reports.tuning_page import write_report
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.night_set import make_night_set

pytestmark = [pytest.mark.torch, pytest.mark.slow]  # Optuna comes with the same extra


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_night_set(tmp_path_factory.mktemp("data"), ("train",))


CHANGED = ["best.toml", "trials.csv", "summary.json", "report.md", "parallel.png", "importance.png"]
"""What a search writes at its end; with few trials, the last is not of it."""


def test_results_that_a_user_has_changed_stay(data: Path, tmp_path: Path) -> None:
    """They were replaced without a word, best.toml too, which people adjust by hand."""
    out = tmp_path / "out"
    command = ("tune", data, "--images", 4, "--out", out, "--trials")
    assert foreglow_command(*command, 2).exit_code == 0
    for name in CHANGED:
        made = (out / name).read_bytes() if (out / name).exists() else b""
        (out / name).write_bytes(made + b"# mine\n")
        before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
        line = complaint(*command, 3)
        assert f"{out / name}: expected the file as this command wrote it" in line
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before  # no trial, either
        (out / name).write_bytes(made) if made else (out / name).unlink()
    (out / "report.md").unlink()
    done = foreglow_command(*command, 3)
    assert done.exit_code == 0, done.output
    assert len((out / "trials.csv").read_text().splitlines()) == 4
    assert (out / "report.md").is_file()
    (out / "checksums.json").unlink()
    assert "expected the file as this command wrote it" in complaint(*command, 4)


def test_a_result_that_is_changed_during_a_search_stays(data: Path, tmp_path: Path) -> None:
    found = tune(data, tmp_path, TuningSettings(num_trials=1, num_images=4))
    write_report(dataclasses.replace(found, importances={"kappa": 1.0}), tmp_path)
    for name in ("best.toml", "importance.png"):
        made = (tmp_path / name).read_bytes()
        (tmp_path / name).write_text("mine")
        with pytest.raises(ValueError, match=f"{name}: expected the file as this command wrote it"):
            write_report(dataclasses.replace(found, importances={}), tmp_path)
        assert (tmp_path / name).read_text() == "mine"
        (tmp_path / name).write_bytes(made)
    write_report(dataclasses.replace(found, importances={}), tmp_path)
    assert not (tmp_path / "importance.png").exists()
