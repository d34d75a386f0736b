"""Whether an image has what no camera sees: edges on an encoder's grid, repeated rows, filled or stuck parts.

Each constant says what of an image is damage, beside the recent images, and what was measured.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.image_change import ImageChange
from foreglow.beam.image_pieces import PieceMeasures
from foreglow.beam.known_images import KnownParts
from foreglow.geometry import Floats

Each = TypeVar("Each")

NUM_RECENT = 18
"""Images that say what is usual; a second of them at the paper's rate."""

NUM_OLDER = 2 * NUM_RECENT
"""Where images have new noise, the first second of so many says what is usual: the latest may show what grows."""

FRESH_SHARE = 0.4
"""Noise is new where more of the samples than this have changed. Measured: raw, MJPEG and 8 Mbit/s above .65 when
moving; frozen below .35, but for single key frames."""

NEW_EDGES_SHARE, EDGE_DEVIATIONS = 0.004, 6.0
"""Damage: more new edges on the encoder's grid than this, by both measures."""

REPEATED_SHARE, NOISY_REPEATED_SHARE = 0.4, 0.2
"""Damage: so many more rows than in any of the recent images are like the row below, such as where a decoder fills in
black. Where an encoder transmits no noise, more rows become alike as it gets darker, but not in a single image. The
second number holds where no row was alike before, as in every image with noise. The same holds for columns."""

FLAT_SHARE = 0.25
"""Damage: so many more rows of a single value than in any of the recent images. Measured: 0 in moving images, but where
it suddenly becomes dark in one of 320x240 at 0.045 bits a pixel, which may be taken for damage; missing halves .4."""

FLAT_PIECES_SHARE, NOISY_FLAT_SHARE, NOISY_CHANGED_SHARE = 0.04, 0.02, 0.35
"""Damage: in two images more pieces of rows of a single value than this, where no usual image had more than the second
number, and in half of them more samples changed than the third: they had noise. Measured: such streams rise by .006 at
most in one image when moving; where noise is not transmitted, dark areas are flat without any damage."""

PAIR_SHARES = np.array([[0.85], [0.5]])
"""Damage: in two images in a row, both `pair_ratios` of pairs of rows are below these shares of the least recent ones.
Measured: never both below 1.3 times these when moving; rows that are repeated behind encoders: .04 to .77, 0 to .38."""

KNOWN_SHARE, NOISY_KNOWN_SHARE = 0.1, 0.02
"""Damage: in two images in a row, more than this share of the pieces of rows are, pixel by pixel, those of earlier
images, where none of the recent images had more than the second number: each had noise. So it is in two images that
have others between them, if these pieces are not those of the image just before, as an encoder may leave them. Then a
decoder or a driver fills only a part of an old buffer. Pieces of a single value do not count. Measured: 0 in the drive
that ships, raw, MJPEG, 8 Mbit/s, and at a quarter of its light; .6 in single images at 1 Mbit/s, for which little is
sent."""

RAW_SHARE = 0.7
"""Where more samples than this change in half of the usual images, they may be those of the image just before, too."""

TWO_WITHIN_S = 0.5
"""Two images of those that are damage only if there are two of a kind: intact ones may come between."""

ROUGH_SHARE, SMOOTH_SHARE = 0.1, 0.02
"""Damage: so many more pieces of rows than in any of the recent images are noise far above a camera's. Two images are
enough for that where none had more than the second number."""

TWICE_SHARE = 0.2
"""Damage: so many rows show their left half once more at the right. Noise makes no two halves alike."""

ONE_VALUE_SHARE = 0.05
"""Damage: so many more samples than usual of one and the same value, neither dark nor white: a decoder's filling."""

WHITE_SHARE = 0.06
"""Damage: so many more samples than usual are white. Measured: lamps that come near add .03 at most in six simulated
cameras, .01 in two real videos of motorways."""

STUCK_SHARE, NUM_STUCK_TILES = 0.25, 4
"""Damage: in so many of the 64 tiles where the noise is usually new, the share of changed samples falls below this
share of the least recent one, in two images in a row. Measured: moving and raw, MJPEG or 8 Mbit/s, no tile is below .5;
most of those stuck behind an encoder of 8 Mbit/s fall below .1. At 1 Mbit/s noise is not transmitted."""

