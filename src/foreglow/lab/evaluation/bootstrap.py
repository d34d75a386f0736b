"""Whether one detector is better than another, or only luckier with the scenes: a paired bootstrap over scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.matching import Matches
from foreglow.lab.evaluation.ratios import percentiles, ratios
from foreglow.numbers import checked_floats, checked_share, checked_whole
from foreglow.types.arrays import check_kind
from foreglow.wording import shortened

Counts: TypeAlias = NDArray[np.float64]
"""Shape (..., 3): tp, fp and fn, of one scene or of many together."""

Figure: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From summed counts, shape (..., C), to the figure, shape (...); NaN where it is not defined."""

CHUNK = 500
"""Resamples at a time, to bound memory."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The figure of a less that of b, on the same scenes.

    Attributes:
        mean: Mean difference over the resamples.
        low: 2.5th percentile.
        high: 97.5th percentile.
        probability: Share of the resamples in which a is at least as high as b.
        num_resamples: Resamples in which both figures are defined.
    """

    a: float
    b: float
    mean: float
    low: float
    high: float
    probability: float
    num_scenes: int
    num_resamples: int
    seed: int

    @property
    def difference(self) -> float:
        """Of the figures over all scenes, a less b."""
        return self.a - self.b


def f1(counts: Counts) -> NDArray[np.float64]:
    """F: tp / (tp + (fp + fn) / 2).

    >>> float(f1(np.array([2.0, 1.0, 1.0]))) == 2 / 3
    True
    """
    tp, fp, fn = np.moveaxis(counts, -1, 0)
    return ratios(tp, tp + 0.5 * (fp + fn))


