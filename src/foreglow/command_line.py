"""How the options of commands are declared, and groups of them that a command takes as one value.

>>> @dataclasses.dataclass(frozen=True)
... class GreetingOptions:
...     '''Greeting.'''
...
...     name: Annotated[str, option("NAME", "Whom to greet.")] = "you"
>>> @with_options
... def greet(greeting: GreetingOptions) -> None:
...     print(f"hello {greeting.name}")
>>> greet(name="there")
hello there
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import re
import typing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from copy import copy
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import typer
from typer.models import OptionInfo

from foreglow.folder_lock import locked
from foreglow.inputs import named_by
from foreglow.outputs import check_kinds, check_outputs, exists, running
from foreglow.own_files import FileKind
from foreglow.own_folders import check_no_parts

MAX_INTEGER = 2**31 - 1
"""No count, size or seed on a command line is greater."""


@runtime_checkable
class Naming(Protocol):
    """A group of options that adds a file's name to errors about what is in the file."""

    def naming(self) -> AbstractContextManager[None]:
        """What the command runs in."""
        ...


def argument(metavar: str, text: str) -> Any:
    """An argument, with its help."""
    # The readers' errors take a single line, so that typer need not look.
    return typer.Argument(metavar=metavar, help=text, readable=False, callback=_checked)


def option(metavar: str, text: str, *names: str, **settings: Any) -> Any:
    """An option with a value, and its help. A number has a least and a greatest value, `min` and `max`.

    A metavar such as `day|night` lists words: no value of the option is a path, even if there is a file of that name.
    """
    made = typer.Option(*names, metavar=metavar, help=text, **{"callback": _checked, **settings})
    return _with_role(made, "word") if re.fullmatch(r"[a-z0-9_]+(\|[a-z0-9_]+)+", metavar) else made


