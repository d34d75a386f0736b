"""The checksums of what commands wrote into a folder, in a file there: what somebody has changed since is not lost."""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path

from foreglow.whole_files import check_replaceable, together, write_atomic

CHECKSUMS = "checksums.json"
"""The file with the CRC-32 of those of an export, of `annotate`, a training or a search, by their paths: lists, for
what is there meanwhile."""

MAX_CHECKSUMS_BYTES = 1 << 28
"""Largest such file: four million files."""

_PIECE = 1 << 20
"""Bytes that are read at once."""


def check_unchanged(
    folder: Path,
    names: Collection[str] | None = None,
    remedy: str = "choose another folder, or remove it and export again",
) -> dict[str, int]:
    """The checksums of the files that a command has written into `folder`, by their paths there, and nobody changed.

    Those that are gone are left out; an export of an early version has no checksums.

    Args:
        folder: The folder.
        names: Only these files; None for all.
        remedy: What to do about a changed one, for the message.

    Raises:
        ValueError: If somebody has changed one, or the record of the checksums; the message names it.
        OSError: If one cannot be read.
    """
    known = _known_checksums(folder)
    found = {}
    for name in known if names is None else [name for name in names if name in known]:
        path = folder / name
        if path.is_file():
            found[name] = checksum(path)
            if found[name] not in known[name]:
                raise ValueError(
                    f"{path}: expected the file that Foreglow wrote, got a changed one, which stays; {remedy}"
                )
    return found


def missing_files(folder: Path) -> list[Path]:
    """The files that an export has written into `folder`, and that are no longer there."""
    return [folder / name for name in _known_checksums(folder) if not (folder / name).is_file()]


def announce(folder: Path, checksums: Mapping[str, int]) -> None:
    """Adds to a record of checksums that is there what will replace its files, which are then known in either state.

    Raises:
        OSError: If the record cannot be written.
    """
    if (folder / CHECKSUMS).is_file():
        _announce(folder, checksums)


def _announce(folder: Path, checksums: Mapping[str, int]) -> None:
    known = _known_checksums(folder)
    both = known | {name: [*known.get(name, []), found] for name, found in checksums.items()}
    write_atomic(folder / CHECKSUMS, _record(both))


def check_as_written(folder: Path, names: Collection[str]) -> None:
    """Checks that files which are to be replaced are those that `replace_results` wrote, and nobody changed.

    Args:
        folder: Their folder, which need not be there.
        names: Theirs; files that are missing or empty pass.

    Raises:
        ValueError: If one is another, or it is not known who wrote it; the message names it.
        OSError: If one cannot be read.
    """
    check_replaceable(folder / CHECKSUMS)
    known = _known_checksums(folder)
    for path in (folder / name for name in names):
        if path.is_file() and path.stat().st_size and checksum(path) not in known.get(path.name, []):
            raise ValueError(
                f"{path}: expected the file as this command wrote it, by {CHECKSUMS} beside it, got another or a "
                "changed one, which stays; choose another folder, or move it"
            )


def replace_results(folder: Path, files: Mapping[str, bytes], removed: Collection[str] = ()) -> None:
    """Writes files by their names into `folder`, all or none, where nothing or what this wrote before is replaced.

    Args:
        folder: The folder.
        files: What they hold.
        removed: Names of files of an earlier call that are removed.

    Raises:
        ValueError: As `check_as_written`.
        OSError: If one cannot be written; the message names it.
    """
    check_as_written(folder, [*files, *removed])
    checksums = {name: zlib.crc32(data) for name, data in files.items()}
    _announce(folder, checksums)  # first, so that all are known after a kill
    with together():
        for name, data in files.items():
            write_atomic(folder / name, data)
        write_atomic(folder / CHECKSUMS, checksums_file(checksums, folder))
    for name in removed:
        (folder / name).unlink(missing_ok=True)


def checksums_file(checksums: Mapping[str, int], folder: Path | None = None) -> bytes:
    """The record of these checksums, by paths, and of those of other files that the one in `folder` has."""
    known = {} if folder is None else _known_checksums(folder)
    return _record(known | {name: [found] for name, found in checksums.items()})


def _record(checksums: Mapping[str, list[int]]) -> bytes:
    return json.dumps(checksums, indent=0, sort_keys=True).encode()


def _known_checksums(folder: Path) -> dict[str, list[int]]:
    path = folder / CHECKSUMS
    if not path.is_file():
        return {}
    try:
        known = json.loads(path.read_bytes() if path.stat().st_size <= MAX_CHECKSUMS_BYTES else b"")
        if all(isinstance(sums, list) and all(isinstance(each, int) for each in sums) for sums in known.values()):
            return dict(known)
    except (ValueError, RecursionError, AttributeError):  # the file may be anything
        pass
    raise ValueError(
        f"{path}: expected checksums of what Foreglow wrote here, got something else; choose another folder"
    )


def checksum(path: Path) -> int:
    """CRC-32 of a file.

    Raises:
        OSError: If there is no such file, or it cannot be read.
    """
    found = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            found = zlib.crc32(piece, found)
    return found
