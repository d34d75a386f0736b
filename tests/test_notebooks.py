"""The notebooks run from the first cell to the last, in an empty folder, and hold no outputs."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets import PVDN, shipped_drive
from tests.cli.commands import foreglow_command

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def code_of(notebook: Any) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_outputs(path: Path) -> None:
    for cell in read(path)["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.torch
@pytest.mark.slow
def test_own_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands run in this process, and it learns for one epoch instead of four."""

    def run(command: str) -> None:
        result = foreglow_command(*shlex.split(command)[1:])
        assert result.exit_code == 0, result.output

    (path,) = (path for path in NOTEBOOKS if path.stem == "own_drive")
    monkeypatch.setattr("foreglow.lab.learning.fine_tuning.MAX_LOSS", 1.0)  # nothing is moved back and judged again
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for number, code in enumerate(code_of(read(path))):
        quick = code.replace("--epochs 4", "--epochs 1")
        exec(compile(quick, f"{path.name}, code cell {number}", "exec"), names)
        names["run"] = run
    assert len(names["results"]) == len(PVDN(shipped_drive()))
    assert names["summary"]["num_epochs"] == 1
    assert set(names["summary"]["before_and_after"]) == {"own/val", "what it knew before"}
    assert Path("after/frames.jsonl").is_file()
