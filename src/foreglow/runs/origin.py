"""Where the frames of a run came from: its full name in `summary.json`, and by what another file there is told."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from foreglow.datasets import FrameSource, origin_of
from foreglow.datasets.exchange import is_labels
from foreglow.datasets.images import IMAGE_SUFFIXES
from foreglow.datasets.pvdn.splits import find_split, is_pvdn
from foreglow.files import MIB
from foreglow.outputs import exists

_UNPACKED = frozenset((".bmp", ".dib", ".tif", ".tiff", ".pgm", ".ppm", ".pnm", ".npy"))
"""Kinds of images that are mostly of one size whatever they show."""

_NUM_READ, _READ_BYTES = 8, 16 * MIB
"""Of how many such images, evenly spread, and how much of each is read."""


def origin_name(source: FrameSource) -> str:
    """The full path of what `source` reads; its own name if it reads no files, as a camera."""
    origin = origin_of(source)
    return source.name if origin is None else str(origin.absolute())


def full_name(text: str) -> str:
    """What a user named, with its full path where that exists, as others read it from elsewhere."""
    return str(Path(text).absolute()) if exists(Path(text)) else text


def origin_digest(path: Path) -> str | None:
    """What tells the file or the images at `path` from others, wherever they are moved; None where there are none.

    Of a file, its size, beginning and end count; of a folder or a split, the names and sizes of its images, and of
    kinds that are all of one size what some of them hold. Labels count nowhere, as they are corrected later. It is
    quick, and does not notice every image that was changed to one of the same size.
    """
    digest = hashlib.sha256()
    try:
        if path.is_file():
            if is_labels(path):
                return None
            with path.open("rb") as file:
                size = path.stat().st_size
                digest.update(b"%d " % size + file.read(MIB))
                file.seek(max(size - MIB, 0))
                digest.update(file.read(MIB))
            return digest.hexdigest()
        images = sorted(_images_in(path))
        for name, size, _ in images:
            digest.update(b"%s %d\n" % (name, size))
        unpacked = [image for _, _, image in images if Path(image).suffix.lower() in _UNPACKED]
        for image in unpacked[:: max(1, len(unpacked) // _NUM_READ)]:
            with Path(image).open("rb") as file:
                digest.update(file.read(_READ_BYTES))
    except (OSError, RuntimeError, ValueError):  # neither, such as the address of a camera; a loop of links
        return None
    return digest.hexdigest() if images else None


def _images_in(path: Path) -> Iterator[tuple[bytes, int, str]]:
    """Name, size and path of each image in a folder of images, or in the sequences of a split."""
    if is_pvdn(path):
        split, sequence = find_split(path)
        images = split / "images"
        folders = [each for each in images.iterdir() if each.is_dir()] if sequence is None else [images / sequence]
    else:
        folders, sequence = [path], path.name
    for folder in folders:
        with os.scandir(folder) as entries:
            for entry in entries:
                if Path(entry.name).suffix.lower() in IMAGE_SUFFIXES and entry.is_file():
                    name = entry.name if sequence is not None else f"{folder.name}/{entry.name}"
                    yield os.fsencode(name), entry.stat().st_size, entry.path
