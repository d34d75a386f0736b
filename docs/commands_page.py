"""Every command with its arguments and options, as Markdown: `python docs/commands_page.py > docs/commands.md`."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from foreglow.cli import app

HEAD = """# Commands

All commands and their options, as `foreglow COMMAND --help` shows them. `make docs` writes this page."""


def reference() -> str:
    """The page."""
    return "\n\n".join([HEAD, *_paragraphs(typer.main.get_command(app), "foreglow")]) + "\n"


def _paragraphs(command: Any, name: str) -> Iterator[str]:
    """What is said about a command, and about its sub-commands."""
    parameters = [parameter for parameter in command.params if not getattr(parameter, "hidden", False)]
    words = [_form(parameter) for parameter in parameters if parameter.required or _is_argument(parameter)]
    yield f"{'#' * max(2, len(name.split()))} {name}"
    yield inspect.cleandoc(command.help)
    commands = getattr(command, "commands", {})
    if not commands:
        yield f"```sh\n{' '.join([name, *words])}\n```"
    for title in dict.fromkeys([None, *(parameter.rich_help_panel for parameter in parameters)]):
        lines = [_line(parameter) for parameter in parameters if parameter.rich_help_panel == title]
        if lines and title is not None:
            yield f"{title}:"
        if lines:
            yield "\n".join(lines)
    for sub_name, sub_command in commands.items():
        if not sub_command.hidden:
            yield from _paragraphs(sub_command, f"{name} {sub_name}")


def _form(parameter: Any) -> str:
    """How an argument or an option is written on the command line."""
    if _is_argument(parameter):
        return str(parameter.metavar) if parameter.required else f"[{parameter.metavar}]"
    return parameter.opts[0] if parameter.is_flag else f"{parameter.opts[0]} {parameter.metavar}"


def _is_argument(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "argument")


def _line(parameter: Any) -> str:
    """The list item about an argument or an option."""
    default = "" if parameter.default is None or parameter.default is False else f" Default: `{parameter.default}`."
    return f"- `{_form(parameter)}`: {parameter.help}{' Required.' if parameter.required else default}"


if __name__ == "__main__":
    print(reference(), end="")  # noqa: T201
