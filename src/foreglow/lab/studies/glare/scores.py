"""The figures of beam policies over all drives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from foreglow.lab.studies.glare.drive import GlareDrive
from foreglow.lab.studies.glare.eyes import FMVSS_108, Limits
from foreglow.lab.studies.glare.pooled import (
    DriveScore,
    GroupGlare,
    LitRoads,
    RoadKept,
    Smoothness,
    WrongDimming,
    score_drive,
)
from foreglow.lab.studies.glare.road import AFTER_S

POLICY_ROWS = ("low", "high", "production", "paper", "foreglow", "oracle")
"""The order of the rows; other names come after, as they are found."""

PRODUCTION = "production"
"""The policy that glare is set beside."""


@dataclass(frozen=True, slots=True)
class PolicyScore:
    """One row of the table.

    Attributes:
        present: Light on the road while a vehicle is there.
        passed: Light on the road after the vehicle has passed and light had time to return.
        smoothness: How much the light changes.
        empty: Wrong dimming in drives without any other driver.
        between: Wrong dimming in the other drives, long before and after.
        lit_roads: High beam on lit roads, and low beam on dark ones.
    """

    name: str
    oncoming: GroupGlare
    preceding: GroupGlare
    present: RoadKept
    passed: RoadKept
    smoothness: Smoothness
    empty: WrongDimming
    between: WrongDimming
    lit_roads: LitRoads
    drives: tuple[DriveScore, ...]

    @classmethod
    def of(
        cls, name: str, drives: Sequence[DriveScore], production: Sequence[DriveScore] | None, seed: int
    ) -> PolicyScore:
        """All drives together, beside the same with the policy `production`."""
        return cls(
            name=name,
            oncoming=GroupGlare.of(drives, production, True, seed),
            preceding=GroupGlare.of(drives, production, False, seed),
            present=RoadKept.of([drive.present for drive in drives], seed),
            passed=RoadKept.of([drive.passed for drive in drives], seed),
            smoothness=Smoothness.of([drive.switching for drive in drives]),
            empty=WrongDimming.of([drive.dimming for drive in drives if drive.is_empty], seed),
            between=WrongDimming.of([drive.dimming for drive in drives if not drive.is_empty], seed),
            lit_roads=LitRoads.of([drive.lit_road for drive in drives]),
            drives=tuple(drives),
        )


@dataclass(frozen=True, slots=True)
class SensitivityPoint:
    """One policy with one value of one parameter.

    Attributes:
        parameter: What was varied, such as `latency`.
        unit: Its unit, such as `ms`; may be empty.
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
    def of(
        cls, parameter: str, unit: str, value: float, score: PolicyScore, policy: str | None = None
    ) -> SensitivityPoint:
        """The figures of `score`, as those of `policy` where that is given."""
        figures = (score.oncoming.dose_vs_production, score.present.own_lane, score.empty.events_per_minute)
        return cls(parameter, unit, value, policy or score.name, *(figure.value for figure in figures))


@dataclass(frozen=True, slots=True)
class GlareResults:
    """Everything that the report shows.

    Attributes:
        after_s: Time after a vehicle has passed from which light counts as afterwards; no `restore_s` of a policy.
        seconds: Of all drives.
        policies: The rows, in the order of `POLICY_ROWS`.
        sensitivity: How figures move with parameters; may be empty.
    """

    name: str
    limits: str
    after_s: float
    seconds: float
    policies: tuple[PolicyScore, ...]
    sensitivity: tuple[SensitivityPoint, ...] = ()

    def policy(self, name: str) -> PolicyScore:
        """The row called `name`.

        Raises:
            ValueError: If there is none; the message lists the names.
        """
        policies = {policy.name: policy for policy in self.policies}
        if name not in policies:
            raise ValueError(f"policy: expected one of {', '.join(policies)}, got {name!r}")
        return policies[name]


def score_glare(
    name: str,
    drives: Iterable[GlareDrive],
    limits: Limits = FMVSS_108,
    *,
    seed: int = 0,
) -> GlareResults:
    """The figures of all policies of `drives`, which are gone through once.

    Raises:
        ValueError: If there is no drive, or one has other policies than the first.
    """
    scores: dict[str, list[DriveScore]] = {}
    seconds = 0.0
    for drive in drives:
        if not scores:
            known = [policy for policy in POLICY_ROWS if policy in drive.runs]
            scores = {policy: [] for policy in dict.fromkeys([*known, *drive.runs])}
        if drive.runs.keys() != scores.keys():
            raise ValueError(f"drive {drive.name}: expected runs of {', '.join(scores)}, got {', '.join(drive.runs)}")
        for policy, run in drive.runs.items():
            scores[policy].append(score_drive(drive, run, limits))
        seconds += len(drive.times_s) / drive.rate_hz
    if not scores:
        raise ValueError(f"{name}: expected at least one drive with runs of policies, found none")
    production = scores.get(PRODUCTION)
    policies = (PolicyScore.of(policy, of_policy, production, seed) for policy, of_policy in scores.items())
    return GlareResults(name, limits.name, AFTER_S, seconds, tuple(policies))


def typical_drives(results: GlareResults) -> tuple[str, ...]:
    """Drives to show, chosen by a rule: those at the quartiles of the dose.

    The dose is that of `production` at oncoming drivers (else of the first policy), of drives with an occluded approach
    of one, or with any oncoming driver where there is no such drive; none without.
    """
    names = [policy.name for policy in results.policies]
    drives = results.policy(PRODUCTION if PRODUCTION in names else names[0]).drives
    met = [drive for drive in drives if drive.of_group(is_oncoming=True)]
    occluded = [drive for drive in met if any(eye.is_occluded for eye in drive.of_group(is_oncoming=True))]
    ordered = sorted(occluded or met, key=lambda drive: (drive.dose_lxs(is_oncoming=True), drive.drive))
    chosen = [round(part * (len(ordered) - 1)) for part in (0.25, 0.5, 0.75)] if ordered else []
    return tuple(dict.fromkeys(ordered[index].drive for index in chosen))