ALIVE_SHARE, MIN_ALIVE = 0.75, 0.25
"""But only while so large a share of these tiles stays above this share: less light has less noise everywhere."""

STUCK_RISE, NOISY_STUCK_SHARE, MIN_BRIGHT = 0.1, 0.08, 200
"""Damage: `share_stuck` exceeds the greatest of the recent images by more than this, where that was no more than the
second number: each had noise; of at least so many samples. Measured: what is stuck in stripes or tiles adds its area,
raw, MJPEG and 8 Mbit/s; moving .01 at most, at 1 Mbit/s .07; at a tenth of the light, with the noise of light, .04."""

STRIPES_RISE, COMB_RISE, COMB = 0.1, 0.1, 1.05
"""Damage: in two images one of the first six numbers of `ImageStripes` exceeds the greatest usual one by more than the
first, where the noise of each usual image was new, or the last one does by more than the second and exceeds the third,
but where it usually does: interlaced images have rows of two moments, which differ the more, the faster something
moves; noise alone gives 1. Measured: in both of two images .06 and .03 at most in six simulated cameras and two real
videos of motorways; where every second row or column is stuck or black behind MJPEG, .08 or .4 and more."""

WORDS_RISE, MANY_WORDS_RISE, NOISY_WORDS_SHARE, MIN_WORDS = 0.1, 0.3, 0.08, 200
"""Damage: in two images `share_before` or `share_above` of `KnownWords` exceeds the greatest usual one by more than the
first number, or the second where the contrast has fallen, where that was no more than the third one and the noise of
each usual image was new; of at least so many words. So small parts of the image just before are found, at whatever
places in each image (where `RAW_SHARE` holds: else an encoder may leave most of an image as it was), and parts whose
rows are alike. Measured: intact raw images, MJPEG and 0.36 bits a pixel .06 at most, raw also at an eighth of the
light; within a second it rises by .007 at most, .08 where nine tenths of the light go."""

CONTRAST_STAYS = 0.6
"""But this does not begin where `contrast` has fallen below this share of the usual one: with the light, the noise ends
where a sensor or an encoder has none in the dark."""

DAMAGE_HOLD_S = 0.5
"""What was damaged is taken for damaged for so long: later images of a stream follow from it."""

RELEARN_S = 10.0
"""What is unusual for longer than this is how the scene is; what is usual is learnt anew."""

LONG_SAME_SHARE, KNOWN_AGAIN_SHARE, FILLED_SHARE, WILD_SHARE, NUM_NEVER = 0.1, 0.1, 0.1, 0.2, 3
"""Damage, whatever was usual: in so many images in a row with new noise, more than these shares of the textured samples
have not changed for long, or of the pieces of rows are known, or grey and of one value; or, with new noise or not, are
wild. Measured in intact images with new noise: .014, .05 and 0 at most, and wild 0."""

NOISE_DEVIATION, NOISY_SHARE = 0.04, 0.2
"""An image has new noise where of its samples, but for filled ones, the second share is textured, and of these the
estimated share that does not change exceeds the share that has not changed for long by no more than the first number:
then no part of the image changes less than others. So it is raw, in MJPEG and at 8 Mbit/s; an encoder that leaves out
parts of the change, as of a bonnet, does so now here, now there."""


class ValueShares(NamedTuple):
    """What shares of an image's samples have certain values.

    Attributes:
        one_value: The one value that most of those have that are neither dark nor white.
        white: White.
    """

    one_value: float
    white: float


