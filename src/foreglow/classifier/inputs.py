"""The inputs of a classifier: crops of the proposals and a few features, the same in training and in the car.

The contrast of a crop is stretched to its own minimum and maximum, so its absolute brightness goes into the features.
If the model wants it, a second channel shows the same region of an earlier frame, in which everything that has
brightened or moved stands out, without any tracking; and a last one shows a larger region around the box.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import foreglow._native as _native
from foreglow.types import Frame, Image, Proposals
from foreglow.types.arrays import with_adjacent_columns

FEATURES = (
    "darkest",
    "brightest",
    "width",
    "height",
    "frame_mean",
    "frame_brightest",
    "has_earlier",
    "row",
    "column",
    "side",
)
"""Names of the features in order: of the crop, of the box, of the frame, and where in the frame the box is; `_features`
has the units."""

NUMS_FEATURES = (0, 7, 9, len(FEATURES))
"""Models read none, those without the place in the frame, those that are alike on both sides of the road, or all."""

MAX_CROP_PX = 1024
"""Largest side of a model's crops, pixels; published ones have 64."""

MAX_CROPS_BYTES = 1 << 28
"""Memory of the crops that the classifier makes at once; those of our model have 12 kB a box."""

MAX_REACH = 100
"""Largest `support` and `context`: a crop of a box of ten pixels is then as wide as an image."""

_LOGARITHM = 255.0
"""Levels become log(1 + 255 level) / log 256: from 0 to 1, with as much room for dark greys as for bright ones."""

_SAMPLING_PX = 16
"""The brightness of the frame is taken from every 16th pixel of every 16th row."""

_EARLIEST, _LATEST = 1.5, 0.6
"""An earlier frame is used if its age is between these shares of the lag that the model wants."""

_SPACING = 0.2
"""Earlier frames are kept at least this share of the lag apart; copying every frame would cost more than it gains."""


@dataclass(frozen=True, slots=True)
class InputSpec:
    """The inputs that a model wants.

    Attributes:
        size_px: Side of the square crops.
        support: A crop reaches this many widths and heights of its box to either side of its centre (paper: M = 2).
        lag_s: Age of the frame in the second channel; None for one channel.
        num_features: Length of the feature vector: the first so many of `FEATURES`, one of `NUMS_FEATURES`.
        context: The last channel shows the box's surroundings: this many widths and heights to either side; None for
            no such channel.
        together: Whether the model compares the boxes of a frame with one another, and so reads all of them at once.

    Raises:
        ValueError: If a field is out of range.
    """

    size_px: int = 64
    support: int = 2
    lag_s: float | None = None
    num_features: int = 0
    context: int | None = None
    together: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.size_px <= MAX_CROP_PX:
            raise ValueError(f"InputSpec.size_px: expected 1 to {MAX_CROP_PX}, got {self.size_px}")
        if not 1 <= self.support <= MAX_REACH:
            raise ValueError(f"InputSpec.support: expected 1 to {MAX_REACH}, got {self.support}")
        if self.lag_s is not None and not 0 < self.lag_s <= 10:
            raise ValueError(f"InputSpec.lag_s: expected above 0 and at most 10 seconds, got {self.lag_s}")
        if self.context is not None and not 1 <= self.context <= MAX_REACH:
            raise ValueError(f"InputSpec.context: expected 1 to {MAX_REACH}, got {self.context}")
        if self.num_features not in NUMS_FEATURES:
            raise ValueError(f"InputSpec.num_features: expected one of {NUMS_FEATURES}, got {self.num_features}")
        if self.together and self.num_features != len(FEATURES):
            raise ValueError(f"InputSpec.num_features: expected {len(FEATURES)} with together, got {self.num_features}")

    @property
    def num_channels(self) -> int:
        """1, and one each for an earlier frame and for the surroundings."""
        return 1 + (self.lag_s is not None) + (self.context is not None)

    @property
    def bytes_a_box(self) -> int:
        """Memory of the crops of a box."""
        return np.dtype(np.float32).itemsize * self.num_channels * self.size_px**2


@dataclass(frozen=True, slots=True, eq=False)
class ClassifierInputs:
    """The inputs of one frame's proposals.

    Attributes:
        crops: Shape (N, C, S, S), float32 in [0, 1]. The channel of the earlier frame is stretched by the range of the
            first, clipped to [0, 1], and all 0 without an earlier frame. That of the surroundings is stretched by its
            own range.
        features: Shape (N, F), float32.
    """

    crops: NDArray[np.float32]
    features: NDArray[np.float32]


class InputMaker:
    """Makes a model's inputs frame by frame; remembers earlier frames if the model wants them."""

    def __init__(self, spec: InputSpec) -> None:
        self.spec = spec
        self._earlier: list[tuple[int, Image]] = []  # oldest first, with their times in nanoseconds

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._earlier.clear()

    def make(self, frame: Frame, proposals: Proposals) -> ClassifierInputs:
        """The inputs for `proposals`, boxes of `frame`; if time goes back, earlier frames are forgotten."""
        (inputs,) = self.make_parts(frame, proposals, max(1, len(proposals)))
        return inputs

    def make_parts(self, frame: Frame, proposals: Proposals, size: int) -> Iterator[ClassifierInputs]:
        """Like `make`, for `size` boxes at a time, which bounds the memory; one part if there are none."""
        earlier = self._seen_before(frame)
        self._remember(frame)
        image, boxes = with_adjacent_columns(frame.image), np.ascontiguousarray(proposals.boxes_xyxy_px)
        starts = range(0, max(1, len(boxes)), size)
        return (self._inputs(image, earlier, boxes[start : start + size]) for start in starts)

    def _inputs(self, image: Image, earlier: Image | None, boxes: NDArray[np.int32]) -> ClassifierInputs:
        spec = self.spec
        if not len(boxes):
            crops = np.zeros((0, spec.num_channels, spec.size_px, spec.size_px), np.float32)
            return ClassifierInputs(crops, np.zeros((0, spec.num_features), np.float32))
        crops, levels = _native.extract_crops(image, boxes, spec.support, spec.size_px, earlier)
        if earlier is None and spec.lag_s is not None:
            crops = np.concatenate([crops, np.zeros_like(crops)], axis=1)
        if spec.context is not None:
            surroundings, _ = _native.extract_crops(image, boxes, spec.context, spec.size_px, None)
            crops = np.concatenate([crops, surroundings], axis=1)
        features = np.zeros((len(boxes), 0), np.float32)
        if spec.num_features:
            features = _features(image, boxes, levels, earlier is not None)[:, : spec.num_features]
        return ClassifierInputs(crops, features)

    def _seen_before(self, frame: Frame) -> Image | None:
        """The earlier image whose age is nearest to the lag; None without one."""
        if self.spec.lag_s is None:
            return None
        if self._earlier and (frame.timestamp_ns <= self._earlier[-1][0] or not _is_alike(frame, self._earlier[-1][1])):
            self._earlier.clear()
        lag_ns = self.spec.lag_s * 1e9
        self._earlier = [kept for kept in self._earlier if frame.timestamp_ns - kept[0] <= _EARLIEST * lag_ns]
        kept_with_it = [] if frame.earlier is None else [(frame.earlier.timestamp_ns, frame.earlier.image)]
        ages_ns = (_LATEST * lag_ns, _EARLIEST * lag_ns)
        usable = [
            kept for kept in [*kept_with_it, *self._earlier] if ages_ns[0] <= frame.timestamp_ns - kept[0] <= ages_ns[1]
        ]
        if not usable:
            return None
        return min(usable, key=lambda kept: abs(frame.timestamp_ns - kept[0] - lag_ns))[1]

    def _remember(self, frame: Frame) -> None:
        """Keeps a copy of the frame's image, since a camera may reuse its memory."""
        if self.spec.lag_s is None:
            return
        spacing_ns = _SPACING * self.spec.lag_s * 1e9
        if not self._earlier or frame.timestamp_ns - self._earlier[-1][0] >= spacing_ns:
            kept: Image = frame.image.copy(order="C")
            self._earlier.append((frame.timestamp_ns, kept))


def _is_alike(frame: Frame, image: Image) -> bool:
    return frame.image.shape == image.shape and frame.image.dtype == image.dtype


def _features(
    image: Image, boxes_xyxy_px: NDArray[np.int32], levels: NDArray[np.float32], has_earlier: bool
) -> NDArray[np.float32]:
    """Shape (N, 10), in the order of `FEATURES`: levels and sizes as logarithms, sizes relative to the frame's width.

    The place is that of the box's centre from the frame's, in quarters of the width: rows downwards, columns to either
    side, since roads are alike where traffic keeps to the left, and the side itself, positive to the right.
    """
    full_scale, (height_px, width_px) = np.iinfo(image.dtype).max, image.shape
    sample = image[::_SAMPLING_PX, ::_SAMPLING_PX]
    features = np.empty((len(boxes_xyxy_px), len(FEATURES)), np.float32)
    features[:, 0:2] = _logarithmic(levels)
    features[:, 2:4] = np.log2((boxes_xyxy_px[:, 2:] - boxes_xyxy_px[:, :2]) / width_px) / 10.0 + 1.0
    features[:, 4] = _logarithmic(np.float32(sample.mean() / full_scale))
    features[:, 5] = _logarithmic(np.float32(sample.max() / full_scale))
    features[:, 6] = has_earlier
    features[:, 7] = (boxes_xyxy_px[:, 1] + boxes_xyxy_px[:, 3] - height_px) * (2.0 / width_px)
    features[:, 9] = (boxes_xyxy_px[:, 0] + boxes_xyxy_px[:, 2] - width_px) * (2.0 / width_px)
    features[:, 8] = np.abs(features[:, 9])
    return features


def _logarithmic(level: Any) -> Any:
    return np.log1p(_LOGARITHM * level) / np.log1p(_LOGARITHM)
