"""The paper's time benefit: when the first vehicle of each sequence is detected, beside others who report it.

A method detects a vehicle with the first box that contains one of its key points.

Source: Ewecker et al., arXiv 2107.11302, the experiment on the time benefit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.breakdown import plain
from foreglow.lab.evaluation.boxes.first_found import FirstFound
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.evaluation.tracks.encounters import Encounter


@dataclass(frozen=True, slots=True)
class MeanAndSpread(Spread):
    """Median, quartiles and mean of times, seconds; NaN of nothing."""

    mean: float

    @classmethod
    def of(cls, values: Iterable[float]) -> MeanAndSpread:
        """Of those of `values` that are not NaN.

        >>> MeanAndSpread.of([1.0, 2.0, math.nan, 6.0])
        MeanAndSpread(num=3, lower_quartile=1.5, median=2.0, upper_quartile=4.0, mean=3.0)
        """
        known = [float(value) for value in values if not math.isnan(value)]
        spread = Spread.of(known)
        mean = float(np.mean(known)) if known else math.nan
        return cls(spread.num, spread.lower_quartile, spread.median, spread.upper_quartile, mean)

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        return {name: plain(value) for name, value in dataclasses.asdict(self).items()}


@dataclass(frozen=True, slots=True)
class TimeBenefit:
    """How early one method detects the first vehicles.

    Attributes:
        name: The method.
        detected_s: One time an encounter, in their order; NaN for never.
        delays_s: From the first annotated artifact.
        before_production_s: By how much it is before the production system; of sequences where both detect.
        occluded_before_production_s: The same of occluded vehicles alone.
        before_human_s: By how much it is before a human.
        before_sight_s: By how much it is before the first annotated lamp; of occluded vehicles.
        provident_share: Share of the occluded vehicles that are detected before their first annotated lamp; those that
            are never detected count against it. NaN without any.
        num_missed: Vehicles that are never detected.
    """

    name: str
    detected_s: tuple[float, ...]
    delays_s: MeanAndSpread
    before_production_s: MeanAndSpread
    occluded_before_production_s: MeanAndSpread
    before_human_s: MeanAndSpread
    before_sight_s: MeanAndSpread
    provident_share: float
    num_missed: int

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        spreads = (
            "delays_s", "before_production_s", "occluded_before_production_s", "before_human_s", "before_sight_s",
        )  # fmt: skip
        return {
            "name": self.name,
            "detected_s": [plain(value) for value in self.detected_s],
            **{name: getattr(self, name).to_json() for name in spreads},
            "provident_share": plain(self.provident_share),
            "num_missed": self.num_missed,
        }


def detection_times_s(encounters: Sequence[Encounter], found: Iterable[FirstFound]) -> tuple[float, ...]:
    """When each encounter's vehicle is found, by the vehicles of `first_found`; NaN for never."""
    times = {(one.sequence_id, one.vehicle_id): one.found_s for one in found}
    return tuple(times.get((one.sequence_id, one.vehicle_id), math.nan) for one in encounters)


def time_benefit(name: str, encounters: Sequence[Encounter], detected_s: Sequence[float]) -> TimeBenefit:
    """The figures of a method that detects the encounters' vehicles at `detected_s`."""
    detected = np.array(detected_s, np.float64)
    is_occluded = np.array([one.is_occluded for one in encounters], np.bool_)
    light_s, sight_s, production_s, human_s = _columns(encounters)
    # A vehicle that never comes into sight is detected before it does, whenever that is.
    is_provident = (detected < sight_s) | (~np.isnan(detected) & np.isnan(sight_s))
    return TimeBenefit(
        name=name,
        detected_s=tuple(detected.tolist()),
        delays_s=MeanAndSpread.of(detected - light_s),
        before_production_s=MeanAndSpread.of(production_s - detected),
        occluded_before_production_s=MeanAndSpread.of((production_s - detected)[is_occluded]),
        before_human_s=MeanAndSpread.of(human_s - detected),
        before_sight_s=MeanAndSpread.of((sight_s - detected)[is_occluded]),
        provident_share=float(is_provident[is_occluded].mean()) if is_occluded.any() else math.nan,
        num_missed=int(np.isnan(detected).sum()),
    )


def _columns(encounters: Sequence[Encounter]) -> NDArray[np.float64]:
    """First light, first lamp, production system and human, shape (4, E)."""
    rows = [(one.light_s, one.sight_s, one.production_s, one.human_s) for one in encounters]
    return np.array(rows, np.float64).reshape(-1, 4).T
