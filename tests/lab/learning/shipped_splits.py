"""A data set of the drive that ships."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2

from foreglow.datasets import shipped_drive
from foreglow.datasets.images import read_image


def make_shipped_splits(folder: Path) -> Path:
    """Its splits train and val are that drive, in val with other images of the same; the folder."""
    for split in ("train", "val"):
        shutil.copytree(shipped_drive(), folder / split)
    for path in (folder / "val" / "images").rglob("*.jpg"):
        path.write_bytes(cv2.imencode(".jpg", read_image(path))[1].tobytes())
    return folder
