"""Folders of results: by what they are known, and that nothing of somebody else is lost in one."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from foreglow.checksums import CHECKSUMS
from foreglow.own_files import is_left, is_own, is_result_of_run, is_row
from foreglow.whole_files import check_replaceable, partial_path

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
