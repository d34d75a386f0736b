"""Files that appear whole or not at all, also several together, and errors that name their file."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, TypeVar

_TEMPORARY = re.compile(r"\..+\.([1-9]\d{0,8})(-\d+)?\.tmp", re.DOTALL)
"""Name of a hidden file that is being written, with the process that writes it."""

NO_PROCESS = 999_999_999
"""Greater than the number of any process: what has it in its name is removed as soon as nobody holds its lock."""

PARTIAL = ".partial"
"""How the name of a file ends until it is whole, if it is written over a longer time; so it is found after a kill."""

_OWN_FOLDER = re.compile(r"(\..+|parts-[0-9a-f]{32})\.partial", re.DOTALL)
"""Name of a folder of ours while what is to be elsewhere later is written into it."""

MAX_LOCKS = 256
"""Files of a block of `together` that stay locked until its end; more would use up the descriptors of a process."""

_CLEARED: set[Path] = set()
"""Folders that this process has cleared of what killed processes left."""

Made = TypeVar("Made")

Identity: TypeAlias = tuple[int, ...] | None
"""By what a file is known to be the same, unchanged; None where there is none."""

_FOUND: dict[Path, Identity] = {}
"""What was at each path that may be replaced, when that was found, until it is replaced."""


ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, the signal that `kill` and job schedulers send, and that of a terminal that closes."""


class RemadeWarning(UserWarning):
    """What was kept on disk to be used again is damaged, and is made again."""


