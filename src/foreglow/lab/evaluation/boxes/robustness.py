"""A detector's figures on images as a worse camera or weather gives them: gain, noise, haze, rain, blur.

These are plain operations on finished images, not physics: they say how a detector bears a change, not how it does in
real fog. Each is drawn from a seed and the image's id alone, so the same image is always disturbed in the same way.
Grey levels are those of 8 bits; images of 16 bits are disturbed on their own scale.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource
from foreglow.lab.evaluation.boxes.breakdown import SplitLabels, break_down, match_lights
from foreglow.lab.evaluation.boxes.split_run import Progress, SplitRun, run_variants
from foreglow.lab.evaluation.ratios import ratio
from foreglow.pipeline import Pipeline
from foreglow.types import Frame, Image

Pixels: TypeAlias = NDArray[np.float32]
"""Shape (H, W), grey levels of 8 bits, not yet rounded."""

BLACK_PERCENTILE = 1.0
"""The black level is taken to be this percentile of the image: at night some of every frame is dark."""

HAZE_VEIL_GREY = 60.0
"""Grey levels above black that own light scattered in dense haze (transmission 0) would add."""

HAZE_HALO_PX = 40.0
"""Standard deviation of the glow that haze puts around lights, pixels of a 1280 columns wide image."""

HAZE_HALO_SHARE = 0.5
"""Share of the light that haze takes from the direct way which comes back as that glow."""

REFERENCE_WIDTH_PX = 1280

RAIN_LENGTH_PX = (15.0, 60.0)
RAIN_SLANT = 0.1
"""Standard deviation of the streaks' slant, columns a row; one more mean slant of the same size is drawn per image."""
RAIN_GREY = 12.0
"""Mean brightness of a streak in own light alone, grey levels; drawn from an exponential distribution."""
RAIN_LIT_SHARE = 0.5
"""Share of what shines behind it (over a 40 px neighbourhood) that a streak scatters in addition."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A way to make images worse.

    Attributes:
        name: Such as `gain x0.25`.
        apply: From pixels, their black level and a generator to disturbed pixels; these may leave 0..255.
    """

    name: str
    apply: Callable[[Pixels, float, np.random.Generator], Pixels]

    def __call__(self, frame: Frame, seed: int = 0) -> Frame:
        """`frame` with a disturbed image, rounded and cut to its range; the same one for the same seed and image.

        So is the image before that it brings along; all else stays.
        """
        draws = [seed, frame.frame, zlib.crc32(self.name.encode())]
        earlier = frame.earlier
        if earlier is not None:
            earlier = dataclasses.replace(earlier, image=self._disturbed(earlier.image, [*draws, 1]))
        return dataclasses.replace(frame, image=self._disturbed(frame.image, draws), earlier=earlier)

    def _disturbed(self, image: Image, draws: Sequence[int]) -> Image:
        full = float(np.iinfo(image.dtype).max)
        pixels = image * np.float32(255.0 / full)
        random = np.random.default_rng(draws)
        disturbed = self.apply(pixels, black_level(pixels), random) * np.float32(full / 255.0)
        np.rint(np.clip(disturbed, 0.0, np.float32(full), out=disturbed), out=disturbed)
        return cast("Image", disturbed.astype(image.dtype))


def gain(factor: float) -> Disturbance:
    """Everything above the black level times `factor`, cut at 255: another exposure, with its noise."""
    return Disturbance(f"gain x{factor:g}", lambda pixels, black, _: black + (pixels - black) * np.float32(factor))


def noise(sigma_grey: float) -> Disturbance:
    """Gaussian noise of `sigma_grey` grey levels, each pixel on its own, added to that of the camera."""

    def apply(pixels: Pixels, _: float, rng: np.random.Generator) -> Pixels:
        return pixels + rng.standard_normal(pixels.shape, np.float32) * np.float32(sigma_grey)

    return Disturbance(f"noise {sigma_grey:g} grey", apply)


def haze(transmission: float) -> Disturbance:
    """Haze that lets `transmission` of the light through, the same at every distance.

    The contrast falls by that factor, half of what is lost comes back as a wide glow, and own light adds a flat veil of
    (1 - transmission) * 60 grey. The camera's noise stays: what the factor took of it is added anew.
    """

    def apply(pixels: Pixels, black: float, rng: np.random.Generator) -> Pixels:
        lost = 1.0 - transmission
        signal = pixels - np.float32(black)
        glow = _blurred(signal, HAZE_HALO_PX * pixels.shape[1] / REFERENCE_WIDTH_PX)
        sigma = noise_level(pixels) * math.sqrt(1.0 - transmission**2)
        anew = rng.standard_normal(pixels.shape, np.float32) * np.float32(sigma)
        lit = signal * np.float32(transmission) + glow * np.float32(lost * HAZE_HALO_SHARE)
        return np.asarray(lit + anew + np.float32(black + lost * HAZE_VEIL_GREY), np.float32)

    return Disturbance(f"haze {transmission:g} through", apply)


