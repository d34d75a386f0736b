"""Folders of results: by what they are known, and that nothing of somebody else is lost in one."""

from __future__ import annotations

import contextlib
import json
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from foreglow.own_files import is_left, is_own, is_result_of_run, is_row
from foreglow.whole_files import partial_path, together, write_atomic

RESULT_NAMES = (
    "frames.jsonl",
    "times.jsonl",
    "overlay.mp4",
    "overlay.png",
    "beam.mp4",
    "beam.png",
    "beam.asc",
    "beam.blf",
    "beam.log",
    "moments.png",
    "suggestions.csv",
    "report.html",
    "config.toml",
    "summary.json",
)
"""Every name that a run may have. `summary.json` is published last, so that the set is whole where it exists; only
what is made of the results comes after it: `moments.png`, `suggestions.csv` and `report.html`."""

RESULT_FILES = (
    *RESULT_NAMES,
    "results.json",
    "report.md",
    "plan.json",
    "model.onnx",
    "recipe.toml",
    "scenes.jsonl",
)
"""Names that commands write into their output folders. An input of such a name in that folder would be lost."""

CHECKSUMS = "checksums.json"
"""The file with the CRC-32 of those of an export, of `annotate`, a training or a search, by their paths: lists, for
what is there meanwhile."""

MAX_CHECKSUMS_BYTES = 1 << 28
"""Largest such file: four million files."""

_PIECE = 1 << 20
"""Bytes that are read at once."""

REPORT_SUFFIXES = (".csv", ".html", ".jpg", ".json", ".jsonl", ".md", ".mp4", ".png", ".toml")
"""How the names of a report's files end; they vary."""

REPORT_MARKS = ("plan.json", "experiments.json", "results.json")
"""Files by which the folder of a report is known."""

EVENTS = "events.out.tfevents."
"""How TensorBoard's files begin, which a training has before its first epoch and never overwrites."""

REPORT_FOLDERS = ("rows", "predictions", "models", "models/*", "drives")
"""Folders in that of a report, with what an experiment continues from."""

EXPORT = "export.json"
"""The file by which an export to YOLO is known."""

UNFINISHED_EXPORT = ".export.partial"
"""Folder in that of an export to YOLO for what is exported until all of it is there."""

RUN, TRAINING, TUNING = "frames.jsonl", "recipe.toml", "best.toml"
"""The files by which the folders of a run, of a training and of a search are known."""


@dataclass(frozen=True, slots=True)
class FolderKind:
    """A kind of folder that commands write, which is known by one file, its mark.

    Attributes:
        commands: Those that may have written it, where nothing there says which one did.
        parts: The files beside the mark that are lost if another command writes them.
        deeper: Such files in folders of it.
        folders: Those that it has, in which nothing else may be written.
        begun: Those by which an earlier one is known that may not be complete, if they hold what a command writes.
        command_keys: Where the mark, as JSON, says which command wrote it; empty if it does not.
    """

    commands: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    deeper: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    begun: tuple[str, ...] = ()
    command_keys: tuple[str, ...] = ()


KINDS = {
    RUN: FolderKind(
        ("run", "beam", "live", "demo"),
        RESULT_NAMES,
        deeper=("calibration/camera.toml", "calibration/camera.png"),
        folders=("calibration",),
        begun=(RUN, "times.jsonl", "summary.json"),
    ),
    TRAINING: FolderKind(
        ("train",),
        (
            *(TRAINING, "model.onnx", "weights.pt", "config.toml", "summary.json"),
            *("checkpoint.pt", "curves.csv", "curves.png", "changes.jpg"),
        ),
        folders=("samples",),
        begun=(TRAINING, "checkpoint.pt"),
    ),
    TUNING: FolderKind(
        ("tune",),
        (TUNING, "study.journal", "summary.json", "trials.csv", "report.md", "parallel.png", "importance.png"),
        folders=("frames",),
        begun=(TUNING, "study.journal"),
    ),
    "study.journal": FolderKind(("tune",)),
    "plan.json": FolderKind(("experiment glare",)),
    "experiments.json": FolderKind(("reproduce",)),
    "summary.json": FolderKind(command_keys=("command",)),
    EXPORT: FolderKind(("export-yolo",), folders=("images", "labels"), begun=(EXPORT,)),
    f"{UNFINISHED_EXPORT}/{EXPORT}": FolderKind(("export-yolo",)),
    CHECKSUMS: FolderKind(("export-mot",), folders=("gt", "trackers"), begun=(CHECKSUMS,)),
    "preview.toml": FolderKind(("simulate",)),
    "results.json": FolderKind(
        ("experiment", "evaluate", "reproduce", "yolo-train"), command_keys=("made_with", "command")
    ),
}
"""By mark; a record of which command wrote the folder goes before the marks."""


