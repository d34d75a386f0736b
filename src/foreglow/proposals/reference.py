"""The proposal stage in NumPy and SciPy: the readable specification that every other back end must match.

The paper gives the threshold, the window, the gap and the deviation filter. The published code adds steps that the
paper does not mention; each is a named parameter of `ProposalConfig` whose default reproduces that code box for box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.config import ProposalConfig
from foreglow.proposals.splitting import SplitRule, light_levels, split_blob
from foreglow.types import Image, Proposals
from foreglow.types.arrays import check_image, check_kind

ROUNDING = 1e-10
"""Difference that counts as equal, in units of the dynamic range. Where a flat patch equals its own mean, sums in
double precision differ by up to 1e-11, while one grey level of 16 bits is 1e-5. Equal values are not above the
threshold."""

MAX_REDUCTION = 64
"""Largest number of frame pixels per working pixel, along each axis: keeps the sums of a block within 32 bits."""


@dataclass(frozen=True, slots=True)
class WorkingSizes:
    """The sizes of a `ProposalConfig` in working pixels, for the width of the actual frames.

    Attributes:
        reduction: Frame pixels per working pixel, along each axis.
        half_window_px: Half the side of the local mean's window (h).
        gap_px: Largest L-infinity distance that still joins two pixels (d).
        min_area_px, max_area_px, min_width_px: Limits of a box, inclusive.
    """

    reduction: int
    half_window_px: int
    gap_px: int
    min_area_px: float
    max_area_px: float
    min_width_px: float


def working_sizes(config: ProposalConfig, width_px: int) -> WorkingSizes:
    """The sizes of `config` for a frame of `width_px` columns; the rule is in `ProposalConfig`.

    Raises:
        ValueError: If the frame would be reduced by more than `MAX_REDUCTION`.

    >>> working_sizes(ProposalConfig(), 1280)
    WorkingSizes(reduction=2, half_window_px=9, gap_px=4, min_area_px=11.0, max_area_px=1999.0, min_width_px=6.0)
    >>> working_sizes(ProposalConfig(), 2560).reduction
    4
    """
    reduction = max(1, int(config.reduction * width_px / config.reference_width_px + 0.5))
    if reduction > MAX_REDUCTION:
        raise ValueError(
            f"proposals.reference_width_px: expected frames that are reduced by at most {MAX_REDUCTION}, "
            f"one of {width_px} columns is reduced by {reduction}"
        )
    ratio = (width_px // reduction) / (config.reference_width_px / config.reduction)
    return WorkingSizes(
        reduction=reduction,
        half_window_px=max(1, int(config.window_px // 2 * ratio + 0.5)),
        gap_px=max(1, int(config.gap_px * ratio + 0.5)),
        min_area_px=config.min_area_px * ratio * ratio,
        max_area_px=config.max_area_px * ratio * ratio,
        min_width_px=config.min_width_px * ratio,
    )


class Stages(NamedTuple):
    """The intermediate images of one frame, all of shape (working height, working width).

    Attributes:
        blurred: The blurred working image I, float64 in [0, 1].
        mean: The local mean mu, float64.
        threshold: T, float64.
        binary: I > T, bool.
        labels: Number of the blob of each pixel that is set, int32; 0 elsewhere.
        levels: Light as whole numbers, int64, 0..1023, by which blobs are split; all 0 if splitting is off.
    """

    blurred: NDArray[np.float64]
    mean: NDArray[np.float64]
    threshold: NDArray[np.float64]
    binary: NDArray[np.bool_]
    labels: NDArray[np.int32]
    levels: NDArray[np.int64]


Verdict: TypeAlias = Literal["kept", "size", "deviation"]
"""What the filters make of a blob's box: it is kept, or left out by its size or by its deviation."""


