"""How close simulated drives come to real ones.

First what pixels look like (levels, noise, fixed pattern and lamps of grey images), to hold simulated images beside
real ones. Then how the first sight of light moves with the rule of what is perceivable: that needs no images, only the
stored candidates.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.config import preset
from foreglow.datasets.simulated import Artifact
from foreglow.files import fields_to_json
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.evaluation.ratios import ratio, share
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX
from foreglow.lab.simulation.labels.artifacts import apply_rule, scaled_rule
from foreglow.lab.simulation.scenes.scene import LabelRule
from foreglow.pipeline import Pipeline

DARK_ROWS = 0.4
"""The upper share of the rows is night sky or forest: noise and pattern are measured there."""

PERCENTILES = (1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 99.9)
LAMP_RADII_PX = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0, 45.0, 65.0)
COLUMN_WINDOW_PX = 21
RESIDUAL_SIGMA_PX = 8.0

FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on both thresholds of the rule; candidates allow for 1 / `CANDIDATE_FACTOR` and more."""


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """Of one image, or the mean over several. Grey levels of 8 bits; lengths are pixels of 1280 columns.

    The dark area is the upper 40 % of the rows. NaN where an image is too small or has no lamp.

    Attributes:
        dark_grey: Mean of the dark area: the black level, if nothing is lit there.
        percentiles_grey: Of all pixels, at `PERCENTILES`.
        column_grey: Standard deviation of the dark area's column means, less their moving mean over 21 columns.
        row_parity_grey: Standard deviation of half the difference between even and odd rows' column means.
        row_grey: As `column_grey`, for the means of the rows.
        noise_grey: Standard deviation in the dark area, less its column means and what changes slowly (sigma 8).
        correlation_x: Of that residual with its neighbour in the same row.
        correlation_y: With its neighbour in the same column.
        correlation_y2: With the next but one in the same column: above `correlation_y` where rows alternate.
        lamp_grey: Around the brightest spot, median grey of rings between `LAMP_RADII_PX`, in the half-plane above
            it, where no road shines.
        num_saturated: Pixels at 255.
        num_proposals: Boxes that the detector proposes, preset `paper`.
    """

    num_images: int
    dark_grey: float
    percentiles_grey: tuple[float, ...]
    column_grey: float
    row_parity_grey: float
    row_grey: float
    noise_grey: float
    correlation_x: float
    correlation_y: float
    correlation_y2: float
    lamp_grey: tuple[float, ...]
    num_saturated: float
    num_proposals: float


@dataclass(frozen=True, slots=True)
class PixelComparison:
    """One number of real and simulated images."""

    name: str
    real: float
    simulated: float

    @property
    def ratio(self) -> float:
        """Simulated over real; NaN where the real one is 0 or the signs differ."""
        return self.simulated / self.real if self.real * self.simulated > 0 else math.nan

    def to_json(self) -> dict[str, Any]:
        """All fields and the ratio by name."""
        return fields_to_json(self, "ratio")


def image_statistics(images: NDArray[np.uint8] | Sequence[NDArray[np.uint8]]) -> ImageStatistics:
    """The statistics of one grey image, shape (H, W), or the mean over several of the same size.

    Raises:
        ValueError: If there is none, or one is not two-dimensional, smaller than 32x32, or not uint8.
    """
    listed = [images] if isinstance(images, np.ndarray) and images.ndim == 2 else list(images)
    if not listed:
        raise ValueError("image_statistics: expected at least one image, got none")
    for image in listed:
        if image.ndim != 2 or min(image.shape) < 32 or image.dtype != np.uint8:
            raise ValueError(
                f"image_statistics: expected grey uint8 images of at least 32x32, got {image.dtype} {image.shape}"
            )
    pipeline = Pipeline(preset("paper"))
    each = [_statistics(image, pipeline) for image in listed]
    means: dict[str, Any] = {}
    for field in dataclasses.fields(ImageStatistics):
        values = np.array([getattr(statistics, field.name) for statistics in each], np.float64)
        mean = values.mean(0)
        means[field.name] = tuple(map(float, mean)) if mean.ndim else float(mean)
    return ImageStatistics(**{**means, "num_images": len(listed)})


