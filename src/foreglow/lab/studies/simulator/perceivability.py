"""How the first sight of light moves with the rule of what is perceivable: no images needed, only stored candidates."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from foreglow.datasets.simulated import Artifact
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.simulation.labels.artifacts import apply_rule, scaled_rule
from foreglow.lab.simulation.scenes.scene import LabelRule

FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on both thresholds; candidates allow for 1 / `CANDIDATE_FACTOR` and more."""


@dataclass(frozen=True, slots=True)
class PeaksOfFrame:
    """What one image of a drive offers.

    Attributes:
        timestamp_s: Time of exposure.
        has_direct: Whether a lamp of an oncoming vehicle is seen.
        candidates: Candidates of each oncoming vehicle.
    """

    timestamp_s: float
    has_direct: bool
    candidates: tuple[tuple[Artifact, ...], ...]


@dataclass(frozen=True, slots=True)
class FirstTimes:
    """First times in one drive under one rule; infinite where it never happens.

    Attributes:
        indirect_s: First indirect artifact.
        direct_s: First direct artifact.
    """

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
        num_with_indirect: Drives with an indirect artifact.
        share_indirect_first: Of those, the ones where indirect light comes before any lamp; NaN without drives.
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

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        fields = dataclasses.asdict(self)
        for name in ("lead_s", "shift_s"):
            fields[name] = {key: None if math.isnan(value) else value for key, value in fields[name].items()}
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value for name, value in fields.items()
        }


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
        times = [_first_times(drive, counted) for drive, counted in zip(kept, numbers, strict=True)]
        seen = [one for one in times if math.isfinite(min(one.indirect_s, one.direct_s))]
        hidden = [
            number
            for drive, counted in zip(kept, numbers, strict=True)
            for frame, number in zip(drive, counted, strict=True)
            if number and not frame.has_direct
        ]
        shifts = [one.indirect_s - before.indirect_s for one, before in zip(times, usual, strict=True)]
        effects.append(
            RuleEffect(
                factor=factor,
                num_drives=len(seen),
                num_with_indirect=sum(math.isfinite(one.indirect_s) for one in times),
                share_indirect_first=sum(one.indirect_s < one.direct_s for one in seen) / len(seen)
                if seen
                else math.nan,
                lead_s=Spread.of([one.lead_s for one in times if not math.isnan(one.lead_s)]),
                shift_s=Spread.of([shift for shift in shifts if math.isfinite(shift)]),
                instances_per_hidden_frame=sum(hidden) / len(hidden) if hidden else math.nan,
            )
        )
    return tuple(effects)


def first_times(drive: Sequence[PeaksOfFrame], rule: LabelRule, width_scale: float = 1.0) -> FirstTimes:
    """First times in one drive under `rule`."""
    return _first_times(drive, [_num_indirect(frame, rule, width_scale) for frame in drive])


def _num_indirect(frame: PeaksOfFrame, rule: LabelRule, width_scale: float) -> int:
    """Marked indirect artifacts, as if no lamp were seen; with one there may be more, but never none."""
    found = (artifact for one in frame.candidates for artifact in apply_rule(one, rule, width_scale))
    return sum(not artifact.is_doubtful for artifact in found)


def _first_times(drive: Sequence[PeaksOfFrame], num_indirect: Sequence[int]) -> FirstTimes:
    indirect = (frame.timestamp_s for frame, number in zip(drive, num_indirect, strict=True) if number)
    direct = (frame.timestamp_s for frame in drive if frame.has_direct)
    return FirstTimes(next(indirect, math.inf), next(direct, math.inf))
