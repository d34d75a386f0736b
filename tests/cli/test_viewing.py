"""`--view` and `--save`, as a user types them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("rerun")

from foreglow.datasets import shipped_drive
from foreglow.display.viewer import outputs
from tests.cli.commands import RESULTS, complaint, foreglow_command, names
from tests.display.viewer.recordings import Recording


@pytest.mark.slow
def test_run_is_kept_as_a_recording(tmp_path: Path) -> None:
    for name, options in (("with", ["--save", tmp_path / "run.rrd"]), ("without", [])):
        arguments = ["run", shipped_drive(), "--out", tmp_path / name, "--limit", 4, *options]
        result = foreglow_command(*arguments)
        assert result.exit_code == 0, result.output
        assert names(tmp_path / name) == RESULTS
    found = Recording(tmp_path / "run.rrd")
    assert len(found.values("/camera/image", "EncodedImage:blob")) == 4
    assert len(found.values("/plots/lux/car\\ 0", "Scalars:scalars")) == 4
    texts = [(tmp_path / name / "frames.jsonl").read_text().splitlines() for name in ("with", "without")]
    for ours, theirs in ((json.loads(each), json.loads(other)) for each, other in zip(*texts, strict=True)):
        assert ours == theirs  # to look changes nothing


@pytest.mark.slow
def test_beam_is_kept_as_a_recording(tmp_path: Path) -> None:
    result = foreglow_command("beam", shipped_drive(), "--out", tmp_path, "--limit", 3, "--save", tmp_path / "beam.rrd")
    assert result.exit_code == 0, result.output
    assert len(Recording(tmp_path / "beam.rrd").values("/lamps/left", "Image:buffer")) == 3


def test_a_window_that_is_closed_at_once(
    tmp_path: Path, folder: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(outputs, "viewer_command", lambda: ["true"])
    result = foreglow_command("run", folder, "--out", tmp_path / "out", "--config", config, "--view")
    assert result.exit_code == 0, result.output
    assert names(tmp_path / "out") == RESULTS


def test_without_a_display(tmp_path: Path, folder: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--view")
    assert "--save FILE.rrd" in line
    assert not (tmp_path / "out").exists()


def test_a_recording_that_cannot_be_written(tmp_path: Path, folder: Path, config: Path) -> None:
    path = tmp_path / "run.mcap"
    assert f"{path}: expected a file whose name ends with .rrd" in complaint(
        "run", folder, "--out", tmp_path / "out", "--config", config, "--save", path
    )
    path = tmp_path / "nowhere" / "run.rrd"
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--save", path)
    assert f"{path}: No such file or directory" in line
    assert not (tmp_path / "out").exists()


def test_a_failed_run_leaves_no_recording(tmp_path: Path, folder: Path, config: Path) -> None:
    (folder / "000002.png").write_text("no image")
    complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--save", tmp_path / "run.rrd")
    assert not [path for path in tmp_path.iterdir() if "rrd" in path.name]


def test_without_rerun(tmp_path: Path, folder: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [module for module in sys.modules if module == "rerun" or module.startswith("foreglow.display.viewer")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rerun", None)
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--save", tmp_path / "run.rrd")
    assert "pip install 'foreglow[view]'" in line