def compare_images(real: ImageStatistics, simulated: ImageStatistics) -> tuple[PixelComparison, ...]:
    """Both, number by number, as the rows of a table."""
    rows = []
    for field in dataclasses.fields(ImageStatistics):
        if field.name == "num_images":
            continue
        values = getattr(real, field.name), getattr(simulated, field.name)
        if field.name == "percentiles_grey":
            names = [f"grey level, percentile {share:g}" for share in PERCENTILES]
        elif field.name == "lamp_grey":
            names = [f"lamp, {a:g} to {b:g} px" for a, b in itertools.pairwise(LAMP_RADII_PX)]
        else:
            names, values = [field.name.replace("_", " ")], ((values[0],), (values[1],))
        rows += [PixelComparison(*row) for row in zip(names, *values, strict=True)]
    return tuple(rows)


def _statistics(image: NDArray[np.uint8], pipeline: Pipeline) -> ImageStatistics:
    scale = image.shape[1] / REFERENCE_WIDTH_PX
    dark = image[: int(DARK_ROWS * image.shape[0])].astype(np.float64)
    columns = dark.mean(0)
    parity = (dark[::2].mean(0) - dark[1::2].mean(0)) / 2.0
    window = max(3, 2 * round(COLUMN_WINDOW_PX * scale / 2) + 1)
    residual = dark - columns
    residual -= cv2.GaussianBlur(residual, (0, 0), max(2.0, RESIDUAL_SIGMA_PX * scale))
    return ImageStatistics(
        num_images=1,
        dark_grey=float(dark.mean()),
        percentiles_grey=tuple(map(float, np.percentile(image, PERCENTILES))),
        column_grey=_rough(columns, window),
        row_parity_grey=_rough(parity, window),
        row_grey=_rough(dark.mean(1), window),
        noise_grey=float(residual.std()),
        correlation_x=_correlation(residual[:, :-1], residual[:, 1:]),
        correlation_y=_correlation(residual[:-1], residual[1:]),
        correlation_y2=_correlation(residual[:-2], residual[2:]),
        lamp_grey=_lamp(image, scale),
        num_saturated=int((image == 255).sum()),
        num_proposals=len(pipeline.step(image).proposals),
    )


def _rough(values: NDArray[np.float64], window: int) -> float:
    """Standard deviation of a profile less its moving mean."""
    smooth = cv2.blur(values[np.newaxis], (window, 1), borderType=cv2.BORDER_REFLECT)[0]
    return float((values - smooth).std())


def _correlation(left: NDArray[np.float64], right: NDArray[np.float64]) -> float:
    return ratio(float((left * right).mean()), math.sqrt(float((left**2).mean() * (right**2).mean())))


