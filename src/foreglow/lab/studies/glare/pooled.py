"""Figures pooled over drives: glare, road light, switching and wrong dimming, with intervals.

Numbers of drives are added before anything is divided, so each second with a driver in range weighs the same: long
approaches, and drives with more vehicles, weigh more. Intervals say how far another draw of drives would move a figure.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.evaluation import bootstrap
from foreglow.lab.evaluation.ratios import mean, percentiles, ratio, share
from foreglow.lab.studies.glare.drive import GlareDrive, PolicyRun
from foreglow.lab.studies.glare.eyes import BINS, EyeScore, Glare, Limits, score_eye
from foreglow.lab.studies.glare.road import (
    Dimming,
    LitRoad,
    PhaseLight,
    Switching,
    lit_road,
    phase_light,
    phases,
    switching,
    wrong_dimming,
)


@dataclass(frozen=True, slots=True)
class DriveScore:
    """One policy on one drive: what adds up to its figures.

    Attributes:
        is_empty: Whether there is no other driver at all.
        present: Light on the road while a vehicle is there.
        passed: Light on the road after the vehicle has passed and light had time to return.
    """

    drive: str
    scenario: str
    is_empty: bool
    eyes: tuple[EyeScore, ...]
    present: PhaseLight
    passed: PhaseLight
    switching: Switching
    dimming: Dimming
    lit_road: LitRoad

    def of_group(self, is_oncoming: bool) -> tuple[EyeScore, ...]:
        """The oncoming, or the preceding drivers."""
        return tuple(eye for eye in self.eyes if eye.is_oncoming == is_oncoming)

    def dose_lxs(self, is_oncoming: bool) -> float:
        """Of all oncoming, or all preceding drivers."""
        return math.fsum(eye.dose_lxs for eye in self.of_group(is_oncoming))

    def doses_lxs(self, is_oncoming: bool) -> Floats:
        """Shape (B, 2): by bin, the dose of the policy and of the low beam alone."""
        doses = [[(glare.dose_lxs, glare.low_dose_lxs) for glare in eye.bins] for eye in self.of_group(is_oncoming)]
        return np.asarray(np.array(doses, np.float64).reshape(-1, len(BINS.bin_names), 2).sum(axis=0))


def score_drive(drive: GlareDrive, run: PolicyRun, limits: Limits) -> DriveScore:
    """What one policy did on one drive."""
    when = phases(drive)
    return DriveScore(
        drive=drive.name,
        scenario=drive.scenario,
        is_empty=not (drive.eyes or drive.light_s or drive.gone_s),
        eyes=tuple(score_eye(drive, eye, run.levels, limits) for eye in drive.eyes),
        present=phase_light(drive, run, when.is_present),
        passed=phase_light(drive, run, when.is_passed),
        switching=switching(drive, run),
        dimming=wrong_dimming(drive, run, when.is_free),
        lit_road=lit_road(drive, run),
    )


ALL_BINS = "all"
NUM_RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure over all drives, and its 95 % interval over drives.

    With fewer than some twenty drives the interval is too narrow; with one there is none.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of_ratio(cls, parts: Floats, wholes: Floats, seed: int) -> Interval:
        """Sum over sum, drive by drive, shape (S,) each."""
        counts = np.stack([parts, wholes], axis=1)
        low, high = bootstrap.percentile_interval(counts, bootstrap.ratio, num_resamples=NUM_RESAMPLES, seed=seed)
        return cls(ratio(parts.sum(), wholes.sum()), low, high)


@dataclass(frozen=True, slots=True)
class Moments:
    """First glare moments, seconds; NaN without any.

    The median says little where it is 0: the mean, the 90th percentile and the share stand beside it. Each eye counts
    once, however long it is in sight.

    Attributes:
        median: Half of them have no longer one.
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
        """The figures of the times that are not NaN.

        >>> Moments.of([0.0, 0.0, 0.5, math.nan]).median
        0.0
        """
        known = [value_s for value_s in values_s if not math.isnan(value_s)]
        median, p90 = percentiles(known, (50, 90))
        return cls(len(known), median, mean(known), p90, share([value_s == 0 for value_s in known]))