def _checked(value: Any) -> Any:
    """`value`, if it is no number that no command has a use for.

    Raises:
        typer.BadParameter: For NaN, an infinity, or a whole number of more than 31 bits.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    if isinstance(value, int) and abs(value) > MAX_INTEGER:
        raise typer.BadParameter(f"expected at most {MAX_INTEGER}, got a number of {len(str(abs(value)))} digits")
    return value


def flag(name: str, text: str) -> Any:
    """An option without a value, and its help."""
    return typer.Option(name, help=text)


def file(text: str, *names: str, metavar: str = "FILE") -> Any:
    """An option that takes a path, and its help."""
    return option(metavar, text, *names, readable=False)


def output_file(text: str, kind: FileKind, *names: str, metavar: str = "FILE", **settings: Any) -> Any:
    """An option with a file to write, and its help: the command may not read the same file.

    Its name has to end as those of its kind do, and what is there is of that kind.
    """
    made = _with_role(option(metavar, text, *names, readable=False, **settings), "output file")
    made.kind = kind
    return made


def folder(text: str, *names: str) -> Any:
    """An option with a folder to write into, and its help: one command does so at a time."""
    return _with_role(file(text, *names, metavar="DIR"), "output folder")


def shared_folder(text: str, *names: str) -> Any:
    """As `folder`, of one into which several commands may write at a time."""
    return _with_role(file(text, *names, metavar="DIR"), "shared folder")


def _with_role(info: Any, role: str) -> Any:
    info.role = role
    return info


def listed(name: str, text: str) -> tuple[str, ...]:
    """The names in the value of an option that takes several, with commas between them.

    Raises:
        ValueError: If one comes twice, or is empty.

    >>> listed("--split", "val, test")
    ('val', 'test')
    """
    from foreglow.files import check_each_once

    names = tuple(part.strip() for part in text.split(","))
    if "" in names:
        raise ValueError(f"{name}: expected names with commas between them, got {text!r}")
    check_each_once(names, name)
    return names


def refuse_unused(source: str, given: Mapping[str, bool]) -> None:
    """Refuses options that have no effect on a source: those of `given`, by name, that were given.

    Raises:
        ValueError: If there is one; the message names it.
    """
    from foreglow.wording import without_password

    unused = ", ".join(name for name, is_given in given.items() if is_given)
    if unused:
        raise ValueError(f"{unused}: expected with another kind of SOURCE: no effect on {without_password(source)}")


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """`function` as a command that checks what it writes, and takes groups of options.

    Each parameter whose type is a dataclass becomes one option per field. In the help, the options of such a group
    stand together, under the first line of the dataclass's docstring. No file or folder that the command writes may be
    one that it reads, and what it writes, or writes into, is locked while it runs, unless it is a shared folder.
    """
    hints = typing.get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if dataclasses.is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(function).parameters.items():
        parameters += _options_of(groups[name]) if name in groups else [parameter.replace(annotation=hints[name])]

    infos = {parameter.name: typing.get_args(parameter.annotation)[1:] for parameter in parameters}
    roles = {name: getattr(info[0], "role", "input") if info else "" for name, info in infos.items()}

    @functools.wraps(function)
    def command(**values: Any) -> None:
        inputs, files, folders, shared = (
            _labelled((_label(name, infos[name][0]), path) for name, path in _paths(values, roles, role))
            for role in ("input", "output file", "output folder", "shared folder")
        )
        inputs |= named_by(inputs)
        kinds = {_label(name, info[0]): info[0].kind for name, info in infos.items() if roles[name] == "output file"}
        with running(_command_of(function), inputs):
            check_outputs(inputs, files, folders | shared)
            check_no_parts(folders)
            check_no_parts(shared, is_shared=True)
            check_kinds(files, kinds)
            for name, group in groups.items():
                values[name] = group(**{field.name: values.pop(field.name) for field in dataclasses.fields(group)})
            with contextlib.ExitStack() as around:
                around.enter_context(locked(folders, files))
                for group in values.values():
                    if isinstance(group, Naming):
                        around.enter_context(group.naming())
                function(**values)

    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    command.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _command_of(function: Callable[..., None]) -> str:
    """What the user calls the command; that of an experiment is the function `command` of its package."""
    name = function.__name__ if function.__name__ != "command" else f"experiment {function.__module__.split('.')[-2]}"
    return name.strip("_").replace("_", "-")


def _paths(values: dict[str, Any], roles: dict[str, str], role: str) -> Iterator[tuple[str, Path]]:
    """The paths among the values of a command's parameters that have this role; of inputs, those that exist."""
    for name, value in values.items():
        if roles.get(name) != role or value is None:
            continue
        for path in value if isinstance(value, list | tuple) else [value]:
            if isinstance(path, str) and role == "input":
                path = Path(path.removeprefix("simulate:"))
            if isinstance(path, Path) and (role != "input" or exists(path)):
                yield name, path


def _labelled(paths: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """The paths by label; further ones of the same label are numbered."""
    found: dict[str, Path] = {}
    counts: Counter[str] = Counter()
    for label, path in paths:
        counts[label] += 1
        found[label if counts[label] == 1 else f"{label} ({counts[label]})"] = path
    return found


def _label(name: str, info: Any) -> str:
    """What a parameter is called on the command line."""
    if not isinstance(info, OptionInfo):
        return str(info.metavar or name.upper())
    names = (*([info.default] if isinstance(info.default, str) else []), *(info.param_decls or ()))
    return names[0] if names else f"--{name.replace('_', '-')}"


def _options_of(group: type) -> Iterator[inspect.Parameter]:
    hints = typing.get_type_hints(group, include_extras=True)
    for name, parameter in inspect.signature(group).parameters.items():
        kind, info = typing.get_args(hints[name])
        if isinstance(info, OptionInfo):
            info = copy(info)  # which keeps its role
            info.rich_help_panel = (group.__doc__ or "").partition("\n")[0].rstrip(".")
        yield parameter.replace(annotation=Annotated[kind, info])
