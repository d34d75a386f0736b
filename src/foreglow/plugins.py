"""What a name in a configuration stands for: an entry of our own table, or something that a user plugs in.

A name is looked up in the table first. `module:Name` is imported, also from the working directory. Any other name may
be an entry point of an installed package. `docs/extending.md` has examples.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import os
import pkgutil
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

Entry = TypeVar("Entry")

MAX_WORDS = 2000
"""Characters of an error of somebody else's code, such as a plug-in, that are kept."""

Methods: TypeAlias = Mapping[str, Sequence[str]]
"""The names of methods, and of what each is called with, beside `self`."""

METHODS: Mapping[str, Methods] = {
    "estimator": {"estimate": ("frame", "detections"), "reset": ()},
    "tracker": {"update": ("frame", "detections", "ranges"), "reset": ()},
    "policy": {"command": ("frame", "tracks"), "shone": ("command",), "reset": ()},
}
"""What every plug-in of a kind has."""

_RAISED_AT = "raised_in_plugin_at"

_modules: set[str] = set()
"""The modules that were imported for a `module:Name`."""


def find(field: str, name: str, table: Mapping[str, Entry], group: str) -> Entry:
    """The entry that `name` stands for.

    Args:
        field: The field of the configuration that has the name, for messages.
        name: A name in the table, `module:Name`, or the name of an entry point.
        table: Our own entries.
        group: The entry points' group, such as `foreglow.trackers`.

    Raises:
        ValueError: If the name is unknown, or cannot be imported; the message starts with the field.

    >>> find("tracker.method", "collections:Counter", {}, "foreglow.trackers").__name__
    'Counter'
    """
    if name in table:
        return table[name]
    if ":" in name:
        folder = str(Path.cwd())
        if not {"", folder} & set(sys.path):
            sys.path.append(folder)  # for good: the module may import others later
        return cast("Entry", imported(field, name))
    points = {point.name: point for point in metadata.entry_points(group=group)}
    if name not in points:
        raise ValueError(f"{field}: expected one of {', '.join([*table, *points])}, or module:Name, got {name!r}")
    return cast("Entry", imported(field, points[name].value))


def make(
    field: str,
    name: str,
    table: Mapping[str, Callable[..., Entry]],
    group: str,
    *arguments: Any,
    methods: Methods,
) -> Entry:
    """What the entry that `name` stands for makes of `arguments`.

    Raises:
        ValueError: As `find`, or if what was plugged in does not take these arguments, or makes something without one
            of the `methods`, or with one that is called otherwise.
    """
    entry = find(field, name, table, group)
    if name in table:
        return entry(*arguments)
    try:
        with contextlib.chdir(Path.cwd()):  # wherever it goes, relative outputs stay where they are
            made = entry(*arguments)
    except TypeError as error:
        kinds = ", ".join(type(argument).__name__ for argument in arguments)
        words = words_of(error) or type(error).__name__
        raise ValueError(f"{field}: {name} cannot be made of {kinds}: {words}") from error
    except Exception as error:
        if raising(error) is not None:  # whose file and line are known
            raise
        raise ValueError(f"{field}: {name} cannot be made: {described(error)}") from error
    check_methods(f"{field}: {name}", made, methods)
    return made


def check_methods(origin: str, plugin: object, methods: Methods) -> None:
    """Checks a plug-in, a class or an object.

    Raises:
        ValueError: If it lacks one of the `methods`, such as what a function returns that is no class, or one does not
            take what it will be called with; the message begins with `origin`.
    """
    lacking = [method for method in methods if not callable(getattr(plugin, method, None))]
    if lacking:
        kind = plugin if isinstance(plugin, type) else type(plugin)
        raise ValueError(
            f"{origin}: expected a class, or what makes an object, with the methods {', '.join(methods)}; "
            f"{kind.__name__} lacks {', '.join(lacking)}"
        )
    for name, arguments in methods.items():
        taken = _signature(plugin, name)
        if taken is None:
            continue
        try:
            taken.bind(*arguments)
        except TypeError:
            kind = plugin if isinstance(plugin, type) else type(plugin)
            expected = f"expected {kind.__name__}.{name}({', '.join(arguments)})"
            raise ValueError(f"{origin}: {expected}, got {name}({', '.join(taken.parameters)})") from None


def _signature(plugin: object, method: str) -> inspect.Signature | None:
    """How a method is called, without `self`; None where Python does not know, as of some that are written in C."""
    try:
        signature = inspect.signature(getattr(plugin, method))
    except (TypeError, ValueError):
        return None
    if isinstance(plugin, type) and inspect.isfunction(inspect.getattr_static(plugin, method)):
        first = next(iter(signature.parameters.values()), None)
        if first is not None and first.kind in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
            signature = signature.replace(parameters=list(signature.parameters.values())[1:])
    return signature


def imported(field: str, target: str) -> Any:
    """What `target`, `module:Name`, is.

    Raises:
        ValueError: If it cannot be imported, or cannot be called; the message starts with `field`.
    """
    module = target.partition(":")[0]
    if not target.startswith("foreglow.") and module != "builtins":  # our own cameras are named by texts, too
        _modules.add(module)
    try:
        with contextlib.chdir(Path.cwd()):
            found = pkgutil.resolve_name(target)
    except (Exception, SystemExit) as error:  # whatever a foreign module raises
        raise ValueError(f"{field}: {target} cannot be imported: {described(error)}") from error
    if not callable(found):
        raise ValueError(f"{field}: {target}: expected a class, got {type(found).__name__}")
    return found


