"""Errors of a command: one line on stderr, and an exit code.

Bad input and wrong usage end with 2, an interrupt with 130, and a fault of this program with 70 and a report in a file
(the codes of sysexits.h and of shells).
"""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import logging
import math
import os
import platform
import re
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from foreglow.cli.signals import INTERRUPTED
from foreglow.outputs import exists
from foreglow.plugins import described, first_line_of, printable, raising, words_of
from foreglow.whole_files import RemadeWarning, output_words
from foreglow.wording import UnusedWarning

EXTRAS = {
    **dict.fromkeys(("onnx", "torch", "optuna"), "train"),
    **dict.fromkeys(("mitsuba", "drjit"), "sim"),
    "pandas": "pandas",
    "pyarrow": "parquet",
    **dict.fromkeys(("libreyolo", "torchvision"), "yolo"),
    **dict.fromkeys(("cantools", "can"), "can"),
    **dict.fromkeys(("foxglove", "lz4", "zstandard"), "recordings"),
    **dict.fromkeys(("rclpy", "rmw_fastrtps_cpp", "builtin_interfaces", "visualization_msgs"), "ros2"),
    **dict.fromkeys(("diagnostic_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs"), "ros2"),
    **dict.fromkeys(("dask", "distributed"), "scale"),
    "rerun": "view",
    "matplotlib": "plots",
    "ultralytics": "ultralytics",
    "trackeval": "mot",
}
"""Optional modules, and the extra that installs each."""

INTERNAL_ERROR = 70
"""EX_SOFTWARE of sysexits.h."""

READERS = (
    "calibration",
    "classifier",
    "config",
    "datasets",
    "files",
    "lab.simulation.scenes",
    "lab.simulation.writing",
    "maps",
    "photometry",
    "runs",
    "street",
)
"""Where files of the user are read."""

PRINTERS = ("click", "typer", "rich")
"""Packages that write to the terminal."""

NO_SPACE = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO)
"""What a write says that cannot be done."""

NO_MEMORY = "not enough memory"

NO_THREAD = "can't start new thread"
"""What Python says of it."""

OUTPUT_OPTIONS = ("--out", "--json", "--save", "--record", "--can")
"""What follows them on a command line is no input."""

ONLY_SHOWN = frozenset({"-h", "--help", "--version"})
"""Beside them nothing is done."""

EMPTY_OPTION = re.compile(r"--[\w-]+=")

MAX_LENGTH = 1000
"""Characters of a message; a longer one, such as of a file that is one long line, is cut."""

_UsageError: type[Any] = typer.BadParameter.__mro__[1]
_ClickException: type[Any] = typer.BadParameter.__mro__[2]


class Commands(TyperGroup):
    """The commands, with their errors turned into one line on stderr."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Runs the command line; a reader that has seen enough of the help, such as `head`, is no failure of it.

        Where names that are not UTF-8 cannot be printed as they are, there is a `?` in them.
        """
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="replace")
        try:
            return self._main(*args, **extra)
        except SystemExit as ending:
            is_shown = not ONLY_SHOWN.isdisjoint(extra.get("args") or sys.argv[1:])
            if is_shown and isinstance(ending.__context__, BrokenPipeError):
                sys.exit(0)
            raise

    def _main(self, *args: Any, **extra: Any) -> Any:
        """As `main`; where stderr is no terminal, an error of usage is one line, too, and not a box."""
        if not extra.get("standalone_mode", True) or sys.stderr.isatty():
            return super().main(*args, **extra)
        try:
            code = super().main(*args, **(extra | {"standalone_mode": False}))
        except _ClickException as error:
            if type(error).__name__ == "NoArgsIsHelpError":
                error.show()
            else:
                context = getattr(error, "ctx", None)
                hint = f" (see {context.command_path} --help)" if context is not None else ""
                typer.echo(f"foreglow: {shortened(error.format_message())}{hint}", err=True)
            sys.exit(error.exit_code)
        except typer.Abort:
            typer.echo("foreglow: interrupted", err=True)
            sys.exit(INTERRUPTED)
        except OSError as error:  # of the help or the version, which no command writes: a full disk
            if isinstance(error, BrokenPipeError) or "--debug" in (extra.get("args") or sys.argv):
                raise
            _complain(one_line(error)[0])
            sys.exit(2)
        sys.exit(code if isinstance(code, int) else 0)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parses the command line.

        Raises:
            typer.BadParameter: If a value is empty, such as of a variable that is not set: as a path, it would stand
                for the working directory. If an option that takes one value is given twice: one would have no effect.
        """
        for before, text in zip(["", *args], args, strict=False):
            if not text or EMPTY_OPTION.fullmatch(text):
                name = text.removesuffix("=") or (before if before.startswith("-") else "the command line")
                raise typer.BadParameter(f"{name}: expected a value, got an empty one", ctx)
        _check_once(ctx, args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Runs the command.

        Raises:
            typer.Exit: With the exit code. With `--debug` the error itself is raised.
        """
        is_debug = ctx.params["debug"]
        if not is_debug:  # what libraries have to say beside their errors
            logging.lastResort = logging.NullHandler()
            warnings.simplefilter("ignore")
            for shown in (RemadeWarning, UnusedWarning):
                warnings.simplefilter("always", shown)
            warnings.showwarning = _show_warning
        inputs = _inputs([*ctx._protected_args, *ctx.args])
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            line, code = "interrupted", INTERRUPTED
        except (typer.Exit, typer.Abort):
            raise
        except _ClickException as error:
            _name_what_is_not_finite(error)
            raise
        except BaseException as error:
            if is_debug or not (isinstance(error, Exception) or raising(error)):
                raise
            if isinstance(error, BrokenPipeError) and not raising(error):
                raise  # the reader of the output, such as `head`, has closed it
            is_interrupted = any(isinstance(cause, KeyboardInterrupt) for cause in _causes(error))
            line, code = ("interrupted", INTERRUPTED) if is_interrupted else one_line(error, inputs)
        _complain(line)
        raise typer.Exit(code)