def is_mark(path: Path) -> bool:
    """Whether `path` is a mark; of names that other programs use, too, by what it holds."""
    return is_own(path) if path.name in (EXPORT, CHECKSUMS) else path.is_file()


def check_replaceable(path: Path) -> None:
    """Checks that there is a file or nothing at `path`, and at where it is written until it is whole.

    Raises:
        ValueError: If there is a folder, a device, a pipe or a socket.
    """
    for there in (path, partial_path(path)):
        if there.exists() and not there.is_file():
            kind = "a folder" if there.is_dir() else "a device, a pipe or a socket"
            raise ValueError(f"{there}: expected a file to write, or nothing, got {kind}")


def check_own(folder: Path, mark: str) -> None:
    """Checks that a folder has no file with the name of a result but those of an earlier run, training or search.

    Args:
        folder: The folder, in which the results are to be written.
        mark: `RUN`, `TRAINING` or `TUNING`.

    Raises:
        ValueError: If it has one that something else wrote, which would be lost, or a folder of that name; or if
            there is a file in place of one of their folders.
    """
    names = dict.fromkeys((*KINDS[mark].parts, "config.toml", "summary.json"))
    for name in names:
        check_replaceable(folder / name)
    for inner in KINDS[mark].folders:
        if mark != RUN and (folder / inner).exists() and not (folder / inner).is_dir():
            raise ValueError(f"{folder / inner}: expected a folder to write into, or nothing, got a file")
    if _has_earlier(folder, mark):
        return
    for path in (folder / name for name in names):
        if path.is_file():
            raise ValueError(_words_on_foreign(path))


def check_no_parts(folders: Mapping[str, Path], *, is_shared: bool = False) -> None:
    """Checks that folders for results are not, and do not lie in, those that belong to a run, training or search.

    Args:
        folders: By option, folders to write into.
        is_shared: Whether several commands share them for samples, which may be those of a training.

    Raises:
        ValueError: If one does; the message names the earlier results.
    """
    kinds = [kind for mark, kind in KINDS.items() if mark != TRAINING or not is_shared]
    for name, path in folders.items():
        with contextlib.suppress(OSError, RuntimeError):  # as in `_is_same`
            for part in (path.resolve(), *path.resolve().parents):
                if any(part.name in kind.folders and _is_begun(part.parent, kind) for kind in kinds):
                    raise ValueError(
                        f"{name} {path}: expected a new folder for the results, not a part of {part.parent}"
                    )


def check_made_together(files: Sequence[Path]) -> None:
    """Checks that files which are always written together are all there, as a command left them, or none of them.

    Raises:
        ValueError: If only some are there, which something else wrote.
    """
    there = [path for path in files if path.exists()]
    if there and len(there) < len(files):
        raise ValueError(_words_on_foreign(there[0]))


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
            found[name] = _checksum(path)
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
    both = known | {name: [*known.get(name, []), checksum] for name, checksum in checksums.items()}
    write_atomic(folder / CHECKSUMS, json.dumps(both, indent=0, sort_keys=True).encode())


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
        if path.is_file() and path.stat().st_size and _checksum(path) not in known.get(path.name, []):
            raise ValueError(
                f"{path}: expected the file as this command wrote it, by {CHECKSUMS} beside it, got another or a "
                "changed one, which stays; choose another folder, or move it"
            )


def replace_results(folder: Path, files: Mapping[str, bytes]) -> None:
    """Writes files by their names into `folder`, all or none, where nothing or what this wrote before is replaced.

    Raises:
        ValueError: As `check_as_written`.
        OSError: If one cannot be written; the message names it.
    """
    check_as_written(folder, files)
    checksums = {name: zlib.crc32(data) for name, data in files.items()}
    _announce(folder, checksums)  # first, so that all are known after a kill
    with together():
        for name, data in files.items():
            write_atomic(folder / name, data)
        write_atomic(folder / CHECKSUMS, checksums_file(checksums, folder))


