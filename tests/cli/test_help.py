"""The help of every command, the page made of it, and how quickly it is there."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from docs.commands_page import reference
from foreglow.cli import app
from foreglow.lab.studies import STUDIES
from tests.cli.commands import foreglow_command

PAGE = Path(__file__).parents[2] / "docs" / "commands.md"
HEAVY = {"numpy", "scipy", "onnxruntime", "onnx", "av", "cv2", "torch", "matplotlib", "optuna"}
"""Not pydantic, which typer itself loads."""


def commands(command: Any, *names: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    yield names, command
    for name, sub_command in getattr(command, "commands", {}).items():
        yield from commands(sub_command, *names, name)


COMMANDS = dict(commands(typer.main.get_command(app)))


def plain(text: str) -> str:
    """The text without frames, line ends and other spaces."""
    return re.sub(r"[│╭╮╰╯─\s]+", "", text)


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_help_shows_every_option_and_its_whole_text(names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    result = foreglow_command(*names, "--help")
    assert result.exit_code == 0
    shown = plain(result.stdout)
    command = COMMANDS[names]
    assert plain(command.help) in shown
    for parameter in command.params:
        if getattr(parameter, "hidden", False):
            continue
        assert plain(parameter.help) in shown  # brackets would be taken for the markup of colours
        assert parameter.help[0].isupper()
        assert parameter.help.endswith(".")
        assert parameter.metavar or parameter.is_flag


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_help_fits_a_terminal_and_a_pipe(names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = foreglow_command(*names, "--help").stdout.splitlines()
    assert max(len(line) for line in lines) <= 80
    assert not any("\x1b" in line for line in lines)
    assert not any("…" in line for line in lines)  # nothing is cut off


def test_the_page_of_all_commands_is_the_programs() -> None:
    assert PAGE.read_text() == reference(), "run `make docs`"


def test_every_study_is_a_command() -> None:
    assert set(STUDIES) == {names[1] for names in COMMANDS if names[:1] == ("experiment",) and len(names) == 2}


@pytest.mark.slow
def test_help_loads_no_heavy_module() -> None:
    code = (
        "import sys, typer.testing, foreglow.cli\n"
        "result = typer.testing.CliRunner().invoke(foreglow.cli.app, ['experiment', '--help'])\n"
        "assert 'glare' in result.stdout\n"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not HEAVY & set(loaded)
