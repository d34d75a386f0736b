"""The paper's time benefit: how much earlier than a production system or a human a method detects a vehicle.

A method detects a vehicle with the first box that contains one of its key points.

Source: Ewecker et al., arXiv 2107.11302, the experiment on the time benefit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.files import fields_to_json
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.evaluation.ratios import mean, ratio, share
from foreglow.lab.evaluation.vehicles import Encounter, FirstFound, SequenceTracks

HUMAN_AFTER_PRODUCTION_S = 0.2
"""By how much a human who waits for direct sight reports a vehicle later than a production system, on average (paper,
from a study with a test group)."""


@dataclass(frozen=True, slots=True)
class MeanAndSpread(Spread):
    """Median, quartiles and mean of times, seconds; NaN of nothing."""

    mean: float

    @classmethod
    def of(cls, values: Iterable[float]) -> MeanAndSpread:
        """The spread and the mean of those of `values` that are not NaN.

        >>> MeanAndSpread.of([1.0, 2.0, math.nan, 6.0])
        MeanAndSpread(num=3, lower_quartile=1.5, median=2.0, upper_quartile=4.0, mean=3.0)
        """
        known = [float(value) for value in values if not math.isnan(value)]
        spread = Spread.of(known)
        return cls(spread.num, spread.lower_quartile, spread.median, spread.upper_quartile, mean(known))


@dataclass(frozen=True, slots=True)
class TimeBenefit:
    """How early one method detects the first vehicles.

    Attributes:
        detected_s: One time an encounter, in their order; NaN for never.
        delays_s: From the first annotated artifact.
        before_production_s: How much earlier than the production system; of the sequences in which both detect.
        occluded_before_production_s: `before_production_s` of occluded vehicles alone.
        before_human_s: How much earlier than a human.
        before_sight_s: How much earlier than the first annotated lamp; of occluded vehicles.
        provident_share: Of the occluded vehicles that come into sight, the share that is detected before the first
            annotated lamp; those that are never detected count against it. NaN without any.
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


@dataclass(frozen=True, slots=True)
class FalseTracks:
    """Confirmed tracks that never held any light of a vehicle, not even doubtful light.

    Attributes:
        num_plausible: Number of all confirmed tracks.
        km: Distance driven in them; NaN where the speed is unknown.
        num_empty: False tracks that came up in an image without any vehicle's light.
        num_groups: Groups of tracks that are close to one another, none of which held light.
        num_vehicles: Confirmed vehicles without any light, of a tracker that confirms vehicles; None of another one.
    """

    num: int
    num_plausible: int
    minutes: float
    km: float
    num_empty: int
    empty_minutes: float
    num_groups: int = 0
    num_vehicles: int | None = None

    @classmethod
    def of(cls, sequences: Sequence[SequenceTracks], km: float) -> FalseTracks:
        """Of all sequences together."""
        vehicles = [sequence.num_false_vehicles for sequence in sequences]
        return cls(
            num=sum(sequence.num_false for sequence in sequences),
            num_plausible=sum(sequence.num_plausible for sequence in sequences),
            minutes=sum(sequence.duration_s for sequence in sequences) / 60.0,
            km=km,
            num_empty=sum(sequence.num_false_empty for sequence in sequences),
            empty_minutes=sum(sequence.empty_s for sequence in sequences) / 60.0,
            num_groups=sum(sequence.num_false_groups for sequence in sequences),
            num_vehicles=None if None in vehicles else sum(filter(None, vehicles)),
        )

    @property
    def per_minute(self) -> float:
        """False tracks per minute; NaN without any time."""
        return ratio(self.num, self.minutes)

    @property
    def per_km(self) -> float:
        """False tracks per kilometre; NaN where the distance is unknown or 0."""
        return ratio(self.num, self.km)

    @property
    def per_empty_minute(self) -> float:
        """False tracks per minute of images without any vehicle's light; NaN without such images."""
        return ratio(self.num_empty, self.empty_minutes)

    @property
    def groups_per_minute(self) -> float:
        """False groups of tracks per minute; NaN without any time."""
        return ratio(self.num_groups, self.minutes)

    @property
    def vehicles_per_minute(self) -> float | None:
        """False vehicles per minute; None of a tracker that confirms none, NaN without any time."""
        return None if self.num_vehicles is None else ratio(self.num_vehicles, self.minutes)

    def to_json(self) -> dict[str, Any]:
        """All fields and rates by name."""
        rates = ("per_minute", "groups_per_minute", "vehicles_per_minute", "per_km", "per_empty_minute")
        return fields_to_json(self, *rates)


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the table.

    Attributes:
        false: Its false confirmed tracks; None for what is no tracker.
        delay_s: Mean time from the first annotated artifact, where a vehicle that is not detected before the production
            system reports it, or the sequence ends, counts as detected then: missing a vehicle makes no rule quick.
        plausibility_s: Of a tracker, how much later it detects each vehicle than the first single frame, for those that
            both detect; empty for what is no tracker.
    """

    benefit: TimeBenefit
    false: FalseTracks | None
    delay_s: float
    plausibility_s: tuple[float, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """All fields by name, those of the benefit on the same level."""
        others = {name: getattr(self, name) for name in ("false", "delay_s", "plausibility_s")}
        return fields_to_json(self.benefit) | others


def detection_times_s(encounters: Sequence[Encounter], found: Iterable[FirstFound]) -> tuple[float, ...]:
    """When each encounter's vehicle is found, by the vehicles of `first_found`; NaN for never."""
    times_s = {(vehicle.sequence_id, vehicle.vehicle_id): vehicle.found_s for vehicle in found}
    return tuple(times_s.get((met.sequence_id, met.vehicle_id), math.nan) for met in encounters)


