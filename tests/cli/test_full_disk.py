"""Commands that write several files: on a full disk, all of them are as they were."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import pytest

from foreglow import whole_files
from foreglow.datasets import shipped_drive
from tests.cli.commands import foreglow_command

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", name="run")
def fixture_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("full_disk") / "run"
    assert foreglow_command("run", shipped_drive(), "--out", out).exit_code == 0
    return out


def evaluated(run: Path, out: Path) -> tuple[object, ...]:
    outputs = ("--out", out / "report", "--json", out / "figures.json")
    return ("evaluate", shipped_drive(), "--predictions", run / "frames.jsonl", *outputs)


def exported(run: Path, out: Path) -> tuple[object, ...]:
    return ("export-mot", run, shipped_drive(), "--out", out / "mot")


def suggested(run: Path, out: Path) -> tuple[object, ...]:
    runs = [Path(shutil.copytree(run, out / name, dirs_exist_ok=True)) for name in ("one", "two")]
    return ("suggest", *runs, "--frames", 5)


@pytest.mark.parametrize("command", [evaluated, exported, suggested])
def test_all_or_nothing(
    command: Callable[[Path, Path], tuple[object, ...]],
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    if command is evaluated:
        request.getfixturevalue("undrawn")
    whole, full = tmp_path / "whole", tmp_path / "full"
    for out in (whole, full):
        out.mkdir()
    num_written, limit = 0, 10_000
    opened = whole_files.open_atomic

    @contextlib.contextmanager
    def open_counted(path: Path) -> Iterator[BinaryIO]:
        nonlocal num_written
        num_written += 1
        with opened(path) as file:
            yield file
            if num_written == limit:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(whole_files, "open_atomic", open_counted)
    result = foreglow_command(*command(run, whole))
    assert result.exit_code == 0, result.output
    assert num_written > 1
    num_written, limit = 0, num_written
    arguments = command(run, full)
    before = sorted(full.rglob("*"))
    result = foreglow_command(*arguments)
    assert result.exit_code == 2, result.output
    assert "No space left on device" in result.stderr
    assert sorted(full.rglob("*")) == before
