"""Whether an image, or a part of it, was there before, pixel by pixel.

Noise makes no two images of a camera alike, nor two pieces of their rows. Where pieces come again, a driver or a
decoder shows memory that it has not filled anew: whichever part of the image that is, and from whichever image.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.image_pieces import middle
from foreglow.types import Image

NUM_KNOWN = 36
"""Different images that are known again when one comes back; a driver of V4L2 has at most 32 buffers."""

NUM_ROW_PIECES = 8
"""Each row is cut into so many pieces, of which each has a checksum of its own."""

COMES_BACK_SHARE = 0.2
"""An image that comes back has more pieces of more than a single value than this: all images without any are alike."""

WORD_BYTES = 8


class KnownWords(NamedTuple):
    """What of the words of an image, eight bytes of a row each, comes again; those of a single value do not count.

    Attributes:
        num: How many there are.
        share_before: Share of them that the image just before had at the same place, whichever places these are.
        share_above: Share of them, but for the first row, that the row above has at the same place, of the rows that
            are looked at.
    """

    num: int
    share_before: float
    share_above: float


@dataclass(frozen=True, slots=True)
class KnownParts:
    """What of an image was there before.

    Attributes:
        share: Share of the pieces that recent images had at the same place, without those of a single value.
        share_earlier: The same, but for the pieces that are those of the image just before, as an encoder leaves them.
        is_repeated: Whether the whole image was there before, but for what is written into its border.
        is_back: Whether it was, and another one came between.
        words: What of its words comes again.
    """

    share: float
    share_earlier: float
    is_repeated: bool
    is_back: bool
    words: KnownWords


class KnownImages:
    """Keeps checksums of the pieces of the latest different images."""

    def __init__(self) -> None:
        self._keys = np.zeros(0, np.uint64)
        self.reset()

    def reset(self) -> None:
        """Forgets the images so far."""
        self._known: OrderedDict[bytes, int] = OrderedDict()
        self._latest, self._place = b"", 0
        self._sums = np.zeros((NUM_KNOWN, 0, 0), np.uint64)
        self._words = np.zeros((0, 0), np.uint64)

    def update(self, rows: Image) -> KnownParts:
        """What of the next image is known; `rows` are some of its rows, always the same ones."""
        words, starts = _words(rows)
        known_words = self._known_words(words, rows.itemsize)
        sums = self._checksums(words, starts)
        if sums.shape != self._sums.shape[1:]:
            self._known.clear()
            self._sums = np.zeros((NUM_KNOWN, *sums.shape), np.uint64)
        before, self._latest = self._latest, sums[middle(len(sums))].tobytes()
        if self._latest in self._known:
            self._place = self._known[self._latest]
            share, is_other = float(_is_uneven(words, starts).mean()), self._latest != before
            is_back = share > COMES_BACK_SHARE and is_other
            return KnownParts(share, share if is_other else 0.0, is_repeated=True, is_back=is_back, words=known_words)
        num = len(self._known)
        is_known = (self._sums[:num] == sums).any(axis=0)
        is_as_before = self._sums[self._place] == sums
        self._place = num if num < NUM_KNOWN else self._known.popitem(last=False)[1]
        self._known[self._latest] = self._place
        self._sums[self._place] = sums
        if not is_known.any():
            return KnownParts(0.0, 0.0, is_repeated=False, is_back=False, words=known_words)
        is_known &= _is_uneven(words, starts)
        share_earlier = float((is_known & ~is_as_before).mean())
        return KnownParts(float(is_known.mean()), share_earlier, is_repeated=False, is_back=False, words=known_words)

    def _known_words(self, words: NDArray[np.uint64], pixel_bytes: int) -> KnownWords:
        """What comes again of `words`, shape (rows, words in a row), of pixels of so many bytes."""
        before, self._words = self._words, words
        most = (1 << 8 * pixel_bytes) - 1
        is_uneven = words != (words & np.uint64(most)) * np.uint64(((1 << 64) - 1) // most)  # its first pixel, repeated
        is_as_before = is_uneven & (words == before) if before.shape == words.shape else np.zeros(0, np.bool_)
        is_as_above = is_uneven[1:] & (words[1:] == words[:-1])
        num, num_below, num_before, num_above = (
            int(np.count_nonzero(each)) for each in (is_uneven, is_uneven[1:], is_as_before, is_as_above)
        )
        return KnownWords(num, num_before / max(1, num), num_above / max(1, num_below))

    def _checksums(self, words: NDArray[np.uint64], starts: NDArray[np.intp]) -> NDArray[np.uint64]:
        """By row and piece, a sum of the words times odd numbers; all of it modulo 2 to the power of 64."""
        if len(self._keys) != words.shape[1]:
            halves = np.random.default_rng(0).integers(0, 1 << 63, words.shape[1], np.uint64)
            self._keys = 2 * halves + np.uint64(1)
        sums: NDArray[np.uint64] = np.add.reduceat(words * self._keys, starts, axis=1)
        return sums


def _words(rows: Image) -> tuple[NDArray[np.uint64], NDArray[np.intp]]:
    """The rows in words of eight bytes, the last pixel repeated to fill one; where in a row its pieces begin."""
    width_px, word_px = rows.shape[1], WORD_BYTES // rows.itemsize
    num_words = -(-width_px // word_px)
    filled = np.empty((len(rows), num_words * word_px), rows.dtype)
    filled[:, :width_px] = rows
    filled[:, width_px:] = rows[:, -1:]
    num_pieces = min(NUM_ROW_PIECES, num_words)
    return filled.view(np.uint64), np.arange(num_pieces) * num_words // num_pieces


def _is_uneven(words: NDArray[np.uint64], starts: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which pieces have more than a single value: more than one word, so that a pattern without noise has one, too."""
    has_changed = np.zeros(words.shape, np.bool_)
    has_changed[:, 1:] = words[:, 1:] != words[:, :-1]
    has_changed[:, starts] = False
    is_uneven: NDArray[np.bool_] = np.logical_or.reduceat(has_changed, starts, axis=1)
    return is_uneven
