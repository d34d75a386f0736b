"""The examples of deployment name what exists."""

from __future__ import annotations

import re
import shlex
import tomllib
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import pytest
import typer

from foreglow.cli import app

pytestmark = pytest.mark.process

ROOT = Path(__file__).resolve().parents[1]
DEPLOY = ROOT / "docs" / "deploy"


def extras(text: str) -> set[str]:
    return {name for names in re.findall(r"\[([a-z0-9,]+)\]'", text) for name in names.split(",")}


def test_the_service_calls_a_command_with_options_that_exist() -> None:
    # Keys may come twice in a unit, and lines go on after a backslash.
    text = (DEPLOY / "foreglow-live.service").read_text().replace("\\\n", " ")
    unit = ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(text)
    program, name, source, *options = shlex.split(unit["Service"]["ExecStart"])
    assert Path(program).name == "foreglow"
    group: Any = typer.main.get_command(app)
    command = group.commands[name]
    assert source == "camera:0"
    known = {option for parameter in command.params for option in parameter.opts}
    assert {option for option in options if option.startswith("--")} <= known
    parsed = command.make_context(name, [source, *options]).params
    assert (parsed["can"], parsed["can_in"], parsed["rate"]) == ("can0", "can1", 18.0)
    assert unit["Service"]["Type"] == "notify"
    assert float(unit["Service"]["WatchdogSec"]) > 1.0  # a pipeline that hangs is made anew before that


def test_the_container_installs_extras_that_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = extras((DEPLOY / "Containerfile").read_text())
    assert wanted == {"can", "recordings"}
    assert wanted <= project["optional-dependencies"].keys()


def test_the_container_copies_what_the_build_needs() -> None:
    copies = re.findall(r"^COPY (?!--from)(.+) \S+$", (DEPLOY / "Containerfile").read_text(), re.MULTILINE)
    names = {name for names in copies for name in names.split()}
    assert all((ROOT / name).exists() for name in names)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert {project["project"]["readme"], *project["project"]["license-files"], "pyproject.toml"} <= names
    assert {Path(package).parts[0] for package in project["tool"]["scikit-build"]["wheel"]["packages"]} <= names
    included = re.findall(r"add_subdirectory\((\w+)|(native)/", (ROOT / "CMakeLists.txt").read_text())
    assert {name for groups in included for name in groups if name} <= names


def test_the_guide_names_the_files() -> None:
    text = (DEPLOY / "index.md").read_text()
    for target in re.findall(r"\]\(([^)#]+)", text):
        if "://" not in target:
            assert (DEPLOY / target).resolve().exists(), target