class ReferenceProposer:
    """The proposal stage written as its equations; about a hundred times slower than the native back end."""

    def __init__(self, config: ProposalConfig) -> None:
        check_kind("config", config, ProposalConfig)
        self.config = config

    def propose(self, image: Image) -> Proposals:
        """The proposals of `image`: shape (height, width), uint8 or uint16, any strides.

        Raises:
            ValueError: If there is no such image, or the configured region lies outside it.
        """
        check_image("image", image)
        config = self.config
        x_offset_px, y_offset_px, _ = cut_region(image, config)
        reduction = working_sizes(config, image.shape[1]).reduction
        stages = self.stages(image)
        judged = [] if stages is None else self.judged(stages, image.shape[1])
        kept = [(y1, x1, y2, x2) for (x1, y1, x2, y2), verdict in judged if verdict == "kept"]
        y1x1y2x2 = np.array(sorted(kept), np.int32).reshape(-1, 4)
        boxes_xyxy_px = y1x1y2x2[:, [1, 0, 3, 2]] * reduction
        return Proposals(boxes_xyxy_px + np.array([x_offset_px, y_offset_px] * 2, np.int32))

    def judged(self, stages: Stages, width_px: int) -> list[tuple[tuple[int, int, int, int], Verdict]]:
        """The boxes of all blobs of a frame of `width_px` columns, x1, y1, x2, y2 in working pixels, half-open."""
        from scipy import ndimage

        config, sizes = self.config, working_sizes(self.config, width_px)
        blobs = [
            (rows.start, columns.start, rows.stop, columns.stop)
            for rows, columns in ndimage.find_objects(stages.labels)
        ]
        if config.split_saddle > 0:
            rule = SplitRule(config.split_saddle, sizes.min_area_px, sizes.min_width_px)
            blobs = sorted({part for blob in blobs for part in split_blob(blob, stages.binary, stages.levels, rule)})
        judged: list[tuple[tuple[int, int, int, int], Verdict]] = []
        for y1, x1, y2, x2 in blobs:
            area_px = (x2 - x1) * (y2 - y1)
            if not (sizes.min_area_px <= area_px <= sizes.max_area_px and x2 - x1 >= sizes.min_width_px):
                judged.append(((x1, y1, x2, y2), "size"))
                continue
            inside = stages.blurred[y1:y2, x1:x2]
            deviation = np.abs(inside - inside.mean()).mean()  # paper: mean absolute deviation filter s
            verdict: Verdict = "kept" if deviation > config.min_deviation + ROUNDING else "deviation"
            judged.append(((x1, y1, x2, y2), verdict))
        return judged

    def stages(self, image: Image) -> Stages | None:
        """The intermediate images of `image`, or None if it is smaller than one working pixel."""
        config = self.config
        sizes = working_sizes(config, image.shape[1])
        _, _, region = cut_region(image, config)
        sums = block_sums(region, sizes.reduction)
        if sums.size == 0:
            return None
        full_scale = np.iinfo(image.dtype).max * sizes.reduction**2
        blurred = blur(normalised(sums, full_scale, config), config)
        mean = local_mean(blurred, sizes.half_window_px, config.window)
        threshold = dynamic_threshold(blurred, mean, config.kappa, config.eps)
        binary = exceeds_threshold(blurred, threshold)
        levels = np.zeros(sums.shape, np.int64)
        if config.split_saddle > 0 and sums.min() < sums.max():
            black, white = (int(sums.min()), int(sums.max())) if config.normalise else (0, full_scale)
            levels = light_levels(sums, black, white)
        return Stages(blurred, mean, threshold, binary, label_blobs(binary, sizes.gap_px), levels)


def cut_region(image: Image, config: ProposalConfig) -> tuple[int, int, Image]:
    """Left and top of the considered region in pixels, and the view of `image` inside it.

    Raises:
        ValueError: If the region lies outside the image.
    """
    height_px, width_px = image.shape
    config.check_region(height_px, width_px)
    x1, y1, x2, y2 = config.region_xyxy_px or (0, 0, width_px, height_px)
    return x1, y1, image[y1 : min(y2, height_px), x1 : min(x2, width_px)]


def block_sums(image: Image, reduction: int) -> NDArray[np.int64]:
    """Sums over whole `reduction` x `reduction` blocks; columns and rows that fill no block are left out.

    For `reduction` 2 this is the bilinear half-size image of the published code, times 4.

    >>> block_sums(np.arange(10, dtype=np.uint8).reshape(2, 5), 2)
    array([[12, 20]])
    """
    height, width = image.shape[0] // reduction, image.shape[1] // reduction
    whole = image[: height * reduction, : width * reduction].astype(np.int64)
    return np.asarray(whole.reshape(height, reduction, width, reduction).sum(axis=(1, 3)))


