"""A data set of the drive that ships."""

from __future__ import annotations

import shutil
from pathlib import Path

from foreglow.datasets import shipped_drive
from foreglow.datasets.images import png, read_image


def make_shipped_splits(folder: Path) -> Path:
    """Its splits train and val are that drive, with one pixel of each image of val changed; the folder."""
    for split in ("train", "val"):
        shutil.copytree(shipped_drive(), folder / split)
    for path in (folder / "val" / "images").rglob("*.png"):
        image = read_image(path).copy()
        image[0, 0] ^= 1
        path.write_bytes(png(image))
    return folder