def time_benefit(name: str, encounters: Sequence[Encounter], detected_s: Sequence[float]) -> TimeBenefit:
    """The figures of a method that detects the encounters' vehicles at `detected_s`."""
    detected = np.array(detected_s, np.float64)
    is_occluded = np.array([met.is_occluded for met in encounters], np.bool_)
    light_s, sight_s, production_s, human_s = _columns(encounters)
    comes = is_occluded & ~np.isnan(sight_s)
    return TimeBenefit(
        name=name,
        detected_s=tuple(detected.tolist()),
        delays_s=MeanAndSpread.of(detected - light_s),
        before_production_s=MeanAndSpread.of(production_s - detected),
        occluded_before_production_s=MeanAndSpread.of((production_s - detected)[is_occluded]),
        before_human_s=MeanAndSpread.of(human_s - detected),
        before_sight_s=MeanAndSpread.of((sight_s - detected)[is_occluded]),
        provident_share=share((detected < sight_s)[comes]),
        num_missed=int(np.isnan(detected).sum()),
    )


def mean_delay_s(encounters: Sequence[Encounter], detected_s: Sequence[float]) -> float:
    """See `Method.delay_s`."""
    light_s, _, production_s, _ = _columns(encounters)
    latest_s = np.fmax(light_s, np.where(np.isnan(production_s), [met.duration_s for met in encounters], production_s))
    return float((np.fmin(detected_s, latest_s) - light_s).mean())


def mean_timeline(encounters: Sequence[Encounter], methods: Iterable[TimeBenefit]) -> tuple[int, dict[str, float]]:
    """The number of vehicles that all `methods` detect, and after which mean time each method detects these, by name.

    Times are from the first annotated artifact, seconds; NaN without such a vehicle.
    """
    light_s, *_ = _columns(encounters)
    delays_s = {method.name: np.array(method.detected_s) - light_s for method in methods}
    is_known = ~np.isnan(list(delays_s.values())).any(axis=0)
    return int(is_known.sum()), {name: mean(delays[is_known].tolist()) for name, delays in delays_s.items()}


def least_delay_s(curve: Sequence[Method], max_groups_per_minute: float) -> float:
    """The least mean delay of those settings of a rule that keep to the limit; NaN if none does."""
    return min(
        (
            method.delay_s
            for method in curve
            if method.false is not None and method.false.groups_per_minute <= max_groups_per_minute
        ),
        default=math.nan,
    )


def _columns(encounters: Sequence[Encounter]) -> NDArray[np.float64]:
    """First light, first lamp, production system and human, shape (4, E)."""
    rows = [(met.light_s, met.sight_s, met.production_s, met.human_s) for met in encounters]
    return np.array(rows, np.float64).reshape(-1, 4).T
