"""The program itself: usage, version, errors, missing extras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

import foreglow
from tests.cli.commands import complaint, foreglow_command, names


@pytest.mark.parametrize("arguments", [["run"], ["walk"], ["run", "a", "--out", "b", "--limit", "0"]])
def test_usage_errors_have_exit_code_2(arguments: Sequence[str]) -> None:
    assert foreglow_command(*arguments).exit_code == 2


def test_debug_shows_the_error_itself(tmp_path: Path) -> None:
    result = foreglow_command("--debug", "run", tmp_path / "absent", "--out", tmp_path / "out")
    assert isinstance(result.exception, FileNotFoundError)


def test_version() -> None:
    assert foreglow_command("--version").stdout == f"foreglow {foreglow.__version__}\n"


def test_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def import_weights(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr("foreglow.lab.learning.import_weights", import_weights)
    line = complaint("import-weights", tmp_path / "weights.pt", "--out", tmp_path / "model.onnx")
    assert "pip install 'foreglow[train]'" in line


@pytest.mark.torch
def test_import_of_weights_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "weights.pt").write_bytes(b"no weights")
    line = complaint("import-weights", tmp_path / "weights.pt", "--out", tmp_path / "model.onnx")
    assert "weights.pt" in line
    assert names(tmp_path) == {"weights.pt"}