def checksums_file(checksums: Mapping[str, int], folder: Path | None = None) -> bytes:
    """The record of an export with these checksums, and those of the other files of an earlier one in `folder`."""
    known = {} if folder is None else _known_checksums(folder)
    return json.dumps(
        known | {name: [checksum] for name, checksum in checksums.items()}, indent=0, sort_keys=True
    ).encode()


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


def _checksum(path: Path) -> int:
    found = 0
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            found = zlib.crc32(piece, found)
    return found


def _words_on_foreign(path: Path) -> str:
    return f"{path}: expected nothing there but earlier results of this command; choose another folder"


def _has_earlier(folder: Path, mark: str) -> bool:
    """Whether a folder has an earlier run, training or search, also one that was interrupted."""
    if _is_begun(folder, KINDS[mark]):
        return True
    is_begun = mark == RUN and any(path.stat().st_size for path in _left_in(folder))
    return is_begun or (mark == RUN and has_report(folder))


def _is_begun(folder: Path, kind: FolderKind) -> bool:
    return any(is_own(folder / name) for name in kind.begun)


def clear_left(folder: Path) -> None:
    """Removes what a run that was killed left in `folder` under the partial names of results.

    Raises:
        ValueError: If there is something else of such a name, which stays; nothing is removed then.
        OSError: If a file cannot be removed; the message names it.
    """
    left = _left_in(folder)
    for path in (partial_path(folder / name) for name in RESULT_NAMES if is_result_of_run(name)):
        if path not in left and (path.exists() or path.is_symlink()):
            raise ValueError(
                f"{path}: expected nothing there but what an interrupted run left; choose another folder, or move it"
            )
    for path in reversed(left):  # the frames last, by which the others are known
        path.unlink()


def _left_in(folder: Path) -> list[Path]:
    return [path for path in (partial_path(folder / name) for name in RESULT_NAMES) if is_left(path)]


def has_report(folder: Path) -> bool:
    """Whether a folder has the report of an earlier experiment, also of one that was interrupted."""
    return any(is_own(folder / name) for name in REPORT_MARKS)


def check_new_report(name: str, folder: Path) -> None:
    """Checks that a folder for a report holds an earlier one, perhaps a part of it, or nothing that one could replace.

    Args:
        name: What stands for the folder in the message.
        folder: The folder.

    Raises:
        ValueError: If it has only files, or folders, with names that a report may have.
    """
    if has_report(folder) or _has_rows(folder):
        return
    for mark in REPORT_MARKS:  # before its figures, which would be named else
        if (folder / mark).is_file():
            words = _words_on_others(name, folder / mark)
            raise ValueError(f"{words}, or damaged: choose another folder, or remove what is there")
    check_new(name, folder, REPORT_SUFFIXES)
    for inner in REPORT_FOLDERS:
        for each in sorted(folder.glob(inner)):
            if each.is_file():
                raise ValueError(_words_on_others(name, each))
            check_new(name, each, files_only=True)


def _has_rows(folder: Path) -> bool:
    """Whether a table of detectors was begun in a folder: it has a row, or the training of one."""
    models = list(folder.glob("models/*"))
    is_trained = any(_is_begun(model, KINDS[TRAINING]) or is_own(model / "config.json") for model in models)
    return is_trained or any(is_row(row) for row in folder.glob("rows/*.json"))


def check_new(name: str, folder: Path, suffixes: Sequence[str] | None = None, *, files_only: bool = False) -> None:
    """ValueError if what is in `folder`, which has no earlier results, is of something else; hidden files may be there.

    `name` stands for the folder in the message. Only what has a name that ends with one of `suffixes` is in the way,
    with None everything is; with `files_only` no folder is.
    """
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        is_in_the_way = suffixes is None or path.suffix.lower() in suffixes
        if is_in_the_way and not path.name.startswith((".", EVENTS)) and not (files_only and path.is_dir()):
            raise ValueError(_words_on_others(name, path))


def _words_on_others(name: str, path: Path) -> str:
    return f"{name}: expected a new folder, or one with earlier results of this command; {path} is of something else"