class ImageDamage:
    """Whether an image has what no camera sees: edges on an encoder's grid, repeated rows, filled or stuck parts.

    An image that is still as a whole says nothing about its parts: it is not usual, nor between two others in a row.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets the images so far."""
        self._forget()
        self._damaged_s = -math.inf
        self._before_s = 0.0
        self._num_never = 0

    def update(
        self,
        change: ImageChange | None,
        pieces: PieceMeasures,
        values: ValueShares,
        known: KnownParts,
        stripes: Floats | None,
        time_s: float,
        *,
        is_still: bool,
        is_moving: bool | None,
    ) -> bool:
        """Whether the image is damaged, or one shortly before it was.

        Args:
            change: What differs from the image before.
            pieces: What the pieces of its rows say.
            values: What shares of it have one value, or are white.
            known: What of the image was there before.
            stripes: How much its rows and columns differ in turn.
            time_s: The time of the image, by a clock that never goes back.
            is_still: Whether the image as a whole is like the one before, so that no part of it can be stuck.
            is_moving: Whether our vehicle moves so fast that every part of an image must change; None if not known.
        """
        if change is None or stripes is None:
            self._forget_changes()
        else:
            has_edges = change.share_new_edges > NEW_EDGES_SHARE and change.edge_deviations > EDGE_DEVIATIONS
            is_unusual = self._has_unusual_content(change, pieces, values, time_s)
            is_unusual |= self._is_never_so(change, pieces, known, is_still=is_still or is_moving is False)
            if not is_still:
                has_old_parts, had_old_parts = self.has_old_parts(known), self._old_parts.is_latest
                has_earlier = has_old_parts and (known.share_earlier > KNOWN_SHARE or self._is_raw())
                is_unusual |= self._earlier_parts.update(has_earlier, time_s)
                is_unusual |= self._has_stuck_tiles(change) or self._has_stuck_samples(change)
                is_unusual |= self._old_parts.update(has_old_parts, time_s) and had_old_parts
                is_unusual |= self._striped.update(self._has_stripes(stripes), time_s)
                is_unusual |= self._old_words.update(self._has_old_words(change, known), time_s)
            if is_unusual or has_edges:
                self._damaged_s = time_s
            if not (is_unusual or is_still):
                self._learn(change, pieces, values, known, stripes, time_s)
                self._unusual_s = 0.0
            else:
                self._unusual_s += time_s - self._before_s
                if self._unusual_s > RELEARN_S:
                    self._forget()
        self._before_s = time_s
        return time_s - self._damaged_s <= DAMAGE_HOLD_S

    def _forget(self) -> None:
        """Forgets what is usual."""
        self._repeated: deque[float] = deque(maxlen=NUM_RECENT)
        self._repeated_columns: deque[float] = deque(maxlen=NUM_RECENT)
        self._flat: deque[float] = deque(maxlen=NUM_RECENT)
        self._flat_pieces: deque[tuple[float, float]] = deque(maxlen=NUM_OLDER)
        self._flat_twice = _Twice()
        self._rough: deque[float] = deque(maxlen=NUM_OLDER)
        self._one_value: deque[float] = deque(maxlen=NUM_RECENT)
        self._white: deque[float] = deque(maxlen=NUM_RECENT)
        self._known_shares: deque[float] = deque(maxlen=NUM_OLDER)
        self._old_parts: _Twice = _Twice()
        self._earlier_parts: _Twice = _Twice()
        self._is_single, self._num_since_single = False, NUM_RECENT
        self._unusual_s = 0.0
        self._forget_changes()

    def _forget_changes(self) -> None:
        """Forgets what is usual between two images, which is another at another size."""
        self._pair_ratios: deque[NDArray[np.float64]] = deque(maxlen=NUM_RECENT)
        self._has_pairs = False
        self._is_stuck = False
        self._stripes: deque[Floats] = deque(maxlen=NUM_OLDER)
        self._striped = _Twice()
        self._words: deque[tuple[float, float]] = deque(maxlen=NUM_OLDER)
        self._old_words = _Twice()
        self._changes: deque[ImageChange] = deque(maxlen=NUM_OLDER + 1)
        self._tile_shares: deque[NDArray[np.float64]] = deque(maxlen=NUM_RECENT)
        self._could_be_stuck: NDArray[np.bool_] = np.array(False)

    def _is_raw(self) -> bool:
        """Whether nearly all of each usual image has new noise, so that no encoder leaves out parts of the change."""
        usual = _older(self._changes)
        return len(usual) == NUM_RECENT and statistics.median(each.share_changed for each in usual) > RAW_SHARE

    def has_old_parts(self, known: KnownParts) -> bool:
        """Whether parts of the image, but not all of it, were there before, although every image had new noise."""
        older = _older(self._known_shares)
        is_noisy = len(older) == NUM_RECENT and max(older) <= NOISY_KNOWN_SHARE
        is_noisy &= self._num_since_single >= NUM_RECENT
        return is_noisy and not known.is_repeated and known.share > KNOWN_SHARE

    def _has_unusual_content(
        self, change: ImageChange, pieces: PieceMeasures, values: ValueShares, time_s: float
    ) -> bool:
        """Whether the image itself is not as recent ones are, or the second one where one may be so by chance."""
        is_unusual = pieces.share_twice > TWICE_SHARE
        is_unusual |= _has_risen(values.one_value, self._one_value, ONE_VALUE_SHARE)
        is_unusual |= _has_risen(values.white, self._white, WHITE_SHARE)
        if len(self._repeated) >= 2:
            for share, recent in (
                (change.share_repeated, self._repeated),
                (pieces.share_repeated_columns, self._repeated_columns),
            ):
                most = max(recent)
                is_unusual |= share > most + (REPEATED_SHARE if most else NOISY_REPEATED_SHARE)
            is_unusual |= change.share_flat_rows > max(self._flat) + FLAT_SHARE
            most = max(_older(self._rough))
            is_known = len(self._rough) >= NUM_RECENT or most <= SMOOTH_SHARE
            is_unusual |= is_known and pieces.share_rough > most + ROUGH_SHARE
        older = _older(self._flat_pieces)
        is_noisy = len(older) == NUM_RECENT and max(flat for flat, _ in older) <= NOISY_FLAT_SHARE
        is_noisy = is_noisy and statistics.median(changed for _, changed in older) > NOISY_CHANGED_SHARE
        has_flat = is_noisy and change.share_flat_pieces > NOISY_FLAT_SHARE + FLAT_PIECES_SHARE
        is_unusual |= self._flat_twice.update(has_flat, time_s)
        had_pairs, self._has_pairs = self._has_pairs, False
        if len(self._pair_ratios) == NUM_RECENT:
            are_fallen = change.pair_ratios < PAIR_SHARES * np.minimum.reduce(list(self._pair_ratios))
            self._has_pairs = bool(are_fallen.all(axis=0).any())
        return is_unusual or (had_pairs and self._has_pairs)

    def _is_never_so(self, change: ImageChange, pieces: PieceMeasures, known: KnownParts, *, is_still: bool) -> bool:
        """Whether several images in a row are as a moving camera's never are; still ones do not count."""
        if is_still:
            return self._num_never >= NUM_NEVER
        deviation = change.share_stuck_texture - change.share_same_long
        is_textured = change.share_textured > NOISY_SHARE * (1.0 - pieces.share_filled)
        has_new_noise = is_textured and deviation < NOISE_DEVIATION
        is_so = has_new_noise and (
            change.share_same_long > LONG_SAME_SHARE
            or known.share > KNOWN_AGAIN_SHARE
            or pieces.share_filled > FILLED_SHARE
        )
        is_so |= pieces.share_wild > WILD_SHARE
        self._num_never = self._num_never + 1 if is_so else 0
        return self._num_never >= NUM_NEVER

    def _has_stuck_tiles(self, change: ImageChange) -> bool:
        """Whether parts are as before, in the second image in a row of those not still."""
        could_be_stuck, self._could_be_stuck = self._could_be_stuck, np.array(False)
        if len(self._tile_shares) == NUM_RECENT:
            self._could_be_stuck = _same_tiles(change.tile_shares, np.minimum.reduce(list(self._tile_shares)))
        return int(np.count_nonzero(could_be_stuck & self._could_be_stuck)) >= NUM_STUCK_TILES

    def _has_stuck_samples(self, change: ImageChange) -> bool:
        """Whether parts of whatever form are as before, twice in a row, or of one value, in the light there was."""
        usual = _older(list(self._changes)[:-1])  # the image before may be the first that is stuck
        if len(usual) < NUM_RECENT or change.num_bright < MIN_BRIGHT:
            return False
        stuck = max(each.share_stuck for each in usual)
        filled = max(each.share_filled for each in usual)
        is_noisy = min(each.share_changed for each in usual) > FRESH_SHARE
        is_noisy &= max(stuck, filled) <= NOISY_STUCK_SHARE
        has_risen = change.share_stuck > stuck + STUCK_RISE or change.share_filled > filled + STUCK_RISE
        contrast = statistics.median(each.contrast for each in usual)
        is_lit = self._is_stuck or change.contrast > CONTRAST_STAYS * contrast
        self._is_stuck = is_noisy and has_risen and is_lit
        return self._is_stuck

    def _has_old_words(self, change: ImageChange, known: KnownParts) -> bool:
        """Whether more words than usual are as in the image just before, or as above, in the light there was."""
        usual = _older(self._words)
        if len(usual) < NUM_RECENT or known.words.num < MIN_WORDS:
            return False
        most = np.array([max(each) for each in zip(*usual, strict=True)])
        shares = np.array([known.words.share_before, known.words.share_above])
        changes = _older(self._changes)
        is_noisy = min(each.share_changed for each in changes) > FRESH_SHARE
        could_be = is_noisy & np.array([self._is_raw(), True]) & (most <= NOISY_WORDS_SHARE)
        contrast = statistics.median(each.contrast for each in changes)
        is_lit = self._old_words.is_latest or change.contrast > CONTRAST_STAYS * contrast
        return bool((could_be & (shares > most + (WORDS_RISE if is_lit else MANY_WORDS_RISE))).any())

    def _has_stripes(self, stripes: Floats) -> bool:
        """Whether rows or columns differ in turn more than they usually do."""
        usual = _older(self._stripes)
        if len(usual) < NUM_RECENT:
            return False
        most = np.maximum.reduce(usual)
        rise = stripes - most
        has_comb = (rise[:, -1] > COMB_RISE) & (most[:, -1] <= COMB) & (stripes[:, -1] > COMB)
        is_noisy = min(each.share_changed for each in _older(self._changes)) > FRESH_SHARE
        return bool(has_comb.any() or (is_noisy and (rise[:, :-1] > STRIPES_RISE).any()))

    def _learn(
        self,
        change: ImageChange,
        pieces: PieceMeasures,
        values: ValueShares,
        known: KnownParts,
        stripes: Floats,
        time_s: float,
    ) -> None:
        """Counts an image as usual, but for what would be damage in two images."""
        self._repeated.append(change.share_repeated)
        self._repeated_columns.append(pieces.share_repeated_columns)
        self._flat.append(change.share_flat_rows)
        self._rough.append(pieces.share_rough)
        self._one_value.append(values.one_value)
        self._white.append(values.white)
        self._changes.append(change)
        if self._old_parts.is_latest:  # of a fault the first; where an encoder sends next to nothing of an image, alone
            self._is_single = True
        else:
            self._known_shares.append(known.share)
            self._num_since_single += 1
            if self._is_single and not self._earlier_parts.waits(time_s):
                self._is_single, self._num_since_single = False, 0
        if not self._flat_twice.is_latest:
            self._flat_pieces.append((change.share_flat_pieces, change.share_changed))
        if not self._striped.is_latest:
            self._stripes.append(stripes)
        if not self._old_words.is_latest:
            self._words.append((known.words.share_before, known.words.share_above))
        if not self._has_pairs:
            self._pair_ratios.append(change.pair_ratios)
        if np.count_nonzero(self._could_be_stuck) < NUM_STUCK_TILES:
            self._tile_shares.append(change.tile_shares)


