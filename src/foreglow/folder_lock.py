"""One writer at a time: what a command writes into or to is locked, and the lock dies with its process."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType

from foreglow.whole_files import claim_path, clear, entered, naming

_OF_COMMAND: set[Path] = set()
"""Folders that the command of this process has locked; what it does there needs no lock of its own."""


def lock(descriptor: int) -> bool:
    """Locks an open file or folder until it is closed; returns False if another has locked it.

    A file system without locks locks nothing.
    """
    with contextlib.suppress(OSError):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


class FolderLock:
    """The right to write into a folder, which one run has at a time; it ends with the process, however that ends.

    The folder itself is locked (flock), so that nothing is left behind. Folders made for it are removed on release if
    nothing is in them.
    """

    def __init__(self, path: Path, *, is_of_command: bool = False) -> None:
        """Makes the folder `path` with its parents, and locks it.

        Args:
            path: The folder.
            is_of_command: Whether all that the command of this process does there is under this one lock.

        Raises:
            OSError: If it cannot be made; the message names the path.
            ValueError: If another run writes into it.
        """
        self._made = [folder for folder in (path.absolute(), *path.absolute().parents) if not folder.exists()]
        check_folder(path)
        path.mkdir(parents=True, exist_ok=True)
        self._given, self._path, self._stat = path, path.resolve(), path.stat()
        self._is_of_command = is_of_command
        self._descriptor: int | None = None
        if self._path in _OF_COMMAND and not is_of_command:
            return
        descriptor = os.open(path, os.O_RDONLY)
        if not lock(descriptor):
            os.close(descriptor)
            raise ValueError(f"{path}: another run is writing into this folder; expected one of its own")
        self._descriptor = descriptor
        if is_of_command:
            _OF_COMMAND.add(self._path)

    def check(self) -> None:
        """Checks that the folder is still where it was.

        Raises:
            OSError: If it was moved, removed or replaced; the message names the path.
        """
        if not self._given.is_dir() or not os.path.samestat(self._given.stat(), self._stat):
            raise OSError(f"{self._given}: expected the folder that the run began with, it was moved or replaced")

    def release(self) -> None:
        """Ends the right; may be called again."""
        if self._is_of_command:
            _OF_COMMAND.discard(self._path)
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        self._made = []

    def __del__(self) -> None:
        """A lock that nobody can release any more, as after an error before the `with` block, is none."""
        if getattr(self, "_descriptor", None) is not None:
            self.release()

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def check_folder(path: Path) -> None:
    """Checks that a folder can be made at `path`, or is there.

    Raises:
        NotADirectoryError: If there is something else, such as a link to what is not there.
    """
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{path}: expected a folder to write into, got a file")
    for there in (path, *path.parents):
        if there.is_symlink() and not there.exists():
            raise NotADirectoryError(
                f"{there}: expected a folder, got a link to {there.readlink()}, which is not there"
            )


@contextlib.contextmanager
def locked(folders: Mapping[str, Path], files: Mapping[str, Path] | None = None) -> Iterator[None]:
    """Holds what a command writes into, and the single files that it writes, for itself until the block ends.

    Raises:
        ValueError: If another command is writing into one of the folders, or at work on one of the files; the message
            names it.
        OSError: If a folder cannot be made, or nothing be written beside a file.
    """
    with contextlib.ExitStack() as locks:
        for path in folders.values():
            locks.enter_context(entered(functools.partial(FolderLock, path, is_of_command=True)))
        for path in (files or {}).values():
            if path.parent.is_dir():  # else what writes the file says what is wrong
                locks.enter_context(entered(functools.partial(_claimed, path)))
        yield


@contextlib.contextmanager
def _claimed(path: Path) -> Iterator[None]:
    """The right to write one file, as `FolderLock`; a hidden file beside it is locked, and removed at the end."""
    clear(path.parent)
    claim = claim_path(path.absolute())
    with contextlib.ExitStack() as held:
        with naming(path, in_place_of=claim):
            descriptor = _opened(claim, held)
            while (is_ours := lock(descriptor)) and not _is_at(claim, descriptor):  # whose it was has removed it
                descriptor = _opened(claim, held)
        if not is_ours:
            raise ValueError(f"{path}: another run is writing this file; expected one of its own")
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                claim.unlink(missing_ok=True)


def _opened(path: Path, held: contextlib.ExitStack) -> int:
    """A file, made if it is not there, which may be somebody else's; open until `held` ends."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
    held.callback(os.close, descriptor)
    return descriptor


def _is_at(path: Path, descriptor: int) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    return False
