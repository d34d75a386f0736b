"""How well it is told where and when a hidden vehicle will come into sight."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foreglow.lab.evaluation.boxes.breakdown import plain

NEAR_DEG = 1.5
"""An expected direction is right when it is no further off."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What was told of one hidden vehicle, some time before it came into sight.

    Attributes:
        vehicle_id: The vehicle.
        lead_s: So long before its first direct sight.
        error_deg: Of the expected direction against the true one at first sight; NaN where nothing was expected.
        error_s: Of the expected time; NaN likewise.
        width_deg: Between the borders of the probability that a gap covers; NaN likewise.
        is_covered: Whether the true direction lay between them.
    """

    vehicle_id: int
    lead_s: float
    error_deg: float
    error_s: float
    width_deg: float
    is_covered: bool

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        return {name: plain(value) for name, value in dataclasses.asdict(self).items()}

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Sighting:
        """What `to_json` gave."""
        known: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields.items()}
        return cls(**known)


@dataclass(frozen=True, slots=True)
class LeadScore:
    """All sightings with one lead.

    Attributes:
        lead_s: Time before direct sight.
        num: Vehicles that were hidden then.
        num_told: Those of them of which something was told.
        median_deg: Median error of the direction, of those; NaN without any, as all that follow.
        near_share: Share of them within `NEAR_DEG`.
        covered_share: Share of them that the gap's borders held.
        width_deg: Median width between these.
        median_s: Median error of the time.
    """

    lead_s: float
    num: int
    num_told: int
    median_deg: float
    near_share: float
    covered_share: float
    width_deg: float
    median_s: float

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        return {name: plain(value) for name, value in dataclasses.asdict(self).items()}


def lead_scores(sightings: Sequence[Sighting]) -> tuple[LeadScore, ...]:
    """One score for each lead, the longest first.

    >>> one = Sighting(0, 1.0, 0.5, 0.2, 3.0, True)
    >>> lead_scores([one, dataclasses.replace(one, error_deg=2.5)])[0].median_deg
    1.5
    """
    scores = []
    for lead_s in sorted({one.lead_s for one in sightings}, reverse=True):
        hidden = [one for one in sightings if one.lead_s == lead_s]
        told = [one for one in hidden if not math.isnan(one.error_deg)]
        errors_deg = [one.error_deg for one in told]
        scores.append(
            LeadScore(
                lead_s=lead_s,
                num=len(hidden),
                num_told=len(told),
                median_deg=_median(errors_deg),
                near_share=_mean([one <= NEAR_DEG for one in errors_deg]),
                covered_share=_mean([one.is_covered for one in told]),
                width_deg=_median([one.width_deg for one in told]),
                median_s=_median([one.error_s for one in told]),
            )
        )
    return tuple(scores)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan
