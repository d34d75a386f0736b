"""What a command writes must not lie over what it reads, nor over what something else has written."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from foreglow.own_files import FileKind
from foreglow.own_folders import KINDS, RESULT_FILES, TRAINING, TUNING, check_new_report, check_own, is_mark
from foreglow.whole_files import PARTIAL, partial_path, replaces_only

REPORTING = ("experiment", "evaluate", "reproduce")
"""Commands, or how their names begin, that write a report with its figures and tables, whose names vary."""

KEEPING = {"train": TRAINING, "tune": TUNING}
"""Commands that write a folder of a kind that has its own names, by which it is known; runs look when they begin."""

COLLECTING = ("simulate", "import", "download")
"""Commands that write into a folder of a data set, and check what is in it themselves."""

PARTS_OF_SPLIT = ("images", "labels", "simulation")
"""Folders of a split in PVDN's format."""

MAX_ADDITION = 32
"""Characters by which a file's name is longer until it is whole, as `whole_files` has it."""

DEVICES = Path("/dev")
"""Nothing is written there: a file is put in place of what it overwrites, and root would lose the device."""

_COMMANDS: list[tuple[str, Mapping[str, Path]]] = []
"""The command that this process runs, and what it reads."""


@contextlib.contextmanager
def running(command: str, inputs: Mapping[str, Path] | None = None) -> Iterator[None]:
    """While the block lasts, this process runs `command`, such as `experiment glare`, which reads `inputs`."""
    _COMMANDS.append((command, inputs or {}))
    try:
        yield
    finally:
        _COMMANDS.pop()


def running_command() -> str | None:
    """The command that this process runs; None where it is a program of the user's own."""
    return _COMMANDS[-1][0] if _COMMANDS else None


def check_outputs(inputs: Mapping[str, Path], files: Mapping[str, Path], folders: Mapping[str, Path]) -> None:
    """Checks that no output is an input, lies over one or over a part of one, and that no two outputs are one file.

    No file lies among the images or labels of a data set, whether that is read or not, except for reports; and no
    folder among the splits of one that is read, where results may look like a further split.

    Nor may a folder hold the results of another command than the running one. What is to be overwritten must be a
    regular file. Only reports (`.html`) may lie beside what they are about, and be written again. That a file can be
    written is found out here, too, not after hours of work.

    Args:
        inputs: By option or argument, files and folders that are read, as far as they exist.
        files: By option, files to write.
        folders: By option, folders to write into.

    Raises:
        ValueError: If an output would destroy an input or another output; the message names both. Or if a file cannot
            be written: for its name, or the folder that it lies in.
    """
    for name, path in files.items():
        for other, folder in folders.items():
            if _is_same(path, folder):
                raise ValueError(f"{name} {path}: expected a file to write, {other} is a folder of that name")
        if path.is_dir():
            raise ValueError(f"{name} {path}: expected a file to write, got a folder")
        for other, read in inputs.items():
            if _is_same(path, read) or _is_same(partial_path(path), read):
                raise ValueError(f"{name} {path}: expected a file that does not overwrite {other} {read}")
            if path.is_file() and path.suffix != ".html" and _lies_in(path, read):
                raise ValueError(f"{name} {path}: expected a file that does not overwrite a part of {other} {read}")
            is_part = path.suffix != ".html" and _lies_in(path, read)
            if is_part and (_has_split(read) or _is_in_split(path, PARTS_OF_SPLIT)):
                raise ValueError(f"{name} {path}: expected a file that does not lie in the data set {other} {read}")
        if path.suffix != ".html" and _is_in_split(path, PARTS_OF_SPLIT):
            raise ValueError(f"{name} {path}: expected a file that does not lie in a data set")
        if (exists(path) and not path.is_file()) or path.parent.resolve() == DEVICES:
            raise ValueError(f"{name} {path}: expected a file to write, got a device, a pipe or a socket")
    for name, path in folders.items():
        if exists(path) and not path.is_dir():
            raise ValueError(f"{name} {path}: expected a folder to write into, got a file")
        for other, read in inputs.items():
            if _is_same(path, read):
                raise ValueError(f"{name} {path}: expected another folder for the results than {other}")
            if _lies_in(path, read) and (_is_foreign(path) or _is_split(path) or _is_in_split(path, PARTS_OF_SPLIT)):
                raise ValueError(f"{name} {path}: expected a new folder for the results, not a part of {other} {read}")
            is_data_set = other.startswith("DATA") and _has_split(read) and not _is_split(read)  # no folder around one
            if is_data_set and _lies_in(path, read):
                raise ValueError(f"{name} {path}: expected a folder that does not lie in the data set {other} {read}")
            if read.is_file() and any(
                _is_same(path / result, read) or _is_same(partial_path(path / result), read) for result in RESULT_FILES
            ):
                raise ValueError(f"{name} {path}: expected a folder whose results do not overwrite {other} {read}")
        _check_writer(name, path)
    results = {f"{name} {path}": [path / result for result in RESULT_FILES] for name, path in folders.items()}
    for name, path in files.items():
        for other, paths in results.items():
            if any(_is_same(path, each) or _is_same(path, partial_path(each)) for each in paths):
                raise ValueError(f"{name} {path}: expected another file than the results in {other}")
        whole = _result_with(path)
        is_page_of_input = path.suffix == ".html" and any(_is_same(path.parent, read) for read in inputs.values())
        if whole is not None and not is_page_of_input:
            raise ValueError(f"{name} {path}: expected a file that does not overwrite a part of {whole}")
    written = list(files.items())
    for index, (name, path) in enumerate(written):
        for other, second in written[:index]:
            if _is_same(path, second):
                raise ValueError(f"{name} {path}: expected another file than that of {other}")
    for name, path in files.items():
        if not any(_is_same(path.parent, folder) or _lies_below(path, folder) for folder in folders.values()):
            _check_place(name, path)


def _result_with(path: Path) -> Path | None:
    """The folder of results of which a file is a part, by the names of both; None if there is none, or no file."""
    for mark, kind in KINDS.items():
        for part in (*kind.parts, *kind.deeper):
            names = Path(part).parts
            if path.is_file() and path.absolute().parts[-len(names) :] == names:
                folder = path.absolute().parents[len(names) - 1]
                if (folder / mark).is_file():
                    return folder
    return None


def _check_place(name: str, path: Path) -> None:
    """ValueError if no file can be written at `path`."""
    folder = path.parent
    if folder.is_dir():
        try:
            path.with_name(f".{path.name}{'x' * MAX_ADDITION}").lstat()
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                raise ValueError(f"{name} {path}: expected a shorter name: File name too long") from None
        if not os.access(folder, os.W_OK | os.X_OK):
            raise ValueError(f"{name} {path}: Permission denied: expected a folder that one may write into")
    elif folder.exists():
        raise ValueError(f"{name} {path}: expected a file in a folder, {folder} is none")
    else:
        raise ValueError(f"{name} {path}: No such file or directory: expected a folder {folder} that is there")


def check_kinds(files: Mapping[str, Path], kinds: Mapping[str, FileKind]) -> None:
    """Checks that each file is of the kind that is written, by the end of its name and by what is there.

    So nothing is overwritten that a user or another command made, wherever it lies, also while the command runs, and
    `-` is no name of a file.

    Args:
        files: By option, files to write.
        kinds: By option, their kinds.

    Raises:
        ValueError: If a name ends otherwise, or something else is there.
    """
    for name, path in files.items():
        kind = kinds[name]
        if path.suffix.lower() not in kind.suffixes:
            raise ValueError(f"{name} {path}: expected a file whose name ends with {' or '.join(kind.suffixes)}")
        if not kind.may_replace(path):
            raise ValueError(
                f"{name} {path}: expected nothing there but {kind.words} that Foreglow wrote; choose another name, or "
                "remove it"
            )
        replaces_only(path)


def check_unnamed_outputs(files: Mapping[str, Path], folders: Mapping[str, Path]) -> None:
    """As `check_outputs`, for outputs of the running command to which it gave names itself."""
    check_outputs(_COMMANDS[-1][1] if _COMMANDS else {}, files, folders)


def exists(path: Path) -> bool:
    """Whether there is something at `path`; nothing is at what no file can be called."""
    try:
        return path.exists()
    except (OSError, ValueError):  # no name of a file, such as an address or a long text
        return False


def _is_same(path: Path, other: Path) -> bool:
    """Whether both are one file or folder, whatever their names: links are followed, hard links are known."""
    try:
        return path.resolve() == other.resolve() or (path.exists() and other.exists() and path.samefile(other))
    except (OSError, RuntimeError, ValueError):  # a loop of links, a name that is no name
        return False


