"""What differs between two images, in NumPy: the specification of the native comparer."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_PX, SQUARE_PX, NUM_TILES, ROW_STEP = 8, 16, 8, 7
EDGE_LEVELS, RARE = 10, 1000
FILLED_SHARE, RARELY_FILLED = 0.9, 20
NUM_PIECES, NUM_COLUMNS = 8, 160
BORDER_SHARE = 8


def reference_change(before: NDArray[Any], now: NDArray[Any], top: int) -> dict[str, Any]:
    """By name, the fields of `_native.ImageChange` for images of one size and type with pixels up to `top`."""
    unit = top / 255  # of one grey level
    height, width = min(BLOCK_PX, now.shape[0]), min(BLOCK_PX, now.shape[1])
    wide = now.astype(np.int64) - before
    num_down, num_across = now.shape[0] // height, now.shape[1] // width
    blocks = wide[: num_down * height, : num_across * width].reshape(num_down, height, num_across, width)
    changes = np.abs(blocks.sum(axis=(1, 3))) * (1.0 / (unit * height * width))
    middle = changes[num_down // BORDER_SHARE : num_down - num_down // BORDER_SHARE]
    is_changed = samples_of(before) != samples_of(now)
    down, across = np.arange(num_down) * NUM_TILES // num_down, np.arange(num_across) * NUM_TILES // num_across
    tiles = np.ones((NUM_TILES, NUM_TILES))
    for row, column in itertools.product(set(down), set(across)):
        tiles[row, column] = is_changed[down == row][:, across == column].mean()
    edges, other_edges = (
        num_edges(wide, first_px, unit) + num_edges(wide.T, first_px, unit) for first_px in (SQUARE_PX, SQUARE_PX // 2)
    )
    rows = now[ROW_STEP // 2 : now.shape[0] - 1 : ROW_STEP], now[ROW_STEP // 2 + 1 :: ROW_STEP]
    return {
        "strongest": np.sort(middle, axis=None)[-1 - middle.size // RARE],
        "tiles": tiles,
        "num_samples": changes.size,
        "num_changed": np.count_nonzero(is_changed),
        "num_edges": edges,
        "num_other_edges": other_edges,
        "num_rows": len(rows[0]),
        "num_repeated_rows": np.count_nonzero((rows[0] == rows[1]).all(axis=1)),
        "share_flat_rows": share_flat(now, 1),
        "share_flat_pieces": share_flat(now, NUM_PIECES if now.shape[1] >= NUM_PIECES else 1),
        "pair_ratios": pair_ratios(now),
    }


def samples_of(image: NDArray[Any]) -> NDArray[np.int64]:
    """One pixel of each block, anywhere in it."""
    rows, columns = places(image)
    return np.asarray(image[rows, columns], np.int64)


def besides_of(image: NDArray[Any]) -> NDArray[np.int64]:
    """The pixels to the right of the samples; at the right border those to the left."""
    rows, columns = places(image)
    besides = np.where(columns + 1 < image.shape[1], columns + 1, np.maximum(columns - 1, 0))
    return np.asarray(image[rows, besides], np.int64)


def places(image: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the samples."""
    height, width = min(BLOCK_PX, image.shape[0]), min(BLOCK_PX, image.shape[1])
    num_down, num_across = image.shape[0] // height, image.shape[1] // width
    numbers = np.arange(num_down * num_across).reshape(num_down, num_across)
    mixed = numbers * 2654435761 % 2**32
    rows = numbers // num_across * height + (mixed >> 24) * height // 256
    columns = numbers % num_across * width + (mixed >> 16) % 256 * width // 256
    return rows, columns


def reference_parts(images: list[NDArray[Any]], reference: NDArray[Any] | None, top: int) -> dict[str, float]:
    """By name, what says whether parts are stuck: of the last of two or three images, none of which came twice.

    `reference` is the image that says what is bright; all is without one.
    """
    now, before = samples_of(images[-1]), samples_of(images[-2])
    is_changed = now != before
    was_changed = before != samples_of(images[-3]) if len(images) == 3 else np.full(now.shape, fill_value=True)
    is_bright = np.full(now.shape, fill_value=True)
    if reference is not None:
        is_bright = samples_of(reference) > samples_of(reference).mean().astype(np.int64)
    levels = now * 255 // top
    is_same = ~is_changed
    share_filled = 0.0
    if (is_same & is_bright).any():
        is_level = levels == np.bincount(levels[is_same & is_bright]).argmax()
        share = is_same[is_bright & is_level].mean()
        if share > FILLED_SHARE and (is_same & is_level)[is_bright].mean() >= 1 / RARELY_FILLED:
            share_filled = min((is_same & is_level).mean(), (is_same & is_level)[is_bright].mean())
    is_textured = now != besides_of(images[-1])
    means = [now[is_changed & part].mean() if (is_changed & part).any() else 0.0 for part in (is_bright, ~is_bright)]
    return {
        "num_bright": int(np.count_nonzero(is_bright)),
        "share_stuck": min(share_stuck(is_changed[part], was_changed[part]) for part in (is_bright, is_bright | True)),
        "num_textured": int(np.count_nonzero(is_textured)) if is_changed.any() else 0,
        "share_stuck_texture": share_stuck(is_changed[is_textured], was_changed[is_textured]),
        "share_filled": share_filled,
        "contrast": (means[0] - means[1]) * 255 / top,
    }


def share_stuck(is_changed: NDArray[np.bool_], was_changed: NDArray[np.bool_]) -> float:
    """The share that never changes, if what changes is drawn anew each time."""
    share_twice = (is_changed & was_changed).mean() if is_changed.size else 0.0
    return 1.0 - is_changed.mean() * was_changed.mean() / share_twice if share_twice else 0.0


def share_flat(image: NDArray[Any], num_pieces: int) -> float:
    """Of every seventh row, cut into so many pieces, the share of pieces with a single value."""
    borders = np.arange(num_pieces + 1) * image.shape[1] // num_pieces
    pieces = [row[a:b] for row in image[ROW_STEP // 2 :: ROW_STEP] for a, b in itertools.pairwise(borders)]
    return float(np.mean([len(set(piece.tolist())) == 1 for piece in pieces])) if pieces else 0.0


def pair_ratios(image: NDArray[Any]) -> NDArray[np.float64]:
    """By absolute and squared differences, those within pairs of rows over those between, and the reverse."""
    steps = np.abs(np.diff(image[:, :: max(1, image.shape[1] // NUM_COLUMNS)].astype(np.int64), axis=0))
    within, between = (np.array([part.sum(), np.square(part).sum()]) + 1.0 for part in (steps[::2], steps[1::2]))
    return np.stack([within / between, between / within], axis=1)


def num_edges(change: NDArray[np.int64], first_px: int, unit: float) -> int:
    """Segments of horizontal lines, every 16 pixels from `first_px` on, across which the change differs."""
    num = change.shape[1] // SQUARE_PX
    jumps = change[first_px::SQUARE_PX, : num * SQUARE_PX] - change[first_px - 1 : -1 : SQUARE_PX, : num * SQUARE_PX]
    sums = jumps.reshape(len(jumps), num, SQUARE_PX).sum(axis=2)
    return int(np.count_nonzero(np.abs(sums) > EDGE_LEVELS * SQUARE_PX * unit))
