"""The tables of the glare experiment as cells, and the figures of each drive by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeAlias

from foreglow.lab.reports.numbers import number, percent, signed
from foreglow.lab.studies.detector.tables import Table
from foreglow.lab.studies.glare.results import (
    DriveScore,
    GlareResults,
    GroupGlare,
    Interval,
    Moments,
    PolicyScore,
    WrongDimming,
)
from foreglow.lab.studies.glare.road import JUMP
from foreglow.lab.studies.occurrence.metrics import NEAR_DEG, LeadScore

Columns: TypeAlias = Mapping[str, Callable[[PolicyScore], str]]
"""By head, what stands in a policy's cell."""

UNGUIDED = ("low", "high")
"""Policies that see nothing; they have no gaps, and no column in the table of drives."""


def glare_tables(results: GlareResults, others: Sequence[GlareResults] = ()) -> Iterator[tuple[str, str, Table]]:
    """Heading, remark and table of every section."""
    policies = results.policies
    yield (
        "Policies",
        "Dose: light above the limit at oncoming drivers' eyes, over time. In brackets: 95 % interval over drives. "
        "First glare moment of drivers whose light was there before: median, mean, and share that has none. Light "
        "kept: share of the full high beam's while a vehicle is present, and after. Wrong: dimming for nobody.",
        _table(_MAIN, policies),
    )
    groups: dict[str, Callable[[PolicyScore], GroupGlare]] = {"Oncoming drivers": lambda one: one.oncoming}
    if policies[0].preceding.num_eyes:
        groups["Preceding drivers"] = lambda one: one.preceding
    for heading, of in groups.items():
        yield (
            heading,
            "Dose in lx s by range (share of the time in sight above the limit); seconds in sight in the head. Added: "
            "what the LEDs add to the low beam while the whole is above the limit.",
            _glare_table(policies, of),
        )
        yield (
            heading + ", first glare moment",
            "Seconds: median, mean, 90th percentile; share that is dark from the beginning (number of drivers).",
            _table(_moment_columns(of), policies),
        )
    for other in others:
        heading = f"Against other limits: {other.limits}"
        yield heading, "As the first table.", _table(_GLARE, other.policies)
    yield (
        "Light on the road",
        "Share of the full high beam's, 40 to 120 m ahead, while a vehicle is present; what the low beam alone gives "
        f"is what no light above it means. After: from {results.restore_s:g} s after the vehicle has passed.",
        _table(_ROAD, policies),
    )
    yield (
        "Wrong dimming",
        "In drives without any other driver.",
        _table(_dimming_columns(lambda one: one.empty), policies),
    )
    yield (
        "Wrong dimming in other drives",
        "While nobody is there yet, or any more.",
        _table(_dimming_columns(lambda one: one.between), policies),
    )
    yield "Switching", "Changes of the road's light, as a share of full beam.", _table(_SWITCHING, policies)


def occurrence_table(leads: Sequence[LeadScore]) -> Iterator[tuple[str, str, Table]]:
    """Heading, remark and table of where hidden vehicles appeared; nothing without any."""
    head = ["before direct sight", "hidden vehicles", "told", "median error", f"within {NEAR_DEG:g} deg"]
    head += ["held by the gap", "its median width", "median error of the time"]
    rows = [
        [
            f"{one.lead_s:g} s",
            str(one.num),
            str(one.num_told),
            f"{number(one.median_deg)} deg",
            percent(one.near_share),
            percent(one.covered_share),
            f"{number(one.width_deg, 1)} deg",
            f"{number(one.median_s)} s",
        ]
        for one in leads
    ]
    if rows:
        yield (
            "Occurrence point",
            "Where a vehicle comes into sight, told from its light and the road; errors of those of which something "
            "was told at that time.",
            Table(head, rows, [""] * len(rows)),
        )


def _table(columns: Columns, policies: Sequence[PolicyScore]) -> Table:
    rows = [[one.name, *(cell(one) for cell in columns.values())] for one in policies]
    return Table(["policy", *columns], rows, [""] * len(rows))


_GLARE: Columns = {
    "dose, lx s": lambda one: number(one.oncoming.all_bins.glare.dose_lxs),
    "of production's": lambda one: interval(one.oncoming.dose_vs_production, percent),
    "over low beam's": lambda one: signed(one.oncoming.all_bins.over_low_lxs),
    "first glare, s": lambda one: number(one.oncoming.first_occluded.median),
    "mean, s": lambda one: number(one.oncoming.first_occluded.mean),
    "none": lambda one: percent(one.oncoming.first_occluded.dark_share),
}

_MAIN: Columns = {
    **_GLARE,
    "own lane kept": lambda one: interval(one.present.own_lane, percent),
    "verge kept": lambda one: percent(one.present.verge.value),
    "own lane after": lambda one: percent(one.passed.own_lane.value),
    "wrong a minute": lambda one: number(one.empty.events_per_minute.value),
}