def _lies_in(path: Path, folder: Path) -> bool:
    """Whether a file lies below a folder, whatever the names of both."""
    try:
        return folder.is_dir() and folder.resolve() in path.resolve().parents
    except (OSError, RuntimeError, ValueError):
        return False


def _lies_below(path: Path, folder: Path) -> bool:
    """As `_lies_in`, for a folder that may not be there yet."""
    try:
        return folder.resolve() in path.resolve().parents
    except (OSError, RuntimeError, ValueError):
        return False


def _check_writer(name: str, folder: Path) -> None:
    """ValueError if another command than the running one wrote what is in the folder."""
    command = running_command()
    if command is None:
        return
    if _is_in_split(folder, PARTS_OF_SPLIT):
        raise ValueError(f"{name} {folder}: expected a folder that does not lie in a data set")
    for record, kind in KINDS.items():
        writer = _said_in(folder / record, kind.command_keys) if kind.command_keys else None
        if writer is not None and writer != command:
            raise ValueError(_words_on_writer(name, folder, writer, record))
        if writer is not None:
            return
    for mark, kind in KINDS.items():
        if kind.commands and is_mark(folder / mark) and not command.startswith(kind.commands):
            raise ValueError(_words_on_writer(name, folder, kind.commands[0], mark))
    if command not in COLLECTING and _is_data_set(folder):
        raise ValueError(f"{name} {folder}: expected another folder for the results than that of a data set")
    if command == "simulate" and _is_split(folder):
        raise ValueError(f"{name} {folder}: expected a folder for splits, this is one; name another, or one around it")
    if command.startswith(REPORTING):
        check_new_report(f"{name} {folder}", folder)
    elif command in KEEPING:
        check_own(folder, KEEPING[command])


def _words_on_writer(name: str, folder: Path, writer: str, file: str) -> str:
    return f"{name} {folder}: expected another folder for these results, {folder / file} is of `foreglow {writer}`"


def _said_in(path: Path, keys: Sequence[str]) -> str | None:
    """The text under these keys in a JSON file; None if there is none."""
    value = _value_in(path, keys)
    return value if isinstance(value, str) else None


def _value_in(path: Path, keys: Sequence[str]) -> Any:
    """What is under these keys in a JSON file; None if there is nothing."""
    from foreglow.files import read_plain_json  # only here: the help comes without NumPy and pydantic

    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # the file may be anything
        value = read_plain_json(path)
        for key in keys:
            value = value[key]
        return value
    return None


def _is_foreign(folder: Path) -> bool:
    """Whether a folder holds something, and that is not what a command has written."""
    if not folder.is_dir():
        return False
    names = {path.name.removesuffix(PARTIAL) for path in folder.iterdir() if not path.name.startswith(".")}
    return bool(names) and names.isdisjoint(RESULT_FILES)


def _is_split(folder: Path) -> bool:
    """Whether a folder is a split in PVDN's format, which has names of results, too."""
    from foreglow.datasets.pvdn import is_split  # only here: the help comes without NumPy

    return is_split(folder)


def _is_data_set(folder: Path) -> bool:
    """Whether a folder is a split in PVDN's format, or one of a data set with its splits or those of its cycles.

    Unlike `_has_split`, a folder with a data set beside other things is none, so that results may go there.
    """
    from foreglow.datasets.pvdn.schema import Cycle  # only here: the help comes without NumPy
    from foreglow.datasets.pvdn.splits import SPLIT_NAMES

    return any(_is_split(folder / cycle / name) for cycle in ("", *Cycle) for name in ("", *SPLIT_NAMES))


def _has_split(folder: Path) -> bool:
    """Whether a folder is a split in PVDN's format, or a data set of some."""
    from foreglow.datasets.pvdn.splits import SPLIT_NAMES  # only here: the help comes without NumPy

    splits = (split for name in SPLIT_NAMES for split in (folder / name, *folder.glob(f"*/{name}")))
    return _is_split(folder) or any(_is_split(split) for split in splits)


def _is_in_split(path: Path, parts: Sequence[str]) -> bool:
    """Whether a file or folder is one of these parts of a split in PVDN's format, or lies below one."""
    try:
        found = path.resolve()
    except (OSError, RuntimeError, ValueError):  # as in `_is_same`
        return False
    return any(folder.name in parts and _is_split(folder.parent) for folder in (found, *found.parents))