def ratio(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of two columns, the first over the second; NaN where that is 0.

    >>> ratio(np.array([[1.0, 4.0], [1.0, 0.0]])).tolist()
    [0.25, nan]
    """
    return ratios(counts[..., 0], counts[..., 1])


def scene_counts(matches: Matches, sequence_of: Mapping[int, int], threshold: float) -> Counts:
    """Shape (S, 3): tp, fp and fn of each scene as `evaluate_boxes` counts them, scenes in the order of their ids.

    Raises:
        ValueError: If an argument is of another type, an image is in no sequence, or the threshold is no number from 0
            to 1.
    """
    check_kind("matches", matches, Matches)
    check_kind("sequence_of", sequence_of, Mapping)
    threshold = checked_share("threshold", threshold)
    for image_id in matches.image_ids:
        if image_id not in sequence_of:
            raise ValueError(f"sequence_of: expected the sequence of each image, got none of image {image_id}")
    sequences = np.array([sequence_of[image_id] for image_id in matches.image_ids], np.int64)
    scenes, scene_of_image = np.unique(sequences, return_inverse=True)
    scene_of_point = scene_of_image[matches.image_of_point]
    is_found = matches.best_scores() > threshold
    is_false = (matches.scores > threshold) & ~matches.has_point
    columns = (
        scene_of_point[is_found],
        scene_of_image[matches.image_of_box][is_false],
        scene_of_point[~is_found],
    )
    return np.stack([np.bincount(column, minlength=len(scenes)).astype(np.float64) for column in columns], axis=1)


def paired_bootstrap(
    counts_a: NDArray[np.float64],
    counts_b: NDArray[np.float64],
    figure: Figure = f1,
    *,
    num_resamples: int = 10_000,
    seed: int = 0,
) -> Difference:
    """How sure it is that a's figure is above b's, had other scenes of the same sort been drawn.

    Whole scenes are drawn with replacement, as many as there are, the same ones for a and b: images of a scene depend
    on each other, and a hard scene is hard for both. With fewer than some twenty scenes the interval is too narrow; of
    a single scene there is none, and interval and probability are NaN: every resample is that scene.

    Args:
        counts_a: Shape (S, C), counts of each scene that add up, such as those of `scene_counts`.
        counts_b: Those of the other detector, scenes in the same order.
        figure: What is made of summed counts.
        num_resamples: How often scenes are drawn.
        seed: Of the draws; the same seed, the same result.

    Raises:
        ValueError: If the counts are no finite numbers of the same shape, there is no scene, the number of resamples or
            the seed is none, or the figure is defined in no resample.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapters 8 and 13 (percentile interval).
    """
    counts_a, counts_b = _checked_counts("counts_a", counts_a), _checked_counts("counts_b", counts_b)
    if counts_a.shape != counts_b.shape or counts_a.ndim != 2 or not len(counts_a):
        raise ValueError(f"counts: expected the same shape (S, C), S >= 1, got {counts_a.shape} and {counts_b.shape}")

    def difference(weights: NDArray[np.float64]) -> NDArray[np.float64]:
        return figure(weights @ counts_a) - figure(weights @ counts_b)

    drawn = resampled(difference, len(counts_a), num_resamples, seed)
    if not len(drawn):
        raise ValueError("counts: expected scenes for which the figure is defined, got none")
    low, high = np.percentile(drawn, (2.5, 97.5)) if len(counts_a) > 1 else (math.nan, math.nan)
    return Difference(
        a=float(figure(counts_a.sum(axis=0))),
        b=float(figure(counts_b.sum(axis=0))),
        mean=float(drawn.mean()),
        low=float(low),
        high=float(high),
        probability=float(np.mean(drawn >= 0.0)) if len(counts_a) > 1 else math.nan,
        num_scenes=len(counts_a),
        num_resamples=len(drawn),
        seed=seed,
    )


def percentile_interval(
    counts: NDArray[np.float64], figure: Figure, *, num_resamples: int = 10_000, seed: int = 0
) -> tuple[float, float]:
    """The 95 % interval of one figure, had other scenes of the same sort been drawn; NaN where it is never defined.

    Of a single scene there is no interval, either: every resample is that scene.

    Args:
        counts: Shape (S, C), of each scene, that add up.
        figure: What is made of summed counts.
        num_resamples: How often scenes are drawn; those in which the figure is not defined are left out.
        seed: Of the draws; the same seed, the same scenes, whatever the counts.

    Source: as for `paired_bootstrap`.
    """
    counts = checked_floats("counts", counts)
    if len(counts) < 2:
        return math.nan, math.nan
    drawn = resampled(lambda weights: figure(weights @ counts), len(counts), num_resamples, seed)
    low, high = percentiles(drawn, (2.5, 97.5))
    return low, high


def resampled(figure: Figure, num_scenes: int, num_resamples: int, seed: int) -> NDArray[np.float64]:
    """The figure of each resample in which it is defined.

    Args:
        figure: From how often each scene is drawn, shape (R, S), to a figure for each resample, shape (R,).
        num_scenes: S.
        num_resamples: How often scenes are drawn.
        seed: Of the draws.

    Raises:
        ValueError: If the number of resamples is no whole one of at least 1, or the seed none of at least 0.
    """
    checked_whole("num_resamples", num_resamples, 1)
    rng = np.random.default_rng(checked_whole("seed", seed))
    shares = np.full(num_scenes, 1.0 / num_scenes)
    chunks = (min(CHUNK, num_resamples - start) for start in range(0, num_resamples, CHUNK))
    drawn: NDArray[np.float64] = np.concatenate(
        [figure(rng.multinomial(num_scenes, shares, num).astype(np.float64)) for num in chunks]
    )
    return drawn[~np.isnan(drawn)]


def _checked_counts(field: str, counts: object) -> NDArray[np.float64]:
    """Finite counts of shape (S, C) of each scene."""
    found = checked_floats(field, counts)
    if found.ndim != 2 or not np.isfinite(found).all():
        raise ValueError(f"{field}: expected finite numbers of shape (S, C), got {shortened(counts)}")
    return found
