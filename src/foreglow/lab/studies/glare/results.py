"""The figures of beam policies: frozen values, to JSON and back, so that reports need nothing else.

Numbers of drives are added before anything is divided, so each second with a driver in range weighs the same: long
approaches, and drives with more vehicles, weigh more. Intervals say how far another draw of drives would move a figure.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from foreglow.lab.evaluation.boxes.breakdown import plain
from foreglow.lab.studies.glare.eyes import EyeScore, Glare
from foreglow.lab.studies.glare.road import Dimming, PhaseLight, Switching


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure over all drives, and its 95 % interval over drives.

    With fewer than some twenty drives the interval is too narrow; with one it is a point.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Moments:
    """First glare moments, seconds; NaN of nothing.

    The median says little where it is 0: the mean, the 90th percentile and the share stand beside it. Each eye counts
    once, however long it is in sight.

    Attributes:
        num: Eyes whose first sight of us is in their drive.
        median: Half of them have no longer one.
        mean: Over all of them.
        p90: 90th percentile.
        dark_share: Share of them that are dark from the beginning.
    """

    num: int
    median: float
    mean: float
    p90: float
    dark_share: float

    @classmethod
    def of(cls, values_s: Iterable[float]) -> Moments:
        """Of those that are not NaN.

        >>> Moments.of([0.0, 0.0, 0.5, math.nan]).median
        0.0
        """
        known = np.array([one for one in values_s if not math.isnan(one)])
        if not len(known):
            return cls(0, math.nan, math.nan, math.nan, math.nan)
        median, p90 = np.percentile(known, (50, 90)).tolist()
        return cls(len(known), median, float(known.mean()), p90, float((known == 0).mean()))


@dataclass(frozen=True, slots=True)
class BinGlare:
    """Glare in one range bin, over all drives.

    Attributes:
        name: The bin, such as `30-60 m`, or `all`.
        glare: Sums, see `Glare`.
        above_share: Time above the limit over time in sight.
        over_low_lxs: Dose that is not the low beam's: what is left if that of the low beam alone is taken off.
        vs_production: Dose over that of the policy `production`; NaN where that has none, however large this one is.
    """

    name: str
    glare: Glare
    above_share: float
    over_low_lxs: float
    vs_production: float


@dataclass(frozen=True, slots=True)
class GroupGlare:
    """Glare of all oncoming, or all preceding drivers.

    Attributes:
        num_eyes: Drivers.
        bins: By range, the last one is all of them.
        dose_vs_production: Dose over that of `production`, all bins; NaN where that has none, or is not among the
            policies. A few long glares can decide it: see the drives.
        dose_vs_low: Dose over that of the low beam alone; NaN where that has none. It is large as soon as the low beam
            hardly glares: read `over_low_lxs` beside it.
        first: First glare moments within the reach of the limits.
        first_occluded: Those of occluded approaches alone.
        first_anywhere: From the first sight at any range.
        first_anywhere_occluded: Those of occluded approaches alone.
    """

    num_eyes: int
    bins: tuple[BinGlare, ...]
    dose_vs_production: Interval
    dose_vs_low: Interval
    first: Moments
    first_occluded: Moments
    first_anywhere: Moments
    first_anywhere_occluded: Moments

    @property
    def all_bins(self) -> BinGlare:
        """Over all ranges."""
        return self.bins[-1]


@dataclass(frozen=True, slots=True)
class RoadKept:
    """Light on the road over that of the full high beam, in one phase of all drives.

    The low beam alone already has a share; a policy is to be read between that and 1.

    Attributes:
        seconds: Duration of the phase; without any, the shares are NaN.
        own_lane: Share on our own lane.
        verge: Share on the verge.
        low_own_lane: The low beam's share on our own lane.
        low_verge: That on the verge.
    """

    seconds: float
    own_lane: Interval
    verge: Interval
    low_own_lane: float
    low_verge: float


@dataclass(frozen=True, slots=True)
class Smoothness:
    """How much the light changes; a policy that does nothing is the smoothest. See `Switching`.

    Attributes:
        change_per_s: Mean absolute change of the road's light a second, as a share of full beam.
        falls_per_minute: Jumps down.
        rises_per_minute: Jumps up.
        level_change_per_s: Total variation of the levels a second, mean of all LEDs.
    """

    change_per_s: float
    falls_per_minute: float
    rises_per_minute: float
    level_change_per_s: float


@dataclass(frozen=True, slots=True)
class WrongDimming:
    """Dimming for nobody. See `Dimming`: no event can also mean that there never was full beam.

    Attributes:
        minutes: Time with nobody there; without any, all else is NaN.
        num_events: Times that full beam was dimmed.
        events_per_minute: Their rate.
        dimmed_share: Share of the time below full.
        area_dimmed: Share of the LEDs' light that is off, on average while dimmed; NaN where nothing is dimmed.
        road_dimmed: Share of the road's light that is lost, on average while dimmed.
    """

    minutes: float
    num_events: int
    events_per_minute: Interval
    dimmed_share: float
    area_dimmed: float
    road_dimmed: float


@dataclass(frozen=True, slots=True)
class DriveScore:
    """One policy on one drive: what adds up to its figures.

    Attributes:
        drive: The scene.
        scenario: What was drawn.
        is_empty: Whether there is no other driver at all.
        eyes: Other drivers.
        present: Light on the road while a vehicle is there.
        passed: And after it has passed and light had time to return.
        switching: How much the light changes.
        dimming: Light dimmed while nobody is there.
    """

    drive: str
    scenario: str
    is_empty: bool
    eyes: tuple[EyeScore, ...]
    present: PhaseLight
    passed: PhaseLight
    switching: Switching
    dimming: Dimming

    def of_group(self, is_oncoming: bool) -> tuple[EyeScore, ...]:
        """The oncoming, or the preceding drivers."""
        return tuple(one for one in self.eyes if one.is_oncoming == is_oncoming)

    def dose_lxs(self, is_oncoming: bool) -> float:
        """Of all oncoming, or all preceding drivers."""
        return math.fsum(one.dose_lxs for one in self.of_group(is_oncoming))


@dataclass(frozen=True, slots=True)
class PolicyScore:
    """One row of the table.

    Attributes:
        name: The policy.
        oncoming: Glare of those who come towards us.
        preceding: Glare of those whom we follow.
        present: Light on the road while a vehicle is there.
        passed: And after it has passed and light had time to return.
        smoothness: How much the light changes.
        empty: Wrong dimming in drives without any other driver.
        between: Wrong dimming in the other drives, long before and after.
        drives: The same drive by drive.
    """

    name: str
    oncoming: GroupGlare
    preceding: GroupGlare
    present: RoadKept
    passed: RoadKept
    smoothness: Smoothness
    empty: WrongDimming
    between: WrongDimming
    drives: tuple[DriveScore, ...]


@dataclass(frozen=True, slots=True)
class SensitivityPoint:
    """One policy with one value of one parameter.

    Attributes:
        parameter: What was varied, such as `latency`.
        unit: Its unit, such as `ms`; may be empty.
        value: Its value.
        policy: Whose.
        dose_vs_production: Dose of oncoming drivers over that of `production`.
        road_kept: Light on the own lane while a vehicle is there, over full beam.
        wrong_per_minute: Wrong dimming in drives without any other driver.
    """

    parameter: str
    unit: str
    value: float
    policy: str
    dose_vs_production: float
    road_kept: float
    wrong_per_minute: float

    @classmethod
    def of(cls, parameter: str, unit: str, value: float, score: PolicyScore) -> SensitivityPoint:
        """The figures of `score`."""
        figures = (score.oncoming.dose_vs_production, score.present.own_lane, score.empty.events_per_minute)
        return cls(parameter, unit, value, score.name, *(one.value for one in figures))


@dataclass(frozen=True, slots=True)
class GlareResults:
    """Everything that the report shows.

    Attributes:
        name: The set of drives.
        limits: What the limits are from.
        restore_s: Time that light had to return after a vehicle.
        seconds: Of all drives.
        policies: The rows, in the order of `POLICIES`.
        sensitivity: How figures move with parameters; may be empty.
    """

    name: str
    limits: str
    restore_s: float
    seconds: float
    policies: tuple[PolicyScore, ...]
    sensitivity: tuple[SensitivityPoint, ...] = ()

    def policy(self, name: str) -> PolicyScore:
        """The row called `name`.

        Raises:
            ValueError: If there is none; the message lists the names.
        """
        for one in self.policies:
            if one.name == name:
                return one
        raise ValueError(f"policy: expected one of {', '.join(one.name for one in self.policies)}, got {name!r}")

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        record: dict[str, Any] = _each(dataclasses.asdict(self), plain)
        return record

    @classmethod
    def from_json(cls, record: Any) -> GlareResults:
        """What `to_json` gave; fields that it does not have are passed over.

        Raises:
            ValueError: If a field is missing or of another type; the message names it.
        """
        try:
            return _RESULTS.validate_python(_each(record, lambda one: math.nan if one is None else one))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            field = ".".join(str(part) for part in first["loc"]) or "document"
            raise ValueError(f"glare results: {field}: {first['msg']}") from None


_RESULTS = TypeAdapter(GlareResults)


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """`value` with `change` made to everything in it that is no list or object."""
    if isinstance(value, dict):
        return {key: _each(one, change) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_each(one, change) for one in value]
    return change(value)