@dataclass(frozen=True, slots=True)
class BinGlare:
    """Glare in one range bin, over all drives.

    Attributes:
        name: The bin, such as `30-60 m`, or `all`.
        glare: Sums, see `Glare`.
        over_low_lxs: Dose that is not the low beam's: what is left if that of the low beam alone is taken off.
        vs_production: Dose over that of the policy `production`; NaN where that has none, however large this one is.
    """

    name: str
    glare: Glare
    above_share: float
    over_low_lxs: float
    vs_production: float

    @classmethod
    def of(cls, name: str, glares: Iterable[Glare], production_lxs: float) -> BinGlare:
        """All `glares` together, beside the dose of `production`."""
        rows = [dataclasses.astuple(glare) for glare in glares] or [(0.0,) * len(dataclasses.fields(Glare))]
        glare = Glare(*map(math.fsum, zip(*rows, strict=True)))
        return cls(
            name=name,
            glare=glare,
            above_share=ratio(glare.above_s, glare.in_sight_s),
            over_low_lxs=glare.dose_lxs - glare.low_dose_lxs,
            vs_production=ratio(glare.dose_lxs, production_lxs),
        )


@dataclass(frozen=True, slots=True)
class GroupGlare:
    """Glare of all oncoming, or all preceding drivers.

    Attributes:
        bins: By range, the last one is all of them.
        dose_vs_production: Dose over that of `production`, all bins; NaN where that has none, or is not among the
            policies. A few long glares can decide it: see the drives.
        dose_vs_low: Dose over that of the low beam alone; NaN where that has none. It is large as soon as the low beam
            hardly glares: read `over_low_lxs` beside it.
        first: First glare moments within the reach of the limits.
        first_occluded: `first` of occluded approaches alone.
        first_anywhere: From the first sight at any range.
        first_anywhere_occluded: `first_anywhere` of occluded approaches alone.
    """

    num_eyes: int
    bins: tuple[BinGlare, ...]
    dose_vs_production: Interval
    dose_vs_low: Interval
    first: Moments
    first_occluded: Moments
    first_anywhere: Moments
    first_anywhere_occluded: Moments

    @classmethod
    def of(
        cls, drives: Sequence[DriveScore], production: Sequence[DriveScore] | None, is_oncoming: bool, seed: int
    ) -> GroupGlare:
        """The oncoming, or the preceding drivers of `drives`, beside the same drives with the policy `production`."""
        eyes = [eye for drive in drives for eye in drive.of_group(is_oncoming)]
        occluded = [eye for eye in eyes if eye.is_occluded]
        doses = np.array([drive.doses_lxs(is_oncoming) for drive in drives])
        produced_lxs = np.full(doses.shape[:2], math.nan)
        if production is not None:
            produced_lxs = np.array([drive.doses_lxs(is_oncoming) for drive in production])[:, :, 0]
        bins = [
            BinGlare.of(name, [eye.bins[index] for eye in eyes], float(produced_lxs[:, index].sum()))
            for index, name in enumerate(BINS.bin_names)
        ]
        bins.append(BinGlare.of(ALL_BINS, [part.glare for part in bins], float(produced_lxs.sum())))
        own_lxs, low_lxs = doses.sum(axis=1).T
        return cls(
            num_eyes=len(eyes),
            bins=tuple(bins),
            dose_vs_production=Interval.of_ratio(own_lxs, produced_lxs.sum(axis=1), seed),
            dose_vs_low=Interval.of_ratio(own_lxs, low_lxs, seed),
            first=Moments.of(eye.first_glare_s for eye in eyes),
            first_occluded=Moments.of(eye.first_glare_s for eye in occluded),
            first_anywhere=Moments.of(eye.first_glare_anywhere_s for eye in eyes),
            first_anywhere_occluded=Moments.of(eye.first_glare_anywhere_s for eye in occluded),
        )

    @property
    def all_bins(self) -> BinGlare:
        """Over all ranges."""
        return self.bins[-1]

    def known_lxs(self, dose_lxs: float) -> float:
        """A dose of this group; NaN where there is nobody, whose dose of 0 says nothing."""
        return dose_lxs if self.num_eyes else math.nan