def rain(streaks: int) -> Disturbance:
    """Rain of `streaks` bright streaks in a 1280x960 image, as many for its area in another one.

    Length, slant, place and brightness of each are drawn. A streak is a soft line of constant brightness: some grey
    levels in own light, plus half of what shines in its neighbourhood.
    """

    def apply(pixels: Pixels, black: float, rng: np.random.Generator) -> Pixels:
        height, width = pixels.shape
        scale = width / REFERENCE_WIDTH_PX
        behind = _blurred(pixels - np.float32(black), 40.0 * scale)
        layer = np.zeros_like(pixels)
        num = round(streaks * width * height / (REFERENCE_WIDTH_PX * 960.0))
        columns, rows = rng.uniform(0, width, num), rng.uniform(0, height, num)
        lengths = rng.uniform(*RAIN_LENGTH_PX, num) * scale
        slants = rng.normal(rng.normal(0.0, RAIN_SLANT), RAIN_SLANT, num)
        greys = rng.exponential(RAIN_GREY, num) + RAIN_LIT_SHARE * behind[rows.astype(int), columns.astype(int)]
        for column, row, length, slant, grey in zip(columns, rows, lengths, slants, greys, strict=True):
            start = (round(column), round(row))
            stop = (round(column + slant * length), round(row + length))
            cv2.line(layer, start, stop, float(grey), 1)
        return np.asarray(pixels + cv2.GaussianBlur(layer, (3, 3), 0.7), np.float32)

    return Disturbance(f"rain {streaks} streaks", apply)


def blur(sigma_px: float) -> Disturbance:
    """Gaussian blur of `sigma_px` pixels of a 1280 columns wide image: a lens out of focus, a smeared screen."""
    return Disturbance(
        f"blur {sigma_px:g} px",
        lambda pixels, _, __: _blurred(pixels, sigma_px * pixels.shape[1] / REFERENCE_WIDTH_PX),
    )


UNDISTURBED = Disturbance("as it is", lambda pixels, _, __: pixels)

DISTURBANCES: tuple[Disturbance, ...] = (
    UNDISTURBED,
    *(gain(factor) for factor in (0.25, 0.5, 2.0, 4.0)),
    *(noise(sigma) for sigma in (2.0, 4.0, 8.0)),
    *(haze(transmission) for transmission in (0.7, 0.4)),
    *(rain(streaks) for streaks in (300, 1000)),
    *(blur(sigma) for sigma in (1.0, 2.0)),
)
"""Those of the table, undisturbed first."""


def black_level(pixels: NDArray[np.float32]) -> float:
    """The grey level of darkness: the 1st percentile of every fourth pixel of every fourth row."""
    return float(np.percentile(pixels[::4, ::4], BLACK_PERCENTILE))


def noise_level(pixels: NDArray[np.float32]) -> float:
    """Standard deviation of the noise in the darker half of the image, grey levels.

    From the mean absolute difference of neighbours in a row, which is 2 sigma / sqrt(pi) for Gaussian noise, where a
    third pixel beside them is dark: choosing by their own values would choose the small differences. Texture makes it
    a little too high.
    """
    width = pixels.shape[1] // 4 * 4
    first, second, third = (pixels[::4, column:width:4] for column in range(3))
    if not first.size:
        return 0.0
    is_dark = third <= np.median(third)
    return float(np.abs(first - second)[is_dark].mean() * math.sqrt(math.pi) / 2.0)


def _blurred(pixels: Pixels, sigma_px: float) -> Pixels:
    """Gaussian blur; a wide one of a reduced image, where it is the same to the eye and a hundred times quicker."""
    factor = max(1, int(sigma_px // 4))
    if factor == 1:
        return np.asarray(cv2.GaussianBlur(pixels, (0, 0), sigma_px), np.float32)
    height, width = pixels.shape
    size = (max(1, width // factor), max(1, height // factor))
    small = cv2.GaussianBlur(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), (0, 0), sigma_px / factor)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


@dataclass(frozen=True, slots=True)
class RobustnessRow:
    """The figures under one disturbance.

    Attributes:
        f1: F as `evaluate_boxes` has it, NaN where not defined.
        ceiling: Recall of all proposals.
        false_boxes_per_frame: In all images.
        false_boxes_per_empty_frame: In images without any vehicle's light.
    """

    name: str
    f1: float
    precision: float
    recall: float
    ceiling: float
    recall_hidden: float
    false_boxes_per_frame: float
    false_boxes_per_empty_frame: float
    proposals_per_frame: float


def robustness(
    dataset: LabelledSource,
    labels: SplitLabels,
    config: PipelineConfig,
    *,
    disturbances: Sequence[Disturbance] = DISTURBANCES,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[RobustnessRow, ...]:
    """The figures of the configured pipeline under each disturbance, at its own threshold, in one pass over the images.

    Raises:
        FileNotFoundError: If an image or the model is missing.
        ValueError: If an image is broken, the model does not fit, or two disturbances have the same name.
    """
    seen = dataset.seen_by(config.guard.white_level)  # disturbances are on the scale of all bits
    config = config.changed("guard", white_level=None)
    names = [disturbance.name for disturbance in disturbances]
    if len(set(names)) < len(names):
        raise ValueError(f"disturbances: expected each name once, got {', '.join(names)}")
    variants = {
        disturbance.name: (Pipeline(config), functools.partial(disturbance, seed=seed)) for disturbance in disturbances
    }
    runs = run_variants(seen, variants, progress)
    return tuple(_row(name, run, labels, config.classifier.score_threshold) for name, run in runs.items())


def _row(name: str, run: SplitRun, labels: SplitLabels, threshold: float) -> RobustnessRow:
    matched = match_lights(labels, run.predictions)
    broken_down = break_down(matched, threshold)
    whole, hidden = broken_down.whole, broken_down.group("sight", "hidden")
    matches = matched.matches
    return RobustnessRow(
        name=name,
        f1=whole.f1,
        precision=broken_down.precision,
        recall=whole.recall,
        ceiling=whole.ceiling,
        recall_hidden=math.nan if hidden is None else hidden.recall,
        false_boxes_per_frame=broken_down.false_boxes.per_frame,
        false_boxes_per_empty_frame=broken_down.false_boxes_empty.per_frame,
        proposals_per_frame=ratio(matches.num_boxes, matches.num_images),
    )
