"""When a track is plausible: rules over what was seen of it, all tracks at once.

A rule remembers `memory_size` numbers of each track, in an array of shape (M, memory_size) that begins with zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.config import TrackerConfig
from foreglow.geometry import Floats

MAX_EVIDENCE = 20.0
"""Sums of evidence stay below this: what was sure may still be unlearnt."""

MAX_LOOK_EVIDENCE = 7.0
"""A single score says no more than 1 in 1100, either way: the calibration knows nothing of rarer cases."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """What this frame says of M tracks.

    Attributes:
        scores: Shape (M,), of the detection that each track took; NaN where it was missed.
        num_hits: Shape (M,), detections so far, this one included.
        confidences: Shape (M,), the filtered score.
        was_plausible: Shape (M,), before this frame.
        since_plausible_s: Since any track was plausible, up to the frame before; infinite for never.
    """

    scores: Floats
    num_hits: NDArray[np.int64]
    confidences: Floats
    was_plausible: NDArray[np.bool_]
    since_plausible_s: float


class ConfirmationRule(Protocol):
    """Decides which tracks are plausible."""

    memory_size: int

    def __init__(self, config: TrackerConfig) -> None: ...

    def look(self, memory: Floats, looks: Looks) -> tuple[Floats, NDArray[np.bool_]]:
        """The memory, shape (M, memory_size), and which tracks are plausible, shape (M,), after `looks`."""
        ...


class FramesRule:
    """Plausible while a track has enough detections, in a row or not, and its confidence is high enough.

    Source: Ewecker et al., arXiv 2107.11302: five detections and a confidence above 0.5.
    """

    memory_size = 0

    def __init__(self, config: TrackerConfig) -> None:
        self._min_hits = config.min_hits
        self._min_confidence = config.min_confidence

    def look(self, memory: Floats, looks: Looks) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.look`."""
        is_plausible = (looks.num_hits >= self._min_hits) & (looks.confidences > self._min_confidence)
        return memory, np.asarray(is_plausible)


class MOfNRule:
    """Plausible once enough of the last looks were detections, at a sufficient confidence; then as long as it lives."""

    def __init__(self, config: TrackerConfig) -> None:
        self.memory_size = config.num_looks
        self._min_hits = config.min_hits
        self._min_confidence = config.min_confidence

    def look(self, memory: Floats, looks: Looks) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.look`."""
        newest = ~np.isnan(looks.scores)
        memory = np.concatenate([newest[:, None].astype(np.float64), memory[:, :-1]], axis=1)
        is_enough = (memory.sum(axis=1) >= self._min_hits) & (looks.confidences > self._min_confidence)
        return memory, looks.was_plausible | is_enough


class EvidenceRule:
    """Plausible by the sum of the log-likelihood ratios of light against anything else: a sequential test.

    A detection with the calibrated score s says logit(s) - logit(neutral); a miss says log(1 - P_d), as if what is no
    light were missed for sure. The sum does not fall below 0, since light may appear where there was none before; a
    track that became plausible stays so down to `reject_evidence`.

    Beside a track that is plausible, or was a moment ago, another one needs more: most of what is bright around a
    vehicle is lit by it, and what is to be done about the vehicle is under way. See decision 8.

    Source: Page, Continuous inspection schemes, 1954; for tracks: Blackman, Multiple-target tracking, 1986.
    """

    memory_size = 1

    def __init__(self, config: TrackerConfig) -> None:
        self._neutral = float(np.log(config.neutral_score / (1.0 - config.neutral_score)))
        self._miss = float(np.log1p(-config.detection_probability))
        self._confirm, self._reject = config.confirm_evidence, config.reject_evidence
        self._company, self._company_s = config.company_evidence, config.company_s

    def look(self, memory: Floats, looks: Looks) -> tuple[Floats, NDArray[np.bool_]]:
        """As `ConfirmationRule.look`."""
        with np.errstate(divide="ignore"):
            logits = np.log(looks.scores) - np.log1p(-looks.scores)
        hits = np.clip(logits, -MAX_LOOK_EVIDENCE, MAX_LOOK_EVIDENCE) - self._neutral
        evidence = np.clip(memory[:, 0] + np.where(np.isnan(hits), self._miss, hits), 0.0, MAX_EVIDENCE)
        has_company = looks.since_plausible_s <= self._company_s
        needed = self._confirm + (self._company if has_company else 0.0)
        return evidence[:, None], (evidence > needed) | (looks.was_plausible & (evidence > self._reject))


CONFIRMATIONS: Mapping[str, type[ConfirmationRule]] = MappingProxyType(
    {"frames": FramesRule, "m_of_n": MOfNRule, "evidence": EvidenceRule}
)
"""All rules by name."""