def normalised(sums: NDArray[np.int64], full_scale: int, config: ProposalConfig) -> NDArray[np.float64]:
    """`sums` on [0, 1]: by the frame's own extremes (all zero for a flat frame), or by `full_scale`."""
    if not config.normalise:
        return sums / full_scale
    lowest, highest = int(sums.min()), int(sums.max())
    if lowest == highest:
        return np.zeros(sums.shape)
    return (sums - lowest) / (highest - lowest)


def gaussian_taps(size: int, sigma_px: float) -> NDArray[np.float64]:
    """A Gaussian kernel of odd `size`, summing to one.

    >>> gaussian_taps(5, 2.0).round(6)
    array([0.152469, 0.221841, 0.251379, 0.221841, 0.152469])
    """
    offsets_px = np.arange(size) - size // 2
    taps = np.exp(-0.5 * (offsets_px / sigma_px) ** 2)
    return np.asarray(taps / taps.sum())


def blur(image: NDArray[np.float64], config: ProposalConfig) -> NDArray[np.float64]:
    """`image` under a Gaussian; borders are mirrored about the border pixel (... 2 1 | 0 1 2 ...)."""
    from scipy import ndimage

    across = gaussian_taps(config.blur_width_px, config.blur_sigma_px)
    down = gaussian_taps(config.blur_height_px, config.blur_sigma_px)
    blurred = ndimage.correlate1d(
        ndimage.correlate1d(image, across, axis=1, mode="mirror"), down, axis=0, mode="mirror"
    )
    return np.asarray(blurred, np.float64)


def local_mean(image: NDArray[np.float64], half_window_px: int, window: str) -> NDArray[np.float64]:
    """Local mean mu of each pixel from an integral image; 0 where the window holds no pixel.

    `published`: columns max(1, x-h+1)..min(W-1, x+h), rows alike: 2h x 2h, off-centre by half a pixel to the right
    and down, never row 0 or column 0. `centred`: max(0, x-h)..min(W-1, x+h), rows alike.
    """
    h = half_window_px
    before, first = (h - 1, 1) if window == "published" else (h, 0)
    integral = np.pad(image, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)  # exclusive: integral[y, x] = sum < y, < x

    def bounds(length: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        position = np.arange(length)
        stop = np.minimum(length - 1, position + h) + 1
        return np.minimum(np.maximum(first, position - before), stop), stop

    top, bottom = (bound[:, None] for bound in bounds(image.shape[0]))
    left, right = (bound[None, :] for bound in bounds(image.shape[1]))
    total = integral[bottom, right] - integral[bottom, left] - integral[top, right] + integral[top, left]
    # Cancellation in black areas must not give a negative mean.
    return np.asarray(np.maximum(total, 0.0) / np.maximum((bottom - top) * (right - left), 1))


def dynamic_threshold(
    image: NDArray[np.float64], mean: NDArray[np.float64], kappa: float, eps: float
) -> NDArray[np.float64]:
    """T = mu (1 + kappa (1 - D / (1 - D + eps))) with D = I - mu.

    Source: arXiv 2107.11302, dynamic threshold; `eps` from the published code.
    """
    difference = image - mean
    return np.asarray(mean * (1.0 + kappa * (1.0 - difference / (1.0 - difference + eps))))


def exceeds_threshold(image: NDArray[np.float64], threshold: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where I > T by more than `ROUNDING`."""
    return np.asarray(image > threshold + ROUNDING)


def label_blobs(binary: NDArray[np.bool_], gap_px: int) -> NDArray[np.int32]:
    """Numbers of the blobs of `binary`: pixels at most `gap_px` apart in L-infinity belong to the same blob.

    Widening every pixel to a `gap_px` square makes exactly those pixels touch; `gap_px` 1 is plain 8-connectivity.

    >>> label_blobs(np.array([[True, False, True, False, False, True]]), 2)
    array([[1, 0, 1, 0, 0, 2]], dtype=int32)
    """
    from scipy import ndimage

    # The image is padded, so that no square of even side is cut off at the border.
    wide = np.pad(binary, gap_px)
    if gap_px > 1:
        wide = ndimage.binary_dilation(wide, np.ones((gap_px, gap_px), bool))
    labels, _ = ndimage.label(wide, np.ones((3, 3), int))
    inside = slice(gap_px, -gap_px)
    return np.where(binary, labels[inside, inside], 0).astype(np.int32)
