"""Where the splits of a data set in PVDN's layout lie: `DATA/train`, or `DATA/CYCLE/train`, and so on; and the drive
that ships with the package: simulated, in this layout, with labels, calibration and truth.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, TypeAlias

from foreglow.files import check_is_folder, checked_path
from foreglow.wording import check_one_of

SplitName: TypeAlias = Literal["train", "val", "test"]
SPLIT_NAMES: tuple[SplitName, ...] = ("train", "val", "test")

MEASURED_ON: SplitName = "test"
"""The split of a whole data set that is measured on if nobody names one."""

DEMO_DRIVE = "curve"


def shipped_drive(name: str = DEMO_DRIVE) -> Path:
    """The folder of the drive called `name`, a split that `PVDN` reads.

    Raises:
        FileNotFoundError: If no drive of this name is installed.
    """
    folder = Path(__file__).resolve().parents[2] / "shipped_drives" / name
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such drive in this installation")
    return folder


def split_folder(data: Path | str, name: SplitName) -> Path:
    """The folder of split `name` of the data set at `data`: `DATA/NAME`, or `DATA/CYCLE/NAME` of its only cycle.

    Raises:
        FileNotFoundError: If there is no such folder or no such split.
        ValueError: If there are several, such as those of `day` and `night`, or no split is ever called so.
    """
    check_one_of(name, SplitName, "split")
    root = checked_path(data, "data")
    check_is_folder(root, "a data set with train, val and test")
    found = sorted(path for path in (root / name, *root.glob(f"*/{name}")) if is_split(path))
    if not found:
        for folder in (root / name, *root.glob(f"*/{name}")):
            check_finished(folder)
        raise FileNotFoundError(f"{root}: expected the split {name} in it, or in one of its folders, found none")
    if len(found) > 1:
        cycles = ", ".join(str(path.parent) for path in found)
        raise ValueError(f"{root}: expected a single split {name}, found several; name one of {cycles}")
    return found[0]


def split_in(data: Path | str, name: SplitName) -> Path:
    """The split to measure on: `data` if that is a split, else its split `name` as `split_folder` finds it.

    Raises:
        FileNotFoundError: If there is no such folder or no such split.
        ValueError: If there are several, no split is ever called so, or `data` is a split of another name; that of
            `MEASURED_ON` says nothing, as it is what nobody asked for.
    """
    check_one_of(name, SplitName, "split")
    data = checked_path(data, "data")
    if not is_split(data):
        return split_folder(data, name)
    if name not in (MEASURED_ON, data.resolve().name):
        raise ValueError(f"split: expected a whole data set with {name}, {data} is a single split")
    return data


def existing_splits(data: Path, names: Iterable[SplitName] = SPLIT_NAMES) -> dict[SplitName, Path]:
    """The folders of those of the named splits of `data` that exist.

    Raises:
        ValueError: If a name fits several folders.
    """
    found: dict[SplitName, Path] = {}
    for name in names:
        with contextlib.suppress(FileNotFoundError):
            found[name] = split_folder(data, name)
    return found


def is_split(folder: Path | str) -> bool:
    """Whether `folder` is a PVDN split: it has a `labels/sequences.json`, or both images and the other label file."""
    folder = checked_path(folder, "folder")
    return (folder / "labels" / "sequences.json").exists() or (
        (folder / "labels" / "image_annotations.json").exists() and (folder / "images").is_dir()
    )


def check_finished(folder: Path) -> None:
    """Passes a folder unless it, or one in it, is a split that the simulator has begun and that has no labels yet.

    Raises:
        FileNotFoundError: If it is; the message says what completes it.
    """
    for above in ("", "[!.]*/", "[!.]*/[!.]*/"):
        for info in folder.glob(f"{above}simulation/info.json"):
            split = info.parents[1]
            if not is_split(split):
                raise FileNotFoundError(
                    f"{split}: expected a simulated data set that is complete, it was interrupted or is still being "
                    "made; `foreglow simulate` with the same options goes on with it"
                )


def is_pvdn(path: Path | str) -> bool:
    """Whether `path` is a split, one of its sequences, or a folder with splits one or two levels below."""
    path = checked_path(path)
    return path.is_dir() and bool(is_split(path) or splits_below(path) or _split_of_sequence(path))


def find_split(folder: Path) -> tuple[Path, str | None]:
    """The split that `folder` stands for, and the name of the sequence where `folder` is a sequence.

    That is the folder itself, the split of a sequence, or the only split one or two levels below, such as
    `DIR/night/train`; the folder itself, too, if there is none.

    Raises:
        ValueError: If there are several splits below.
    """
    if is_split(folder):
        return folder, None
    split = _split_of_sequence(folder)
    if split is not None:
        return split, folder.resolve().name
    below = splits_below(folder)
    if len(below) > 1:
        raise ValueError(f"{folder}: expected one split of PVDN, such as {below[0]}")
    return (below or [folder])[0], None


def found_name(path: Path) -> str:
    """What `path` stands for, for a person to read: the split that was found in it, and never merely `.`.

    Raises:
        ValueError: If there are several splits below.
    """
    found, sequence = find_split(path) if path.is_dir() else (path, None)
    named = found if sequence is None else path
    return str(named.resolve() if named.name in ("", "..") else named)


def splits_below(folder: Path) -> list[Path]:
    """The splits one or two levels below `folder`."""
    depths = ("[!.]*", "[!.]*/[!.]*")  # what is hidden is not complete
    return sorted(labels.parents[1] for depth in depths for labels in folder.glob(f"{depth}/labels/sequences.json"))


def _split_of_sequence(folder: Path) -> Path | None:
    if folder.resolve().parent.name != "images":
        return None
    split = folder.resolve().parents[1]
    return split if is_split(split) else None