_ROAD: Columns = {
    "own lane": lambda one: interval(one.present.own_lane, percent),
    "low beam alone, own lane": lambda one: percent(one.present.low_own_lane),
    "verge": lambda one: interval(one.present.verge, percent),
    "low beam alone, verge": lambda one: percent(one.present.low_verge),
    "seconds": lambda one: number(one.present.seconds, 0),
    "own lane after": lambda one: percent(one.passed.own_lane.value),
    "verge after": lambda one: percent(one.passed.verge.value),
    "seconds after": lambda one: number(one.passed.seconds, 0),
}

_SWITCHING: Columns = {
    "change a second": lambda one: percent(one.smoothness.change_per_s),
    f"falls > {JUMP:.0%} a minute": lambda one: number(one.smoothness.falls_per_minute, 1),
    f"rises > {JUMP:.0%} a minute": lambda one: number(one.smoothness.rises_per_minute, 1),
    "variation of levels a second": lambda one: number(one.smoothness.level_change_per_s, 3),
}


def _dimming_columns(of: Callable[[PolicyScore], WrongDimming]) -> Columns:
    return {
        "minutes": lambda one: number(of(one).minutes, 1),
        "events": lambda one: str(of(one).num_events),
        "a minute": lambda one: interval(of(one).events_per_minute, number),
        "time dimmed": lambda one: percent(of(one).dimmed_share),
        "area dimmed": lambda one: percent(of(one).area_dimmed),
        "road light lost while dimmed": lambda one: percent(of(one).road_dimmed),
    }


def _moment_columns(of: Callable[[PolicyScore], GroupGlare]) -> Columns:
    return {
        "occluded, within the limits' reach": lambda one: _moments(of(one).first_occluded),
        "occluded, at any range": lambda one: _moments(of(one).first_anywhere_occluded),
        "all, within reach": lambda one: _moments(of(one).first),
        "all, at any range": lambda one: _moments(of(one).first_anywhere),
    }


def _glare_table(policies: Sequence[PolicyScore], of: Callable[[PolicyScore], GroupGlare]) -> Table:
    """Dose by range, and of all ranges beside others'."""
    bins = [f"{one.name} ({one.glare.in_sight_s:.0f} s)" for one in of(policies[0]).bins]
    head = ["policy", *bins, "of production's", "of low beam's", "added, lx s"]
    rows = []
    for policy in policies:
        group = of(policy)
        doses = [f"{number(one.glare.dose_lxs)} ({percent(one.above_share)})" for one in group.bins]
        beside = [interval(group.dose_vs_production, percent), interval(group.dose_vs_low, number)]
        rows.append([policy.name, *doses, *beside, number(group.all_bins.glare.added_lxs)])
    return Table(head, rows, [""] * len(rows))


def _longest_s(drive: DriveScore) -> float:
    known = [one.first_glare_s for one in drive.of_group(is_oncoming=True) if not math.isnan(one.first_glare_s)]
    return max(known, default=math.nan)


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else math.nan


DRIVE_COLUMNS: Mapping[str, Callable[[DriveScore], float]] = {
    "oncoming_dose_lxs": lambda one: one.dose_lxs(is_oncoming=True) if one.of_group(is_oncoming=True) else math.nan,
    "preceding_dose_lxs": lambda one: one.dose_lxs(is_oncoming=False) if one.of_group(is_oncoming=False) else math.nan,
    "first_glare_s": _longest_s,
    "own_lane_kept": lambda one: _share(one.present.kept_lxs[0], one.present.full_lxs[0]),
    "verge_kept": lambda one: _share(one.present.kept_lxs[1], one.present.full_lxs[1]),
    "wrong_dimmings": lambda one: float(one.dimming.num_events),
    "minutes_without_vehicle": lambda one: one.dimming.seconds / 60.0,
}


def drive_table(results: GlareResults) -> Table:
    """A row a drive; a column a policy for each of three figures."""
    columns = {
        "dose": ("oncoming_dose_lxs", number),
        "first": ("first_glare_s", number),
        "lane": ("own_lane_kept", percent),
    }
    policies = [one for one in results.policies if one.name not in UNGUIDED] or results.policies
    head = ["drive", "scenario", *(f"{what}: {policy.name}" for what in columns for policy in policies)]
    rows = []
    for place, first in enumerate(results.policies[0].drives):
        cells = [
            words(DRIVE_COLUMNS[name](policy.drives[place])) for name, words in columns.values() for policy in policies
        ]
        rows.append([first.drive, first.scenario, *cells])
    return Table(head, rows, [""] * len(rows))


def interval(one: Interval, words: Callable[[float], str]) -> str:
    """A figure and, in brackets, its interval."""
    if math.isnan(one.low):
        return words(one.value)
    return f"{words(one.value)} [{words(one.low)}, {words(one.high)}]"


def _moments(one: Moments) -> str:
    times = ", ".join(number(value) for value in (one.median, one.mean, one.p90))
    return f"{times}; {percent(one.dark_share)} ({one.num})"
