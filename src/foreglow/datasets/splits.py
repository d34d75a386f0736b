"""The train, validation and test split of a data set in PVDN's layout."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeAlias

from foreglow.datasets.pvdn import is_split

SplitName: TypeAlias = Literal["train", "val", "test"]
SPLIT_NAMES: tuple[SplitName, ...] = ("train", "val", "test")


def split_folder(data: Path | str, name: SplitName) -> Path:
    """The folder of split `name` of the data set at `data`: `DATA/NAME`, or `DATA/CYCLE/NAME` of its only cycle.

    Raises:
        FileNotFoundError: If there is no such folder or no such split.
        ValueError: If there are several, such as those of `day` and `night`.
    """
    root = Path(data)
    if not root.is_dir():
        raise FileNotFoundError(f"{root}: no such folder, expected a data set with train, val and test")
    found = sorted(path for path in (root / name, *root.glob(f"*/{name}")) if is_split(path))
    if not found:
        raise FileNotFoundError(f"{root}: expected the split {name} in it, or in one of its folders, found none")
    if len(found) > 1:
        cycles = ", ".join(str(path.parent) for path in found)
        raise ValueError(f"{root}: expected a single split {name}, found several; name one of {cycles}")
    return found[0]


def split_in(data: Path | str, name: SplitName) -> Path:
    """The split to measure on: `data` where it is one itself, else its split `name` as `split_folder` finds it.

    Raises:
        FileNotFoundError: If there is no such folder or no such split.
        ValueError: If there are several.
    """
    return Path(data) if is_split(Path(data)) else split_folder(data, name)
