"""When a track is plausible: confirmation rules, computed for all tracks at once.

A rule remembers `memory_size` numbers for each track, in an array of shape (M, memory_size) that begins with zeros.

The rule `evidence` is a sequential test of the hypothesis "light artifact" against "anything else". State: the summed
log-likelihood ratio E of each track, no unit (natural logarithm), 0 for a new track. In each frame, with the calibrated
score s of the track's detection, the neutral score s0 that speaks for neither, and the detection probability P_d,

    detected    E <- E + n (clip(logit(s), -7, 7) - logit(s0)),   logit(s) = log(s / (1 - s))                   (1)
    missed      E <- E + n log(1 - P_d)                                                                         (2)
    then        E <- clip(E, 0, 20)                                                                             (3)

n is the time since the frame before in frames at the tracker's rate, at most 1: images that follow each other sooner
are hardly independent. (2) assumes that anything but light would be missed for certain. The floor of (3) lets a light
appear where there was none before; the ceiling lets a sure track be forgotten again. A track becomes plausible at
`confirm` and stays so down to `reject`; while another track is plausible, or was so a moment ago, it needs `company`
more:

    E > confirm (+ company), or E > reject for a plausible track                                                (4)

Where the range r of a light is known, it is evidence, too. What our own lamps light is near, and the light of a vehicle
that is still hidden is first seen far away. So the score s of a detection is replaced by s' with

    logit(s') = logit(s) + w log(r / R),   r limited to `RANGES_M`,   R = `NEUTRAL_RANGE_M`                     (5)

Sources: Page, Continuous inspection schemes, 1954; for tracks: Blackman, Multiple-target tracking, 1986.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.config import TrackerConfig
from foreglow.geometry import Floats

MAX_EVIDENCE = 20.0
"""Ceiling of the evidence in (3)."""

MAX_SCORE_EVIDENCE = 7.0
"""A single score counts for odds of at most 1100 to 1, either way: the calibration knows nothing of rarer cases."""


NEUTRAL_RANGE_M, RANGES_M = 70.0, (16.0, 100.0)
"""Range in (5) that speaks neither for nor against a vehicle, and its limits: chosen in decision 18."""


def scores_with_ranges(scores: Floats, ranges_m: Floats, weight: float) -> Floats:
    """The scores of (5), shape (N,): each unchanged where the range is NaN.

    >>> scores_with_ranges(np.array([0.5, 0.5, 0.5, 1.0]), np.array([35.0, 70.0, np.nan, 35.0]), 1.0).round(3).tolist()
    [0.333, 0.5, 0.5, 1.0]
    """
    limited_m = np.minimum(np.maximum(ranges_m, RANGES_M[0]), RANGES_M[1])
    factors = (np.where(np.isnan(ranges_m), NEUTRAL_RANGE_M, limited_m) / NEUTRAL_RANGE_M) ** weight
    return np.asarray(scores * factors / (scores * factors + (1.0 - scores)))  # (5)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """What this frame shows of M tracks.

    Attributes:
        scores: Shape (M,), of each track's detection, by (5); NaN where the track was missed.
        num_hits: Shape (M,), detections so far, this one included.
        confidences: Shape (M,), the filtered score.
        was_plausible: Shape (M,), before this frame.
        since_others_s: Shape (M,), time since any other track was plausible, not counting this frame; infinite if none
            ever was.
        num_frames: How many frames at the tracker's rate this one counts for, at most 1.
    """

    scores: Floats
    num_hits: NDArray[np.int64]
    confidences: Floats
    was_plausible: NDArray[np.bool_]
    since_others_s: Floats
    num_frames: float = 1.0


class Company:
    """When others were plausible: remembers which two of all tracks, or vehicles, were so last."""

    def __init__(self) -> None:
        self._last, self._before = (-1, -math.inf), (-1, -math.inf)  # id, and when

    def since_others_s(self, ids: NDArray[np.int64], now_s: float) -> Floats:
        """Time since any but each of `ids`, shape (M,), was plausible, shape (M,); infinite if none ever was."""
        return now_s - np.where(ids == self._last[0], self._before[1], self._last[1])

    def note(self, plausible_ids: NDArray[np.int64], now_s: float) -> None:
        """Takes those that are plausible now, shape (P,)."""
        for found in plausible_ids[:2].tolist():
            if found != self._last[0]:
                self._before = self._last
            self._last = found, now_s


class ConfirmationRule(Protocol):
    """Decides which tracks are plausible."""

    memory_size: int

    def __init__(self, config: TrackerConfig) -> None: ...

    def update(self, memory: Floats, observed: Observations) -> tuple[Floats, NDArray[np.bool_]]:
        """The memory, shape (M, memory_size), and which tracks are plausible, shape (M,), after this frame."""
        ...


class FramesRule:
    """Plausible while the track has enough detections, in a row or not, and its confidence is high enough.

    Source: Ewecker et al., arXiv 2107.11302: five detections and a confidence above 0.5.
    """

    memory_size = 0

    def __init__(self, config: TrackerConfig) -> None:
        self._min_hits = config.min_hits
        self._min_confidence = config.min_confidence

    def update(self, memory: Floats, observed: Observations) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.update`."""
        is_plausible = (observed.num_hits >= self._min_hits) & (observed.confidences > self._min_confidence)
        return memory, np.asarray(is_plausible)


class MOfNRule:
    """Plausible once M of the last N frames had a detection, at a sufficient confidence; then as long as it lives."""

    def __init__(self, config: TrackerConfig) -> None:
        self.memory_size = config.num_looks
        self._min_hits = config.min_hits
        self._min_confidence = config.min_confidence

    def update(self, memory: Floats, observed: Observations) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.update`."""
        newest = ~np.isnan(observed.scores)
        memory = np.concatenate([newest[:, None].astype(np.float64), memory[:, :-1]], axis=1)
        is_enough = (memory.sum(axis=1) >= self._min_hits) & (observed.confidences > self._min_confidence)
        return memory, observed.was_plausible | is_enough


class EvidenceRule:
    """Plausible by the summed evidence of (1) to (4).

    A second track needs more evidence, because most of what is bright around a vehicle is lit by that vehicle, and the
    beam is already being dimmed for it. See decision 8.
    """

    memory_size = 1

    def __init__(self, config: TrackerConfig) -> None:
        self._neutral = float(np.log(config.neutral_score / (1.0 - config.neutral_score)))
        self._miss = float(np.log1p(-config.detection_probability))  # (2)
        self._confirm, self._reject = config.confirm_evidence, config.reject_evidence
        self._company, self._company_s = config.company_evidence, config.company_s

    def update(self, memory: Floats, observed: Observations) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.update`."""
        with np.errstate(divide="ignore"):
            logits = np.log(observed.scores) - np.log1p(-observed.scores)
        hits = np.minimum(np.maximum(logits, -MAX_SCORE_EVIDENCE), MAX_SCORE_EVIDENCE) - self._neutral  # (1)
        evidence = memory[:, 0] + observed.num_frames * np.where(np.isnan(hits), self._miss, hits)
        evidence = np.minimum(np.maximum(evidence, 0.0), MAX_EVIDENCE)  # (3)
        is_second = observed.since_others_s <= self._company_s
        needed = self._confirm + np.where(is_second, self._company, 0.0)
        return evidence[:, None], (evidence > needed) | (observed.was_plausible & (evidence > self._reject))  # (4)


CONFIRMATIONS: Mapping[str, type[ConfirmationRule]] = MappingProxyType(
    {"frames": FramesRule, "m_of_n": MOfNRule, "evidence": EvidenceRule}
)
"""All rules by name."""
