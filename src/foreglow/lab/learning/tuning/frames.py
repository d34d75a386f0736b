"""Decoded frames in one memory-mapped file: trials read them as fast as memory, and processes share them.

A file for each image would cost an open file while it is mapped, and 0.3 ms to find. Here hundreds of frames stay open
during the whole search, and the proposals take only 0.2 ms per frame.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foreglow.datasets import LabelledSource
from foreglow.files import open_atomic, write_atomic
from foreglow.lab.learning.annotate import Progress
from foreglow.types import Image


@dataclass(frozen=True, slots=True)
class FrameStack:
    """A file of decoded frames, one after another; small enough to be sent to another process.

    Attributes:
        path: The file of pixels.
        shapes: Rows and columns of each frame.
        dtypes: Data type of each frame, uint8 or uint16.
    """

    path: Path
    shapes: tuple[tuple[int, int], ...]
    dtypes: tuple[str, ...]

    def images(self) -> list[Image]:
        """The frames, memory-mapped and read-only, in order."""
        pixels = np.memmap(self.path, np.uint8, "r")
        images: list[Image] = []
        start = 0
        for shape, dtype in zip(self.shapes, self.dtypes, strict=True):
            end = start + shape[0] * shape[1] * np.dtype(dtype).itemsize
            images.append(pixels[start:end].view(dtype).reshape(shape))
            start = end
        return images


def stack_frames(
    dataset: LabelledSource,
    image_ids: Sequence[int],
    folder: Path,
    *,
    jobs: int = 1,
    progress: Progress | None = None,
) -> FrameStack:
    """The images `image_ids` of `dataset`, decoded into `folder`; the file of an earlier call is used again.

    Args:
        dataset: The data set of the images.
        image_ids: The images, in the wanted order.
        folder: Folder for the pixels, 1.2 MB for an image of 1280x960; made if it does not exist.
        jobs: Number of threads that decode.
        progress: Called after every image.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If one is broken.
        OSError: If the pixels cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = hashlib.sha256()
    for image_id in image_ids:
        path = dataset.image_path(image_id)
        state = path.stat()
        files.update(f"{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\0".encode(errors="surrogateescape"))
    pixels = folder / f"{files.hexdigest()[:16]}.bin"
    index = pixels.with_suffix(".json")
    if index.exists() and pixels.exists():
        return _stack(pixels, json.loads(index.read_text()))
    entries: list[tuple[int, int, str]] = []
    with open_atomic(pixels) as file, ThreadPoolExecutor(jobs) as pool:
        for done, image in enumerate(pool.map(lambda image_id: dataset.read(image_id).image, image_ids), start=1):
            file.write(np.ascontiguousarray(image).tobytes())
            entries.append((image.shape[0], image.shape[1], image.dtype.name))
            if progress is not None:
                progress("frames decoded", done, len(image_ids))
    write_atomic(index, json.dumps(entries).encode())
    return _stack(pixels, entries)


def _stack(pixels: Path, entries: Sequence[tuple[int, int, str]]) -> FrameStack:
    return FrameStack(
        pixels,
        shapes=tuple((rows, columns) for rows, columns, _ in entries),
        dtypes=tuple(dtype for _, _, dtype in entries),
    )
