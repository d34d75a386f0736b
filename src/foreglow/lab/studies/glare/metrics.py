"""What beam policies are worth: glare of other drivers, light kept on the road, and dimming for nobody."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.bootstrap import percentile_interval, ratio
from foreglow.lab.studies.glare.drive import GlareDrive, PolicyRun
from foreglow.lab.studies.glare.eyes import BINS, Glare, score_eye
from foreglow.lab.studies.glare.limits import FMVSS_108, Limits
from foreglow.lab.studies.glare.results import (
    BinGlare,
    DriveScore,
    GlareResults,
    GroupGlare,
    Interval,
    Moments,
    PolicyScore,
    RoadKept,
    Smoothness,
    WrongDimming,
)
from foreglow.lab.studies.glare.road import (
    RESTORE_S,
    Dimming,
    PhaseLight,
    Switching,
    phase_light,
    phases,
    switching,
    wrong_dimming,
)

POLICIES = ("low", "high", "production", "paper", "foreglow", "oracle")
"""The order of the rows; other names come after, as they are found."""

PRODUCTION = "production"
"""The policy that glare is set beside."""

ALL_BINS = "all"
NUM_RESAMPLES = 2000


def score_glare(
    name: str,
    drives: Iterable[GlareDrive],
    limits: Limits = FMVSS_108,
    *,
    restore_s: float = RESTORE_S,
    seed: int = 0,
) -> GlareResults:
    """The figures of all policies of `drives`, which are read once, one after the other.

    Args:
        name: What to call the set.
        drives: All with runs of the same policies.
        limits: For light at other drivers' eyes.
        restore_s: Time that light has to return after a vehicle has passed.
        seed: Of the bootstrap.

    Raises:
        ValueError: If there is no drive, or one has other policies than the first.
    """
    scores: dict[str, list[DriveScore]] = {}
    seconds = 0.0
    for drive in drives:
        if not scores:
            scores = {policy: [] for policy in _ordered(drive.runs)}
        if drive.runs.keys() != scores.keys():
            raise ValueError(f"drive {drive.name}: expected runs of {', '.join(scores)}, got {', '.join(drive.runs)}")
        for policy, run in drive.runs.items():
            scores[policy].append(score_drive(drive, run, limits, restore_s))
        seconds += len(drive.times_s) / drive.rate_hz
    if not scores:
        raise ValueError(f"{name}: expected at least one drive with runs of policies, found none")
    pool = _Pool(scores.get(PRODUCTION), seed)
    policies = tuple(pool.policy(policy, ones) for policy, ones in scores.items())
    return GlareResults(name, limits.name, restore_s, seconds, policies)


def typical_drives(results: GlareResults, shares: Sequence[float] = (0.25, 0.5, 0.75)) -> tuple[str, ...]:
    """Drives to look at that nobody picked: those at `shares` of the way from the least to the largest dose.

    The dose is that of `production` at oncoming drivers (else of the first policy), of drives with an occluded approach
    of one, or with any oncoming driver where there is no such drive; none without.
    """
    names = [one.name for one in results.policies]
    drives = results.policy(PRODUCTION if PRODUCTION in names else names[0]).drives
    met = [one for one in drives if one.of_group(is_oncoming=True)]
    occluded = [one for one in met if any(eye.is_occluded for eye in one.of_group(is_oncoming=True))]
    ordered = sorted(occluded or met, key=lambda one: (one.dose_lxs(is_oncoming=True), one.drive))
    places = [round(share * (len(ordered) - 1)) for share in shares] if ordered else []
    return tuple(dict.fromkeys(ordered[place].drive for place in places))


def score_drive(drive: GlareDrive, run: PolicyRun, limits: Limits, restore_s: float = RESTORE_S) -> DriveScore:
    """What one policy did on one drive."""
    its_phases = phases(drive, restore_s)
    return DriveScore(
        drive=drive.name,
        scenario=drive.scenario,
        is_empty=not drive.eyes and not drive.light_s,
        eyes=tuple(score_eye(drive, eye, run.levels, limits) for eye in drive.eyes),
        present=phase_light(drive, run, its_phases.is_present),
        passed=phase_light(drive, run, its_phases.is_passed),
        switching=switching(drive, run),
        dimming=wrong_dimming(drive, run, its_phases.is_free),
    )


@dataclass(frozen=True, slots=True)
class _Pool:
    """Adds up drives, beside those of the production system."""

    production: Sequence[DriveScore] | None
    seed: int

    def policy(self, name: str, drives: Sequence[DriveScore]) -> PolicyScore:
        return PolicyScore(
            name=name,
            oncoming=self._group(drives, is_oncoming=True),
            preceding=self._group(drives, is_oncoming=False),
            present=self._road([one.present for one in drives]),
            passed=self._road([one.passed for one in drives]),
            smoothness=_smoothness([one.switching for one in drives]),
            empty=self._dimming([one.dimming for one in drives if one.is_empty]),
            between=self._dimming([one.dimming for one in drives if not one.is_empty]),
            drives=tuple(drives),
        )

    def _group(self, drives: Sequence[DriveScore], *, is_oncoming: bool) -> GroupGlare:
        eyes = [eye for drive in drives for eye in drive.of_group(is_oncoming)]
        doses = np.array([_doses(drive, is_oncoming) for drive in drives])
        produced = np.full_like(doses, math.nan)
        if self.production is not None:
            produced = np.array([_doses(drive, is_oncoming) for drive in self.production])
        bins = []
        for place, bin_name in enumerate(BINS.bin_names):
            glare = _sum([eye.bins[place] for eye in eyes])
            bins.append(_bin(bin_name, glare, float(produced[:, place, 0].sum())))
        glare = _sum([one.glare for one in bins])
        bins.append(_bin(ALL_BINS, glare, float(produced[:, :, 0].sum())))
        own, low = doses.sum(axis=1).T
        occluded = [eye for eye in eyes if eye.is_occluded]
        return GroupGlare(
            num_eyes=len(eyes),
            bins=tuple(bins),
            dose_vs_production=self._ratio(own, produced[:, :, 0].sum(axis=1)),
            dose_vs_low=self._ratio(own, low),
            first=Moments.of(eye.first_glare_s for eye in eyes),
            first_occluded=Moments.of(eye.first_glare_s for eye in occluded),
            first_anywhere=Moments.of(eye.first_glare_anywhere_s for eye in eyes),
            first_anywhere_occluded=Moments.of(eye.first_glare_anywhere_s for eye in occluded),
        )

    def _road(self, drives: Sequence[PhaseLight]) -> RoadKept:
        kept, full, low = (
            np.array([getattr(one, name) for one in drives]).reshape(-1, 2)
            for name in ("kept_lxs", "full_lxs", "low_lxs")
        )
        low_lane, low_verge = (_divided(*one) for one in zip(low.sum(axis=0), full.sum(axis=0), strict=True))
        return RoadKept(
            seconds=math.fsum(one.seconds for one in drives),
            own_lane=self._ratio(kept[:, 0], full[:, 0]),
            verge=self._ratio(kept[:, 1], full[:, 1]),
            low_own_lane=low_lane,
            low_verge=low_verge,
        )

    def _dimming(self, drives: Sequence[Dimming]) -> WrongDimming:
        seconds = np.array([one.seconds for one in drives])
        events = np.array([float(one.num_events) for one in drives])
        dimmed_s = math.fsum(one.dimmed_s for one in drives)
        return WrongDimming(
            minutes=float(seconds.sum() / 60.0),
            num_events=int(events.sum()),
            events_per_minute=self._ratio(events, seconds / 60.0),
            dimmed_share=_divided(dimmed_s, math.fsum(one.seconds for one in drives)),
            area_dimmed=_divided(math.fsum(one.leds_off_s for one in drives), dimmed_s),
            road_dimmed=_divided(math.fsum(one.road_lost_s for one in drives), dimmed_s),
        )

    def _ratio(self, parts: NDArray[np.float64], wholes: NDArray[np.float64]) -> Interval:
        """Sum over sum, drive by drive, shape (S,) each."""
        counts = np.stack([parts, wholes], axis=1)
        low, high = percentile_interval(counts, ratio, num_resamples=NUM_RESAMPLES, seed=self.seed)
        return Interval(_divided(float(parts.sum()), float(wholes.sum())), low, high)


def _doses(drive: DriveScore, is_oncoming: bool) -> NDArray[np.float64]:
    """Shape (B, 2): by bin, the dose of the policy and of the low beam alone."""
    doses = [[(one.dose_lxs, one.low_dose_lxs) for one in eye.bins] for eye in drive.of_group(is_oncoming)]
    return np.asarray(np.array(doses, np.float64).reshape(-1, len(BINS.bin_names), 2).sum(axis=0))


def _bin(name: str, glare: Glare, production_lxs: float) -> BinGlare:
    return BinGlare(
        name=name,
        glare=glare,
        above_share=_divided(glare.above_s, glare.in_sight_s),
        over_low_lxs=glare.dose_lxs - glare.low_dose_lxs,
        vs_production=_divided(glare.dose_lxs, production_lxs),
    )


def _sum(glares: Sequence[Glare]) -> Glare:
    return Glare(*(math.fsum(getattr(one, field.name) for one in glares) for field in dataclasses.fields(Glare)))


def _smoothness(drives: Sequence[Switching]) -> Smoothness:
    seconds = math.fsum(one.seconds for one in drives)
    return Smoothness(
        change_per_s=_divided(math.fsum(one.change for one in drives), seconds),
        falls_per_minute=_divided(sum(one.num_falls for one in drives), seconds / 60.0),
        rises_per_minute=_divided(sum(one.num_rises for one in drives), seconds / 60.0),
        level_change_per_s=_divided(math.fsum(one.level_change for one in drives), seconds),
    )


def _ordered(names: Iterable[str]) -> list[str]:
    found = list(names)
    return [name for name in POLICIES if name in found] + [name for name in found if name not in POLICIES]


def _divided(part: float, whole: float) -> float:
    """Their ratio; NaN unless the whole is positive."""
    return float(part / whole) if whole > 0 else math.nan