def _lamp(image: NDArray[np.uint8], scale: float) -> tuple[float, ...]:
    """Median grey over rings above the brightest spot; NaN for rings that hold no pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), max(0.5, 1.5 * scale))
    row, column = np.unravel_index(int(smooth.argmax()), image.shape)
    radii_px = np.asarray(LAMP_RADII_PX) * scale
    reach = math.ceil(radii_px[-1])
    x0, y0 = max(0, int(column) - reach), max(0, int(row) - reach)
    above = image[y0 : int(row) + 1, x0 : int(column) + reach + 1]
    rows, columns = np.mgrid[: above.shape[0], : above.shape[1]]
    distances = np.hypot(rows + y0 - row, columns + x0 - column)
    rings = [above[(distances >= a) & (distances < b)] for a, b in itertools.pairwise(radii_px)]
    return tuple(float(np.median(ring)) if ring.size else math.nan for ring in rings)


@dataclass(frozen=True, slots=True)
class PeaksOfFrame:
    """What one image of a drive offers.

    Attributes:
        has_direct: Whether a lamp of an oncoming vehicle is seen.
    """

    timestamp_s: float
    has_direct: bool
    candidates: tuple[tuple[Artifact, ...], ...]


@dataclass(frozen=True, slots=True)
class FirstTimes:
    """First times in one drive under one rule; infinite where it never happens."""

    indirect_s: float
    direct_s: float

    @property
    def lead_s(self) -> float:
        """By how much the indirect light comes before the lamp; NaN without both."""
        return self.direct_s - self.indirect_s if math.isfinite(self.direct_s + self.indirect_s) else math.nan


@dataclass(frozen=True, slots=True)
class RuleEffect:
    """What one factor on the thresholds makes of a set of drives.

    Attributes:
        factor: On both thresholds.
        num_drives: Drives in which a lamp or an indirect artifact is seen.
        share_indirect_first: Share of the drives in which indirect light comes before any lamp; NaN without drives.
        lead_s: First direct minus first indirect, over the drives that have both; negative where the lamp comes first.
        shift_s: By how much the first indirect time is later than with a factor of 1, over the drives that have it
            with both.
        instances_per_hidden_frame: Mean over the images that have indirect artifacts but no lamp; without hysteresis.
    """

    factor: float
    num_drives: int
    num_with_indirect: int
    share_indirect_first: float
    lead_s: Spread
    shift_s: Spread
    instances_per_hidden_frame: float


def rule_effects(
    drives: Iterable[Sequence[PeaksOfFrame]],
    rule: LabelRule,
    factors: Sequence[float] = FACTORS,
    width_scale: float = 1.0,
) -> tuple[RuleEffect, ...]:
    """What each factor on both thresholds of `rule` makes of the `drives`, in the order of `factors`.

    Args:
        drives: Images in order of time, each with its candidates under `rule`.
        rule: The rule under which the candidates were found.
        factors: Not below 1 / `CANDIDATE_FACTOR`, where candidates end.
        width_scale: Columns of the images over 1280.
    """
    kept = [list(drive) for drive in drives]
    usual = [first_times(drive, rule, width_scale) for drive in kept]
    effects: list[RuleEffect] = []
    for factor in factors:
        scaled = scaled_rule(rule, factor)
        numbers = [[_num_indirect(frame, scaled, width_scale) for frame in drive] for drive in kept]
        times = [_first_times(drive, counts) for drive, counts in zip(kept, numbers, strict=True)]
        seen = [first for first in times if math.isfinite(min(first.indirect_s, first.direct_s))]
        hidden = [
            number
            for drive, counts in zip(kept, numbers, strict=True)
            for frame, number in zip(drive, counts, strict=True)
            if number and not frame.has_direct
        ]
        shifts_s = [first.indirect_s - before.indirect_s for first, before in zip(times, usual, strict=True)]
        effects.append(
            RuleEffect(
                factor=factor,
                num_drives=len(seen),
                num_with_indirect=sum(math.isfinite(first.indirect_s) for first in times),
                share_indirect_first=share([first.indirect_s < first.direct_s for first in seen]),
                lead_s=Spread.of([first.lead_s for first in times if not math.isnan(first.lead_s)]),
                shift_s=Spread.of([shift_s for shift_s in shifts_s if math.isfinite(shift_s)]),
                instances_per_hidden_frame=ratio(sum(hidden), len(hidden)),
            )
        )
    return tuple(effects)


def first_times(drive: Sequence[PeaksOfFrame], rule: LabelRule, width_scale: float = 1.0) -> FirstTimes:
    """First times in one drive under `rule`."""
    return _first_times(drive, [_num_indirect(frame, rule, width_scale) for frame in drive])


def _num_indirect(frame: PeaksOfFrame, rule: LabelRule, width_scale: float) -> int:
    """Marked indirect artifacts, as if no lamp were seen; with one there may be more, but never none."""
    found = (artifact for candidates in frame.candidates for artifact in apply_rule(candidates, rule, width_scale))
    return sum(not artifact.is_doubtful for artifact in found)


def _first_times(drive: Sequence[PeaksOfFrame], num_indirect: Sequence[int]) -> FirstTimes:
    indirect = (frame.timestamp_s for frame, number in zip(drive, num_indirect, strict=True) if number)
    direct = (frame.timestamp_s for frame in drive if frame.has_direct)
    return FirstTimes(next(indirect, math.inf), next(direct, math.inf))