@dataclass(frozen=True, slots=True)
class RoadKept:
    """Light on the road over that of the full high beam, in one phase of all drives.

    The low beam alone already has a share; a policy is to be read between that and 1.

    Attributes:
        seconds: Duration of the phase; without any, the shares are NaN.
        low_own_lane: The low beam's share on our own lane.
    """

    seconds: float
    own_lane: Interval
    verge: Interval
    low_own_lane: float
    low_verge: float

    @classmethod
    def of(cls, drives: Sequence[PhaseLight], seed: int) -> RoadKept:
        """All drives together."""
        names = ("kept_lxs", "full_lxs", "low_lxs")
        kept, full, low = (np.array([getattr(drive, name) for drive in drives]).reshape(-1, 2) for name in names)
        low_lane, low_verge = map(ratio, low.sum(axis=0), full.sum(axis=0))
        return cls(
            seconds=math.fsum(drive.seconds for drive in drives),
            own_lane=Interval.of_ratio(kept[:, 0], full[:, 0], seed),
            verge=Interval.of_ratio(kept[:, 1], full[:, 1], seed),
            low_own_lane=low_lane,
            low_verge=low_verge,
        )


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

    @classmethod
    def of(cls, drives: Sequence[Switching]) -> Smoothness:
        """All drives together."""
        seconds = math.fsum(drive.seconds for drive in drives)
        return cls(
            change_per_s=ratio(math.fsum(drive.change for drive in drives), seconds),
            falls_per_minute=ratio(sum(drive.num_falls for drive in drives), seconds / 60.0),
            rises_per_minute=ratio(sum(drive.num_rises for drive in drives), seconds / 60.0),
            level_change_per_s=ratio(math.fsum(drive.level_change for drive in drives), seconds),
        )


@dataclass(frozen=True, slots=True)
class WrongDimming:
    """Dimming for nobody. See `Dimming`: no event can also mean that there never was full beam.

    Attributes:
        minutes: Time with nobody there; without any, all else is NaN.
        num_events: Times that full beam was dimmed.
        num_questions: Those of them that were shallow and short.
        light_lost: Share of the LEDs' light that is off, over all the time.
        area_dimmed: Share of the LEDs' light that is off, on average while dimmed; NaN where nothing is dimmed.
        road_dimmed: Share of the road's light that is lost, on average while dimmed.
    """

    minutes: float
    num_events: int
    num_questions: int
    events_per_minute: Interval
    light_lost: float
    dimmed_share: float
    area_dimmed: float
    road_dimmed: float

    @classmethod
    def of(cls, drives: Sequence[Dimming], seed: int) -> WrongDimming:
        """All drives together."""
        seconds = np.array([drive.seconds for drive in drives])
        events = np.array([float(drive.num_events) for drive in drives])
        dimmed_s = math.fsum(drive.dimmed_s for drive in drives)
        return cls(
            minutes=float(seconds.sum() / 60.0),
            num_events=int(events.sum()),
            num_questions=sum(drive.num_questions for drive in drives),
            light_lost=ratio(math.fsum(drive.leds_off_s for drive in drives), math.fsum(seconds)),
            events_per_minute=Interval.of_ratio(events, seconds / 60.0, seed),
            dimmed_share=ratio(dimmed_s, math.fsum(seconds)),
            area_dimmed=ratio(math.fsum(drive.leds_off_s for drive in drives), dimmed_s),
            road_dimmed=ratio(math.fsum(drive.road_lost_s for drive in drives), dimmed_s),
        )


@dataclass(frozen=True, slots=True)
class LitRoads:
    """High beam on lit roads, and low beam on dark ones. See `LitRoad`.

    Attributes:
        minutes: Time on lit roads; without any, the shares are NaN.
        high_share: Share of it with high beam.
        switched_share: Share of the lit streets with low beam in time.
        low_per_hour: Times that high beam ended in low beam on dark roads, an hour there.
    """

    minutes: float
    high_share: float
    num_streets: int
    switched_share: float
    dark_minutes: float
    low_per_hour: float

    @classmethod
    def of(cls, drives: Sequence[LitRoad]) -> LitRoads:
        """All drives together."""
        rows = [dataclasses.astuple(drive) for drive in drives] or [(0.0,) * len(dataclasses.fields(LitRoad))]
        seconds, high_s, num_streets, num_switched, dark_s, num_low = map(math.fsum, zip(*rows, strict=True))
        return cls(
            minutes=seconds / 60.0,
            high_share=ratio(high_s, seconds),
            num_streets=int(num_streets),
            switched_share=ratio(num_switched, num_streets),
            dark_minutes=dark_s / 60.0,
            low_per_hour=ratio(num_low, dark_s / 3600.0),
        )