def _check_once(context: Any, args: Sequence[str]) -> None:
    """Checks that no option of the command in `args` that takes one value is given twice."""
    while isinstance(context.command, TyperGroup):  # before the name of a command there are flags only
        name, *args = (*itertools.dropwhile(lambda text: text.startswith("-"), args), "")
        command: Any = context.command.get_command(context, name)
        if command is None:
            return
        context = type(context)(command, parent=context, info_name=name, **command.context_settings)
    try:
        given = context.command.make_parser(context).parse_args(args)[2]
    except _ClickException:  # said where the command is run
        return
    options = (each for each in given if each.param_type_name == "option" and not (each.multiple or each.is_flag))
    for name, count in Counter(each.opts[0] for each in options).items():
        if count > 1:
            raise _UsageError(f"{name}: expected once, got it {count} times", context)


def _name_what_is_not_finite(error: Any) -> None:
    """Has an error of usage say that NaN is no number, and not that it is above a limit."""
    from pydantic import ValidationError

    if isinstance(error.__cause__, ValidationError):
        value = error.__cause__.errors()[0]["input"]
        with contextlib.suppress(TypeError, ValueError):
            if not math.isfinite(float(value)):
                error.message = f"expected a finite number, got {value}"


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """What led to an error: an interrupt while a module loads becomes an ImportError, for instance."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__


def _complain(line: str) -> None:
    with contextlib.suppress(OSError):  # a terminal that is gone
        typer.echo(f"foreglow: {line}", err=True)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    _complain(str(message))


def one_line(error: BaseException, inputs: Sequence[Path] = ()) -> tuple[str, int]:
    """The error as one line, and the exit code; of an unforeseen error a report is written.

    Args:
        error: What was raised.
        inputs: Files and folders that the command line names.
    """
    origin = raising(error)
    if origin is not None:
        return shortened(f"{origin}: the plug-in raised {described(error)}"), 2
    if isinstance(error, ModuleNotFoundError) and error.name in EXTRAS:
        return f"{error.name} is not installed; this command needs: pip install 'foreglow[{EXTRAS[error.name]}]'", 2
    broken = _broken_package(error)
    if broken is not None:
        words = first_line_of(error)  # ROS 2 goes on with advice for its developers
        hint = "; source the setup file of ROS 2 first" if EXTRAS.get(broken) == "ros2" else ""
        return f"{broken} is installed, but cannot be loaded: {shortened(words, 400)}{hint}", 2
    if isinstance(error, FileNotFoundError) and error.errno == errno.ENOENT and error.filename is None:
        if error.strerror == os.strerror(errno.ENOENT):
            return "the working directory is there no more", 2
        return shortened(
            f"expected room for a temporary file, or TMPDIR to name a folder with some: {error.strerror}"
        ), 2
    closed = _closed_folder(error)
    if closed is not None:
        return shortened(f"{closed}: expected a folder that may be entered, the right to (x) is missing"), 2
    if isinstance(error, OSError) and error.filename is not None:
        is_read = Path(os.fsdecode(error.filename)) in inputs
        return shortened(f"{error.filename}: {error.strerror}" if is_read else output_words(error)), 2
    if isinstance(error, OSError) and _is_printing(error):
        return shortened(f"standard output: {error.strerror or words_of(error)}"), 2
    if isinstance(error, UnicodeEncodeError):
        around = error.object[max(0, error.start - 80) : error.start + 80]
        return f"expected names in UTF-8, which a file of text can hold, got {shortened(repr(around), 200)}", 2
    if isinstance(error, (ValueError, OSError)):
        return shortened(words_of(error) or type(error).__name__), 2
    is_short = isinstance(error, MemoryError) and not words_of(error)  # else it says how much was asked for
    words = NO_MEMORY if is_short else shortened(described(error), 200)
    path = _input_read(error, inputs)
    if path is not None:
        return shortened(f"{path}: cannot be read: {words}"), 2
    if isinstance(error, (OverflowError, RecursionError, MemoryError)) and inputs and not is_short:
        return shortened(f"{', '.join(map(str, inputs))}: expected values that can be worked with: {words}"), 2
    if isinstance(error, MemoryError):
        return NO_MEMORY, 2
    if isinstance(error, RuntimeError) and words_of(error) == NO_THREAD:
        return "no further thread can be started: expected more memory, or fewer processes", 2
    return f"internal error ({words}): a fault of Foreglow, not of your input; report: {_report(error)}", INTERNAL_ERROR


def _broken_package(error: BaseException) -> str | None:
    """The package of others that could not be imported although it is there, such as for a library that it lacks."""
    if not isinstance(error, ImportError) or isinstance(error, ModuleNotFoundError):
        return None
    package, name = None, ""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        name = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if name == "foreglow":
            package = None
        elif package is None and name not in sys.stdlib_module_names:
            package = name
    package = package or (error.name or "").partition(".")[0]
    if not package and name in sys.stdlib_module_names:  # from another process, without the way to it
        return "a package that this needs"
    return None if package in ("", "foreglow") else package


def _inputs(arguments: Sequence[str]) -> list[Path]:
    """The files and folders among the arguments of a command, without those that it writes to."""
    paths = []
    for before, argument in zip(["", *arguments], arguments, strict=False):
        name, _, value = argument.partition("=")
        text = value if argument.startswith("-") else argument
        if text and before not in OUTPUT_OPTIONS and name not in OUTPUT_OPTIONS and exists(Path(text)):
            paths.append(Path(text))
    return paths


def _input_read(error: BaseException, inputs: Sequence[Path]) -> Path | None:
    """The input that was being read when the error was raised: the path that the innermost reader had in hand."""
    found, is_reading = None, False
    for frame, _ in traceback.walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__", ""))
        if not module.startswith("foreglow."):
            continue
        is_reading = module.removeprefix("foreglow.").startswith(READERS)
        if is_reading:
            values = (*frame.f_locals.values(), getattr(frame.f_locals.get("self"), "path", None))
            paths = [value for value in values if isinstance(value, Path)]
            found = next((path for path in paths if _is_part_of(path, inputs)), found)
    if not is_reading:  # what the readers made of it is worked with already
        return None
    return found or (inputs[0] if len(inputs) == 1 else None)


def _is_printing(error: OSError) -> bool:
    """Whether it came of a line for the terminal, such as where standard output goes to a full disk."""
    if error.errno not in NO_SPACE:
        return False
    modules = [str(frame.f_globals.get("__name__", "")) for frame, _ in traceback.walk_tb(error.__traceback__)]
    return modules[-1:] != [] and modules[-1].partition(".")[0] in PRINTERS


def _closed_folder(error: BaseException) -> Path | None:
    """The folder, of those that lead to the file of an error, that may not be entered; None if all may."""
    if not isinstance(error, PermissionError) or not isinstance(error.filename, str):
        return None
    for folder in reversed(Path(error.filename).absolute().parents):
        if not os.access(folder, os.X_OK, effective_ids=os.access in os.supports_effective_ids):
            return Path(os.path.relpath(folder)) if not Path(error.filename).is_absolute() else folder
    return None


def _is_part_of(path: Path, inputs: Sequence[Path]) -> bool:
    return any(path == entry or entry in path.parents for entry in inputs)


def shortened(text: str, length: int = MAX_LENGTH) -> str:
    r"""`text` on one line, cut in the middle if it is too long.

    >>> shortened("a  file\nof two lines")
    'a file of two lines'
    >>> shortened("abcdefgh", 5)
    'ab…gh'
    """
    line = " ".join(text[: 100 * length].split())
    line = printable(line.encode("utf-8", "replace").decode())  # names that are not UTF-8
    half = (length - 1) // 2
    return line if len(line) <= length else f"{line[:half]}…{line[-half:]}"


def _report(error: BaseException) -> str:
    """Writes what a developer needs to a file, and returns its path."""
    from importlib import metadata

    from foreglow.wording import without_password

    try:
        lines = [
            f"foreglow {metadata.version('foreglow')}, Python {platform.python_version()}, {platform.platform()}",
            f"command: {' '.join(map(without_password, sys.argv))[:10_000]}",
            "".join(traceback.format_exception(error, limit=-60))[-100_000:],
        ]
        with tempfile.NamedTemporaryFile(
            "w", prefix="foreglow-error-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write("\n".join(lines))
        return str(Path(file.name))
    except (OSError, ImportError) as failure:  # a full disk; a package that was copied and not installed
        return f"none, it cannot be written: {failure}"
