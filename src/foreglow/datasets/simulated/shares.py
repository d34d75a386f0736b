"""Whose light is in a box: shares of its contrast by source, beside the labels of a simulated data set.

`simulation/S00001/shares.parquet` has a row for each proposal of each image: image_id, preset, the box x1, y1, x2, y2
(half-open, pixels of the full image), and six shares that sum to one. Reading and writing need the extra `parquet`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.files import checked_path
from foreglow.types import LIGHT_KINDS
from foreglow.whole_files import atomic_path

SOURCES = (*LIGHT_KINDS, "own", "fixed")
"""Other vehicles' front and rear lamps in sight, their light on something, our own light, and everything fixed: street
lamps, windows, the sky. The shares of a box are in this order."""

NUM_VEHICLE_SOURCES = len(LIGHT_KINDS)
"""The first so many sources are other vehicles."""

SHARES_FILE = "shares.parquet"
"""Name of the file in the folder of a sequence's truth."""

BOX = ("x1", "y1", "x2", "y2")

_DIGEST = b"foreglow_sha256"
"""Key of the checksum in the file's metadata."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxShares:
    """Whose light is in the proposals of one preset in an image.

    Attributes:
        preset: Name of the preset.
        boxes_xyxy_px: Shape (N, 4), int32, half-open.
        shares: Shape (N, 6), float32, in the order of `SOURCES`; each row sums to one.
    """

    preset: str
    boxes_xyxy_px: NDArray[np.int32]
    shares: NDArray[np.float32]

    def __post_init__(self) -> None:
        num = len(self.boxes_xyxy_px)
        if self.boxes_xyxy_px.shape != (num, 4) or self.shares.shape != (num, len(SOURCES)):
            raise ValueError(
                f"BoxShares: expected (N, 4) boxes and (N, {len(SOURCES)}) shares, got {self.boxes_xyxy_px.shape} and "
                f"{self.shares.shape}"
            )
        sums = self.shares.sum(1)
        if not ((self.shares >= 0).all() and np.allclose(sums, 1.0, atol=1e-3)):
            raise ValueError(f"BoxShares.shares: expected shares of at least 0 that sum to 1, got sums {sums}")

    @property
    def kinds(self) -> NDArray[np.float32]:
        """Shares of the kinds of light in `KINDS`, shape (N, 5): those of vehicles, and all other light as `none`."""
        others = self.shares[:, NUM_VEHICLE_SOURCES:].sum(axis=1, keepdims=True)
        return np.concatenate([self.shares[:, :NUM_VEHICLE_SOURCES], others], axis=1)

    @property
    def vehicle_shares(self) -> NDArray[np.float32]:
        """Share of other vehicles' light, shape (N,)."""
        return np.asarray(self.shares[:, :NUM_VEHICLE_SOURCES].sum(1))


def write_shares(path: Path, rows: Iterable[tuple[int, BoxShares]]) -> None:
    """Writes the shares of a sequence, given with their image ids.

    Raises:
        ModuleNotFoundError: If the extra `parquet` is not installed.
        OSError: If that fails.
    """
    arrow = load_arrow()
    rows = [(image_id, found) for image_id, found in rows if len(found.boxes_xyxy_px)]
    boxes = np.concatenate([found.boxes_xyxy_px for _, found in rows]) if rows else np.zeros((0, 4), np.int32)
    shares = np.concatenate([found.shares for _, found in rows]) if rows else np.zeros((0, len(SOURCES)), np.float32)
    images = np.array([image_id for image_id, found in rows for _ in found.boxes_xyxy_px], np.int64)
    presets = [found.preset for _, found in rows for _ in found.boxes_xyxy_px]
    columns: dict[str, Any] = {"image_id": images, "preset": arrow.array(presets, arrow.string())}
    columns |= {name: boxes[:, index] for index, name in enumerate(BOX)}
    columns |= {name: shares[:, index].astype(np.float32) for index, name in enumerate(SOURCES)}
    table = arrow.table(columns, metadata={_DIGEST: _digest(images, presets, boxes, shares)})
    with atomic_path(path) as temporary:
        arrow.parquet.write_table(table, temporary, compression="zstd")


def read_shares(path: Path | str) -> Iterator[tuple[int, BoxShares]]:
    """The shares of a sequence, `SPLIT/simulation/S00001/shares.parquet`: image ids with one preset's boxes each.

    An image in which a preset proposes nothing has no entry.

    Raises:
        FileNotFoundError: If there are none, because the data set was made without `--shares`.
        ModuleNotFoundError: If the extra `parquet` is not installed.
        ValueError: If the file is broken; the message names it.
    """
    path = checked_path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; foreglow simulate --shares PRESET makes it")
    arrow = load_arrow()
    try:
        table = arrow.parquet.read_table(path, columns=["image_id", "preset", *BOX, *SOURCES])
        images, presets = table["image_id"].to_numpy(), table["preset"].to_pylist()
        boxes = _columns(table, BOX, np.int32)
        shares = _columns(table, SOURCES, np.float32)
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a Parquet file with shares, {str(error).splitlines()[0]}") from error
    stated = (table.schema.metadata or {}).get(_DIGEST)  # None in data sets of earlier versions
    if stated not in (None, _digest(images, presets, boxes, shares)):
        raise ValueError(f"{path}: expected the shares that were written, the file is damaged or was changed")
    start = 0
    while start < len(images):
        end = start + 1
        while end < len(images) and images[end] == images[start] and presets[end] == presets[start]:
            end += 1
        try:
            found = BoxShares(presets[start], boxes[start:end], shares[start:end])
        except ValueError as error:
            raise ValueError(f"{path}: image {images[start]}: {error}") from error
        yield int(images[start]), found
        start = end


def _digest(
    images: NDArray[np.int64],
    presets: Sequence[str],
    boxes: NDArray[np.integer[Any]],
    shares: NDArray[np.floating[Any]],
) -> bytes:
    """A checksum of the rows: Parquet's own leave out parts of the file, and are off by default."""
    found = hashlib.sha256("\0".join(presets).encode())
    for values, dtype in ((images, "<i8"), (boxes, "<i4"), (shares, "<f4")):
        found.update(np.ascontiguousarray(values, dtype).tobytes())
    return found.hexdigest().encode()


def _columns(table: Any, names: Sequence[str], dtype: type[np.generic]) -> NDArray[Any]:
    return np.stack([table[name].to_numpy().astype(dtype) for name in names], 1)


def load_arrow() -> Any:
    """PyArrow, with its Parquet part.

    Raises:
        ModuleNotFoundError: If the extra `parquet` is not installed.
    """
    import pyarrow
    import pyarrow.parquet

    return pyarrow