def source_files() -> dict[str, Path]:
    """By module, the files that what was plugged in so far is made of: results of it may depend on each.

    These are the modules that were imported for a `module:Name`, and what else is loaded of their packages or lies
    beside them; nothing counts that lies beside an installed module.
    """
    found: dict[str, Path] = {}
    for plugin in sorted(_modules):
        own, top = _file_of(plugin), plugin.partition(".")[0]
        if own is None or top in sys.stdlib_module_names:
            continue
        beside = None if own.parent.name in ("site-packages", "dist-packages") else own.parent
        for name in sorted(sys.modules):
            file = _file_of(name)
            if file is not None and (name.partition(".")[0] == top or file.parent == beside):
                found[name] = file
    return found


def _file_of(module: str) -> Path | None:
    """The file of a module that is loaded; None for one without any."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file) if isinstance(file, str) and Path(file).is_file() else None


def built(plugin: Entry | Callable[..., Entry] | None, make: Callable[..., Entry], *arguments: Any) -> Entry:
    """The `plugin`, made of `arguments` where it is a class; without one, what `make` makes of them."""
    if plugin is None:
        return make(*arguments)
    return plugin(*arguments) if isinstance(plugin, type) else plugin  # type: ignore[return-value]


def name_of(plugin: object) -> str:
    """What a configuration calls the class `plugin`, or that of the object: `module:Name`.

    >>> from collections import Counter
    >>> name_of(Counter()), name_of(Counter)
    ('collections:Counter', 'collections:Counter')
    """
    kind = plugin if isinstance(plugin, type) else type(plugin)
    return f"{kind.__module__}:{kind.__qualname__}"


def checked(field: str, result: object, expected: type[Entry]) -> Entry:
    """The `result` of a plug-in, a dataclass, as what it has to be, with arrays of its own: a plug-in may use its own
    arrays again for the next frame, while this result still waits to be recorded.

    Raises:
        ValueError: If it is something else; the message starts with `field`.
    """
    if not isinstance(result, expected):
        raise ValueError(f"{field}: expected {expected.__name__} for each frame, got {type(result).__name__}")
    import numpy as np  # not when this module is loaded, as the command line is with it

    values = {part.name: getattr(result, part.name) for part in dataclasses.fields(cast("Any", result))}
    arrays = {name: value.copy() for name, value in values.items() if isinstance(value, np.ndarray)}
    return cast("Entry", dataclasses.replace(cast("Any", result), **arrays))


def words_of(error: BaseException) -> str:
    r"""What an error says on one line, cut if it is long; it may be of somebody else's class, which fails even at that.

    >>> words_of(ValueError("expected\n  a number")), words_of(ValueError())
    ('expected a number', '')
    """
    return " ".join(_text_of(error).split())


def described(error: BaseException) -> str:
    """The kind of an error, and what it says, if it says something, as `words_of`.

    >>> described(ValueError("too much")), described(ValueError())
    ('ValueError: too much', 'ValueError')
    """
    words = words_of(error)
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def printable(text: str) -> str:
    r"""`text` with its control characters written out: a terminal would carry out those of a device's name.

    >>> print(printable("cam\x1b[2J\x07 ä"))
    cam\x1b[2J\x07 ä
    """
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode() for character in text
    )


def first_line_of(error: BaseException) -> str:
    r"""The first line of what an error says, if it says something: libraries go on with advice for their developers.

    >>> first_line_of(ValueError("\nno model\nsee the log"))
    'no model'
    """
    return next((line.strip() for line in _text_of(error).splitlines() if line.strip()), "")


def _text_of(error: BaseException) -> str:
    try:
        text = str(error)
    except (Exception, SystemExit):
        return "what it says cannot be read"
    if len(text) > MAX_WORDS:
        text = f"{text[: MAX_WORDS // 2]}…{text[-MAX_WORDS // 2 :]}"
    return text


@contextlib.contextmanager
def staying() -> Iterator[None]:
    """Wherever a plug-in goes in the block, the working folder is the same after it: relative paths lead there."""
    here = _working_folder() if _modules else None
    try:
        yield
    finally:
        if here is not None and _working_folder() != here:
            with contextlib.suppress(OSError):  # it was moved or removed
                os.chdir(here)


def _working_folder() -> Path | None:
    try:
        return Path.cwd()
    except OSError:  # it was removed
        return None


@contextlib.contextmanager
def traced() -> Iterator[None]:
    """Errors in it keep where in a plug-in they were raised, on their way to another process without a traceback."""
    try:
        yield
    except BaseException as error:
        with contextlib.suppress(Exception):
            setattr(error, _RAISED_AT, raising(error))
        raise


def raising(error: BaseException) -> str | None:
    """Where in a plug-in `error` was raised, or in what it called: its file and line; None for any other error.

    For a method or an attribute that the plug-in lacks, its name.
    """
    lacking = getattr(error, "obj", None)  # of an AttributeError
    found: str | None = getattr(error, _RAISED_AT, None)
    if type(lacking).__module__ in _modules:
        found = name_of(lacking)
    for frame, line in traceback.walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__"))
        if any(module == name or module.startswith(f"{name}.") for name in _modules):
            found = f"{frame.f_code.co_filename}, line {line}"
    return found
