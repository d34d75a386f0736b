"""A folder that only has a file with the name of a result stays as it is, whatever the command and the name."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import typer

from foreglow.cli import app
from foreglow.datasets import shipped_drive
from foreglow.outputs import check_outputs, running
from foreglow.own_folders import KINDS, REPORT_FOLDERS, REPORT_SUFFIXES, RESULT_NAMES, TRAINING, TUNING
from tests.cli.commands import complaint

REPORT_NAMES = (
    *(f"any{suffix}" for suffix in REPORT_SUFFIXES),
    *(f"{inner}/any.npz".replace("*", "any") for inner in REPORT_FOLDERS),
    "rows/ours.json",
    "predictions/ours.json",
    "models/ours/curves.csv",
    "drives/S00001.json",
)
YOLO_NAMES = ("config.json", "results.json", "training/weights.pt")
RUNS = ("run", "beam", "demo", "live")
NEW = ("export-yolo", "export-mot", "download", "labels import", "simulate")
"""Commands that only write new folders, and what they have begun, as tests of their own have it."""


def result_names(command: str) -> Sequence[str]:
    """The names that a command may write into its folder, or delete there."""
    if command.startswith(("experiment", "evaluate", "reproduce")):
        return REPORT_NAMES
    if command in RUNS:
        return RESULT_NAMES
    return {"train": KINDS[TRAINING].parts, "tune": KINDS[TUNING].parts, "yolo train": YOLO_NAMES}[command]


def commands(group: typer.Typer, words: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every command by what the user calls it, with its function."""
    for command in group.registered_commands:
        assert command.callback is not None
        yield " ".join((*words, command.name or command.callback.__name__)), command.callback
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from commands(inner.typer_instance, (*words, *([inner.name] if inner.name else [])))


def writers() -> Iterator[str]:
    """The commands that have a folder for results."""
    for name, function in commands(app):
        infos = (info for hint in function.__annotations__.values() for info in getattr(hint, "__metadata__", ()))
        if any(getattr(info, "role", "") == "output folder" for info in infos):
            yield name


def test_every_command_with_a_folder_is_known_here() -> None:
    for name in set(writers()) - set(NEW):
        assert result_names(name), "say above what it may write into its folder"


@pytest.mark.parametrize("command", [name for name in writers() if name not in NEW])
def test_files_with_the_name_of_a_result_stay(command: str, tmp_path: Path) -> None:
    for name in result_names(command):
        mine = tmp_path / "out" / name
        mine.parent.mkdir(parents=True)
        mine.write_text("mine")
        source = shipped_drive() if command in RUNS else tmp_path / "data"
        refused = complaint(*command.split(), source, "--out", tmp_path / "out")
        assert str(tmp_path / "out") in refused
        assert mine.read_text() == "mine"
        assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == [mine]
        shutil.rmtree(tmp_path / "out")


@pytest.mark.parametrize("name", ["importance.png", "report.md", "trials.csv", "parallel.png"])
def test_a_folder_with_the_name_of_a_result_of_a_search_is_told_before_it(name: str, tmp_path: Path) -> None:
    (tmp_path / "out" / name).mkdir(parents=True)
    refused = complaint("tune", tmp_path / "data", "--out", tmp_path / "out")
    assert f"{tmp_path / 'out' / name}: expected a file to write, or nothing, got a folder" in refused


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("rows/ours.json", '{\n "name": "ours",\n "title": "'),
        ("models/paper/checkpoint.pt", "PK\3\4"),
        ("models/yolo-small/config.json", '{"training": {}, "boxes": "", "export_size_px": 320}'),
        ("results.json", '{"made_with": {}}'),
    ],
)
def test_a_table_of_detectors_that_was_begun_goes_on(name: str, text: str, tmp_path: Path) -> None:
    for other, content in (("rows/paper.json", "damaged"), (name, text)):
        (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / other).write_text(content)
    with running("experiment detector"):
        check_outputs({}, {}, {"--out": tmp_path})
        (tmp_path / name).write_text("mine")
        with pytest.raises(ValueError, match="is of something else"):
            check_outputs({}, {}, {"--out": tmp_path})


def test_the_first_epoch_of_a_table_that_was_interrupted_goes_on(tmp_path: Path) -> None:
    (tmp_path / "models/paper").mkdir(parents=True)
    (tmp_path / "models/paper/events.out.tfevents.1700000000.host.1.0").touch()
    (tmp_path / "samples/607ad3e0cf07471f").mkdir(parents=True)
    (tmp_path / "samples/607ad3e0cf07471f/crops.npy").touch()
    with running("experiment detector"):
        check_outputs({}, {}, {"--out": tmp_path})