class _Twice:
    """Whether there were two images of a kind of which one alone may come by chance, with intact ones between or not.

    Attributes:
        is_latest: Whether the latest image is of the kind.
    """

    def __init__(self) -> None:
        self.is_latest = False
        self._before_s: float | None = None

    def update(self, is_so: bool, time_s: float) -> bool:
        """Whether the next image is of the kind, and another one shortly before it was."""
        self.is_latest = is_so
        if not is_so:
            return False
        is_second = self.waits(time_s)
        self._before_s = time_s
        return is_second

    def waits(self, time_s: float) -> bool:
        """Whether there was one of the kind so shortly before that time."""
        return self._before_s is not None and 0 < time_s - self._before_s <= TWO_WITHIN_S


def _same_tiles(shares: NDArray[np.float64], least: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which tiles hardly change, of those where the noise is usually new, while others change as ever."""
    is_fresh = least > FRESH_SHARE
    num_alive = np.count_nonzero(is_fresh & (shares > ALIVE_SHARE * least))
    is_same: NDArray[np.bool_] = is_fresh & (shares < STUCK_SHARE * least)
    return is_same & np.bool_(num_alive >= MIN_ALIVE * np.count_nonzero(is_fresh))


def _has_risen(share: float, recent: deque[float], by: float) -> bool:
    return len(recent) >= 2 and share > statistics.median(recent) + by


def _older(recent: Sequence[Each]) -> list[Each]:
    """The images of a second that say what is usual: of two seconds the first, of less all up to a second."""
    return list(itertools.islice(recent, NUM_RECENT))
