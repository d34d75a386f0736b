"""Every number on a command line is finite and has a range."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from foreglow.cli import app


def numeric_options(command: Any, path: str = "foreglow") -> Iterator[tuple[str, Any]]:
    for name, child in getattr(command, "commands", {}).items():
        yield from numeric_options(child, f"{path} {name}")
    for parameter in command.params:
        if kind_of(parameter) in (int, float):
            yield f"{path} {parameter.opts[0]}", parameter


def kind_of(parameter: Any) -> type | None:
    kind: type | None = parameter.type_descriptor.annotation
    return kind


def options() -> list[tuple[str, Any]]:
    return list(numeric_options(typer.main.get_command(app)))


def test_floating_point_options_have_a_range() -> None:
    found = [(name, parameter) for name, parameter in options() if kind_of(parameter) is float]
    assert found
    unbounded = [name for name, parameter in found if parameter.min is None or parameter.max is None]
    assert not unbounded


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", str(10**400)])
def test_a_number_that_is_none_is_refused(text: str) -> None:
    for name, parameter in options():
        if parameter.hidden:
            continue
        *path, option = name.split()[1:]
        result = CliRunner().invoke(app, [*path, f"{option}={text}"])
        assert result.exit_code == 2, name
        assert result.stderr.startswith("foreglow: "), name
        assert len(result.stderr.splitlines()) == 1, name
        if text in ("nan", "inf", "-inf"):
            assert f"expected a finite number, got {text}" in result.stderr, name


def test_what_a_camera_may_be_asked_for() -> None:
    for rate in ("0", "-5", "1e-3"):
        result = CliRunner().invoke(app, ["live", "camera:0", "--rate", rate])
        assert result.exit_code == 2
        assert "--rate" in result.stderr
