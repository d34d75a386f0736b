"""Running the command line in a test, and looking at what it wrote."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
from typer.testing import CliRunner, Result

from foreglow.cli import app
from tests.stand_ins import night_image

RESULTS = {"frames.jsonl", "times.jsonl", "summary.json", "config.toml"}


PNG = cv2.imencode(".png", night_image())[1].tobytes()


def foreglow_command(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def complaint(*arguments: object) -> str:
    """The one line on stderr of a command that must fail with exit code 2."""
    result = foreglow_command(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("foreglow: ")
    return result.stderr


def names(path: Path) -> set[str]:
    return {entry.name for entry in path.iterdir()}


def num_lines(path: Path) -> int:
    return len((path / "frames.jsonl").read_text().splitlines())


def without_digest(run: Path) -> None:
    """Makes the run in a folder one of an earlier version: it does not say by what its source and frames are known."""
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(summary | {"source_digest": None, "frames_sha256": None}))