@contextlib.contextmanager
def open_atomic(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which becomes `path` when the block ends without an error, and vanishes otherwise.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the message names `path`, which is then as it was.
    """
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        yield file


class AtomicFile:
    """As `open_atomic`, for a file that is written over a longer time than a block.

    Attributes:
        file: What to write to.
    """

    def __init__(self, path: Path) -> None:
        """Opens the file.

        Raises:
            OSError: If it cannot be written; the message names `path`.
        """
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        self._path = path
        self._closing = contextlib.ExitStack()
        self.file: BinaryIO = self._closing.enter_context(open_atomic(path))

    def close(self) -> None:
        """Completes the file.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        with naming(self._path):
            self._closing.close()

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before."""
        with contextlib.suppress(_DiscardedError, OSError), self._closing:  # what waits for the full disk
            raise _DiscardedError


class _DiscardedError(Exception):
    """Ends the block of a file that is not wanted."""


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """The path of an empty file to write to, for libraries that open it themselves; else as `open_atomic`.

    What processes that were killed have left of such files in the folder is removed.

    Raises:
        OSError: If it cannot be written, such as on a full disk; the message names `path`, which is then as it was.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):  # a folder cannot be overwritten anyway
        raise OSError(f"{path}: expected a regular file to overwrite, got a device, a pipe or a socket")
    clear(path.parent)
    whole = path.absolute()  # a plug-in may go to another folder meanwhile
    temporary = whole.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with naming(path, in_place_of=temporary):
            with temporary.open("wb") as held:
                _try_lock(held)
                yield temporary
                block = _BLOCK.get()
                if block is not None:
                    block.add(path, temporary, held)
            if block is None:
                put(temporary, whole, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Has signals that end a program wait for the end of the `with` block, which is short: it is done whole.

    Outside the main thread, where Python delivers no signals, it does nothing.
    """
    came: list[int] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        handlers = {number: signal.getsignal(number) for number in ENDINGS}
    caught = {number: handler for number, handler in handlers.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in caught:
            signal.signal(number, lambda number, _: came.append(number))
        yield
    finally:
        for number, handler in caught.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)


@contextlib.contextmanager
def entered(make: Callable[[], contextlib.AbstractContextManager[Made]]) -> Iterator[Made]:
    """As a `with` block of what `make` makes; a signal waits until it is made, and then ends it as an error does."""
    with contextlib.ExitStack() as leaving:
        with undisturbed():
            made = leaving.enter_context(make())
        yield made


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Has all files that this thread writes atomically in the block appear at its end, or none of them after an error.

    Until then none can be read. A block within a block is a part of it.

    Raises:
        OSError: If one cannot be put in its place; the message names it.
    """
    if _BLOCK.get() is not None:
        yield
        return
    block = _Block()
    try:
        _BLOCK.set(block)
        yield
        with undisturbed():
            block.publish()
    except BaseException:
        block.discard()
        raise
    finally:
        _BLOCK.set(None)
        block.release()


def replaces_only(path: Path) -> None:
    """Remembers what is at `path` now: if another file is there when one is to replace it, that one stays."""
    _FOUND[path.absolute()] = _identity(path)


def put(temporary: Path, whole: Path, name: Path) -> None:
    """Renames a finished file; if somebody has written there since `replaces_only`, it gets a partial name instead.

    Args:
        temporary: The file.
        whole: Where it is to be, as an absolute path.
        name: The same, as the user knows it.

    Raises:
        FileExistsError: If somebody has; the message names both files.
        OSError: If it cannot be renamed.
    """
    if whole in _FOUND and _identity(whole) not in (_FOUND.pop(whole), None):
        kept = temporary.absolute()
        if kept != partial_path(whole):
            kept = _free_partial(whole)
            temporary.replace(kept)
        words = f"somebody wrote another file there meanwhile; the new one is in {name.with_name(kept.name)}"
        raise FileExistsError(errno.EEXIST, words, str(name))
    temporary.replace(whole)


def _free_partial(path: Path) -> Path:
    """The partial name of a file, or the first such name with a number that nobody has; an empty file takes it."""
    for kept in itertools.chain([partial_path(path)], numbered(partial_path(path))):
        with contextlib.suppress(FileExistsError):
            kept.touch(exist_ok=False)
            return kept
    raise AssertionError


def numbered(path: Path) -> Iterator[Path]:
    """Names beside `path` that ends with two suffixes, such as `FILE.1.mcap.partial` for `FILE.mcap.partial`."""
    stem, suffixes = path.with_suffix("").stem, "".join(path.suffixes[-2:])
    return (path.with_name(f"{stem}.{number}{suffixes}") for number in itertools.count(1))


def _identity(path: Path) -> Identity:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def make_folder(path: Path) -> None:
    """Makes a folder with its parents; those made in a block of `together` go again after an error.

    Raises:
        OSError: If it cannot be made; the message names it.
    """
    block = _BLOCK.get()
    if block is not None:
        block.folders += [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)


def remove_file(path: Path) -> None:
    """Removes a file, if there is one; in a block of `together` at its end, once the others are in their places.

    Raises:
        OSError: If it cannot be removed; the message names it.
    """
    block = _BLOCK.get()
    if block is not None:
        block.removed.append(path)
    elif path.is_file():
        path.unlink()


class _Block:
    """The files of a block of `together`, under their temporary names."""

    def __init__(self) -> None:
        self.folders: list[Path] = []
        self.removed: list[Path] = []
        self._temporaries: dict[Path, Path] = {}
        self._locks: list[int] = []

    def add(self, path: Path, temporary: Path, locked: BinaryIO) -> None:
        self._temporaries[path] = temporary
        if len(self._locks) < MAX_LOCKS:
            self._locks.append(os.dup(locked.fileno()))

    def publish(self) -> None:
        for path in self._temporaries:  # before any is replaced
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        for path, temporary in self._temporaries.items():
            with naming(path, in_place_of=temporary):
                put(temporary, temporary.with_name(path.name), path)
        for path in self.removed:
            if path.is_file():
                path.unlink()

    def discard(self) -> None:
        for temporary in self._temporaries.values():
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        for folder in sorted(self.folders, reverse=True):  # what is in a folder comes first
            with contextlib.suppress(OSError):
                folder.rmdir()

    def release(self) -> None:
        for descriptor in self._locks:
            os.close(descriptor)


_BLOCK: ContextVar[_Block | None] = ContextVar("_BLOCK", default=None)


def is_temporary(path: Path) -> bool:
    """Whether a file has the name of one that is being written; others that end with `.tmp` are the user's.

    >>> is_temporary(Path("data/.info.json.12-34.tmp")), is_temporary(Path("data/.mine.tmp"))
    (True, False)
    """
    return _TEMPORARY.fullmatch(path.name) is not None


def clear(folder: Path) -> None:
    """Removes the temporary files in `folder` whose process is gone; once per folder is enough."""
    if folder in _CLEARED:
        return
    _CLEARED.add(folder)
    with contextlib.suppress(OSError):
        for left in folder.iterdir():
            found = _TEMPORARY.fullmatch(left.name)
            if found and left.is_file() and not _is_alive(int(found[1])):  # a pipe would wait for a writer
                with left.open("rb") as file:
                    if _try_lock(file):  # else a process on another machine writes it
                        left.unlink()


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _try_lock(file: BinaryIO) -> bool:
    """Locks `file` until it is closed; returns whether that succeeded."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by another, or a file system without locks
        return False
    return True


def write_atomic(path: Path, data: bytes) -> None:
    """Writes `data` to `path`, whole or not at all.

    Raises:
        OSError: If it cannot be written; the message names `path`, which is then as it was.
    """
    with open_atomic(path) as file:
        file.write(data)


@contextlib.contextmanager
def naming(path: Path, *, in_place_of: Path | None = None) -> Iterator[None]:
    """Adds `path` to an OSError that does not name its file, such as that of a full disk.

    Args:
        path: The file that the user knows.
        in_place_of: A temporary file of ours; an error that names it will name `path` instead.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename not in (None, in_place_of and str(in_place_of)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def partial_path(path: Path) -> Path:
    """Where a file of a run, or a recording, is written until it is whole."""
    return path.with_name(f"{path.name}{PARTIAL}")


def claim_path(path: Path) -> Path:
    """A hidden file that is locked while a command is at work on `path`; a killed one's goes as temporary files do.

    >>> claim_path(Path("data/run.html")).name, is_temporary(claim_path(Path("data/run.html")))
    ('.run.html.999999999.tmp', True)
    """
    return path.with_name(f".{path.name}.{NO_PROCESS}.tmp")


def check_replaceable(path: Path) -> None:
    """Checks that there is a file or nothing at `path`, and at where it is written until it is whole.

    Raises:
        ValueError: If there is a folder, a device, a pipe or a socket.
    """
    for there in (path, partial_path(path)):
        if there.exists() and not there.is_file():
            kind = "a folder" if there.is_dir() else "a device, a pipe or a socket"
            raise ValueError(f"{there}: expected a file to write, or nothing, got {kind}")


def output_words(error: OSError) -> str:
    """What an error about a file says, with the name that the file gets when it is whole, or that of its folder.

    >>> output_words(OSError(28, "No space left on device", "out/frames.jsonl.partial"))
    'out/frames.jsonl: No space left on device'
    >>> output_words(OSError(28, "No space left on device", "DATA/night/train/simulation/.S00001.partial/road.json"))
    'DATA/night/train/simulation: No space left on device'
    """
    path = Path(os.fsdecode(error.filename))
    hidden = [parent for parent in path.parents if _OWN_FOLDER.fullmatch(parent.name)]
    if hidden:
        path = hidden[-1].parent
    elif path.name.endswith(PARTIAL) and path.name != PARTIAL:
        path = path.with_name(path.name.removesuffix(PARTIAL))
    return f"{path}: {error.strerror}"
