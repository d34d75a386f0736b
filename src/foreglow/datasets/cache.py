"""Decoded images on disk, for repeated passes over the same files: 0.3 ms rather than 6-9 ms for a 1280x960 PNG."""

from __future__ import annotations

import errno
import hashlib
from pathlib import Path

import numpy as np

from foreglow.datasets.images import NPY_ERRORS, read_image
from foreglow.files import open_atomic
from foreglow.types import Image

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


class FrameCache:
    """Decoded images, each in a .npy file, which is memory-mapped when it is read.

    An entry belongs to a file's path, size and time of change, so a changed file is decoded again. A full cache
    (`limit_bytes` reached, or the disk full) keeps its entries and adds no more: further images are decoded each time.
    Nothing is evicted: without the oldest entries, repeated passes over more images than fit would find none. `clear`
    removes all entries, stale ones included. Several processes may share a folder; each then counts towards its own
    limit the entries that were there when it began and those that it added.

    Attributes:
        folder: Folder of the entries.
        limit_bytes: Largest size of all entries together.
        num_hits: Images that were found.
        num_misses: Images that had to be decoded.
        is_full: True once there was no room for an image.
    """

    def __init__(self, folder: Path | str, limit_bytes: int = 20 * 2**30) -> None:
        """Opens the cache; makes an empty cache if there is none.

        Args:
            folder: Folder of the entries; made if absent.
            limit_bytes: Size limit; the default of 20 GiB holds 16,000 frames of 1280x960 in 8 bit.

        Raises:
            ValueError: If the folder cannot be made, or the limit is negative.
        """
        if limit_bytes < 0:
            raise ValueError(f"limit_bytes: expected 0 or more, got {limit_bytes}")
        self.folder = Path(folder)
        self.limit_bytes = limit_bytes
        self.num_hits = 0
        self.num_misses = 0
        self.is_full = False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"{folder}: expected a folder for the cache: {error.strerror}") from error
        self._size_bytes = sum(path.stat().st_size for path in self._entries())

    @property
    def size_bytes(self) -> int:
        """Size of all entries together, as far as this object knows."""
        return self._size_bytes

    def read_image(self, path: Path) -> Image:
        """The image in the file at `path`, as `images.read_image` returns it, but read-only if it comes from the cache.

        Raises:
            FileNotFoundError: If there is no such file, even if it was read before.
            ValueError: If the file is not a usable image.
        """
        if not path.is_file():
            return read_image(path)  # says what is wrong
        entry = self._entry(path)
        image = _mapped(entry)
        if image is not None:
            self.num_hits += 1
            return image
        self.num_misses += 1
        image = read_image(path)
        self._add(entry, image)
        return image

    def clear(self) -> None:
        """Removes all entries."""
        for path in list(self._entries()):
            path.unlink(missing_ok=True)
        self._size_bytes = 0
        self.is_full = False

    def _entries(self) -> list[Path]:
        return list(self.folder.glob("??/*.npy"))

    def _entry(self, path: Path) -> Path:
        state = path.stat()
        key = hashlib.sha256(f"{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}".encode(errors="surrogateescape"))
        name = key.hexdigest()
        return self.folder / name[:2] / f"{name}.npy"

    def _add(self, entry: Path, image: Image) -> None:
        num_bytes = image.nbytes + 128  # the header of a .npy file takes 128 bytes
        if self.is_full or self._size_bytes + num_bytes > self.limit_bytes:
            self.is_full = True
            return
        try:
            entry.parent.mkdir(exist_ok=True)
            with open_atomic(entry) as file:
                np.save(file, image, allow_pickle=False)
        except OSError as error:
            if error.errno not in _DISK_FULL:
                raise
            self.is_full = True
            return
        self._size_bytes += num_bytes


def _mapped(entry: Path) -> Image | None:
    """The entry, read-only, or None if it is missing or incomplete."""
    try:
        image: Image = np.asarray(np.load(entry, mmap_mode="r", allow_pickle=False))
    except (FileNotFoundError, *NPY_ERRORS):
        return None
    return image
