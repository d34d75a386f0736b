"""`foreglow fit-ranges`: the model that it writes is one that `run` takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.datasets import shipped_drive
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.shipped_splits import make_shipped_splits


@pytest.mark.torch
def test_a_fitted_model_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foreglow.lab.learning.ranges.EPOCHS", 1)
    make_shipped_splits(tmp_path / "data")
    model, settings, out = tmp_path / "ranges.toml", tmp_path / "settings.toml", tmp_path / "out"
    result = foreglow_command("fit-ranges", tmp_path / "data", "--out", model)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"wrote {model}: fitted to ")
    settings.write_text(f'[distance]\nmodel = "{model}"\n')
    result = foreglow_command("run", shipped_drive(), "--out", out, "--config", settings, "--limit", 3)
    assert result.exit_code == 0, result.output
    assert f'model = "{model}"' in (out / "config.toml").read_text()


def test_bad_input(tmp_path: Path) -> None:
    model = tmp_path / "ranges.toml"
    assert "no such" in complaint("fit-ranges", tmp_path / "absent", "--out", model)
    assert not model.exists()
    settings = tmp_path / "settings.toml"
    settings.write_text(f'[distance]\nmodel = "{model}"\n')
    line = complaint("run", shipped_drive(), "--out", tmp_path / "out", "--config", settings)
    assert "ranges.toml: no such" in line
    model.write_text("kinds = 3\n")
    line = complaint("run", shipped_drive(), "--out", tmp_path / "out", "--config", settings)
    assert "ranges.toml: kinds: " in line
    assert not (tmp_path / "out").exists()
