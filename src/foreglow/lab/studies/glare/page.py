"""The report on the glare experiment: one HTML page with everything in it, the figures beside it, JSON and CSV."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from foreglow.display.summary_lines import counted
from foreglow.files import to_json
from foreglow.lab.evaluation.occurrence import LeadScore
from foreglow.lab.evaluation.ratios import ratio
from foreglow.lab.reports.page import Figure, Page, Table, number, percent, signed
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive
from foreglow.lab.studies.glare.eyes import MORE_THAN_LOW, SETTLED_S
from foreglow.lab.studies.glare.figures import (
    README_WIDTH_IN,
    bin_figure,
    box_figure,
    corridor_figure,
    lux_figure,
    seconds,
    sensitivity_figure,
)
from foreglow.lab.studies.glare.loop import BODY_MARGIN_M, EXACT_MARGIN_DEG
from foreglow.lab.studies.glare.pooled import BinGlare, DriveScore, GroupGlare, Interval, Moments, WrongDimming
from foreglow.lab.studies.glare.road import AHEAD_S, FULL_LEVEL, JUMP, SWITCH_S
from foreglow.lab.studies.glare.run import GlareExperiment
from foreglow.lab.studies.glare.scores import POLICY_ROWS, PRODUCTION, GlareResults, PolicyScore, typical_drives
from foreglow.lab.studies.occurrence.run import REMARK, occurrence_table

Columns: TypeAlias = Mapping[str, Callable[[PolicyScore], str]]
"""By head, what stands in a policy's cell."""

UNGUIDED = ("low", "high")
"""Policies that see nothing; they have no gaps, and no column in the table of drives."""

IN_README = ("low", "production", "paper", "foreglow")
"""Policies of the figure for the README."""


def write_report(
    results: GlareResults,
    shown: Sequence[GlareDrive],
    folder: Path,
    others: Sequence[GlareResults] = (),
    leads: Sequence[LeadScore] = (),
    remarks: Sequence[str] = (),
) -> Path:
    """Writes `report.html`, whose path it returns, `results.json`, `drives.csv` and the figures as PNG.

    Args:
        results: All figures.
        shown: Drives to look at, such as those of `typical_drives`; the first with a film, or else the middle one with
            an eye, becomes `readme.png`.
        folder: Is made where it is not there.
        others: The same drives by other limits.
        leads: How well it was predicted where hidden vehicles appear.
        remarks: What else to say of the drives at the beginning.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    page = Page(f"Glare on {results.name}")
    page.text(_preamble(results), *remarks)
    names = [policy.name for policy in results.policies]
    if own_policy(results) in names:
        page.items(summary_lines(results))
    for heading, remark, table in _tables(results, others):
        page.section(heading, remark)
        page.table(table)
    if leads:
        page.section("Occurrence point", REMARK)
        page.table(occurrence_table(leads))
    page.section("All drives")
    for figure in _figures(results):
        page.figure(figure)
    for drive in shown:
        page.section(f"{drive.name} ({drive.scenario})")
        for figure in _drive_figures(drive, names) if drive.eyes else ():
            page.figure(figure)
        for caption, path in drive.pictures.items():
            page.media(path, caption)
    page.section(
        "Drive by drive",
        "Dose of oncoming drivers, lx s; longest first glare moment of one of them, s; own lane's light while a "
        "vehicle is present, share of full beam.",
    )
    page.table(_drive_table(results))
    page.section("What the figures are")
    page.items(_notes(results))
    record = {**to_json(results), "others": others, "occurrence": leads}
    files: dict[str, bytes | str] = {"drives.csv": drives_csv(results)}
    files |= _readme_figure([drive for drive in shown if drive.eyes])
    scenes = [drive.drive for drive in results.policies[0].drives]
    earlier = ["readme.png", *(_file_name(kind, name) for name in scenes for kind in ("lux", "corridor"))]
    return page.write(folder / "report.html", results=record, files=files, earlier=earlier)


def write_experiment(experiment: GlareExperiment) -> Path:
    """Writes the report of a whole experiment into its folder, and returns the path of `report.html`.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    folder = experiment.folder
    films = {file.stem.removeprefix("film_"): file.name for file in sorted(folder.glob("film_*.mp4"))}
    names = list(dict.fromkeys([*typical_drives(experiment.results), *films]))
    drives = experiment.drives(names)
    shown = [
        dataclasses.replace(drive, pictures={"Paper and ours": films[drive.name]}) if drive.name in films else drive
        for drive in drives
    ]
    return write_report(experiment.results, shown, folder, experiment.others, experiment.leads, experiment.remarks)


def own_policy(results: GlareResults) -> str:
    """The row of our pipeline: `foreglow`, or the one that a user has chosen in its place, before those of `--also`."""
    names = [policy.name for policy in results.policies]
    return next((name for name in names if name not in POLICY_ROWS and "foreglow" not in names), "foreglow")


def summary_lines(results: GlareResults) -> list[str]:
    """What the command says of the policy that the experiment is about, a fact a line."""
    name = own_policy(results)
    score = results.policy(name)
    oncoming, present, empty = score.oncoming, score.present, score.empty
    moments, beside_low = oncoming.first_occluded, signed(oncoming.known_lxs(oncoming.all_bins.over_low_lxs))
    return [
        f"glare dose of {counted(oncoming.num_eyes, 'oncoming driver')} with {name}: "
        f"{interval(oncoming.dose_vs_production, percent)} of production's; {beside_low} lx s beside that of the low "
        "beam alone",
        f"first glare moment in {counted(moments.num, 'occluded approach')}: median {number(moments.median)} s, "
        f"mean {number(moments.mean)} s, {percent(moments.dark_share)} dark from the beginning",
        f"light kept on the own lane while a vehicle is present: {interval(present.own_lane, percent)} of full beam "
        f"(low beam {percent(present.low_own_lane)}), after it {percent(score.passed.own_lane.value)}",
        f"wrong dimming a minute in drives without any vehicle: {number(empty.events_per_minute.value)} "
        f"({number(empty.minutes, 1)} minutes)",
    ]


def eye_to_show(drive: GlareDrive) -> DriverEye:
    """The oncoming driver whose light is first to be labelled before the first sight, else any.

    Raises:
        ValueError: If nobody is there.
    """
    if not drive.eyes:
        raise ValueError(f"drive {drive.name}: expected another driver, there is none")

    def rank(eye: DriverEye) -> tuple[bool, bool, float]:
        light_s = drive.light_s.get(eye.vehicle_id, math.inf)
        return not eye.is_oncoming, not eye.is_in_sight.any(), light_s

    return min(drive.eyes, key=rank)


def drives_csv(results: GlareResults) -> str:
    """A row for each policy and drive; empty for what is not defined."""
    rows = []
    for policy in results.policies:
        for drive in policy.drives:
            values = [value_of(drive) for value_of in DRIVE_COLUMNS.values()]
            cells = ["" if math.isnan(value) else f"{value:.6g}" for value in values]
            rows.append([policy.name, drive.drive, drive.scenario, *cells])
    return Table(["policy", "drive", "scenario", *DRIVE_COLUMNS], rows).csv()


def _figures(results: GlareResults) -> Iterator[Figure]:
    words = "Drives (points), their quartiles and 5th and 95th percentile"
    yield Figure(box_figure(results), words, "boxes.png")
    words = "Dose above the limit by range, all drives together; linear up to 0.1 lx s, logarithmic above"
    yield Figure(bin_figure(results), words, "bins.png")
    for name in dict.fromkeys(point.parameter for point in results.sensitivity):
        points = [point for point in results.sensitivity if point.parameter == name]
        words = "How the figures move with one parameter, all else as it is"
        yield Figure(sensitivity_figure(points), words, _file_name("sensitivity", name))


def _drive_figures(drive: GlareDrive, policies: Sequence[str]) -> Iterator[Figure]:
    vehicle_id = eye_to_show(drive).vehicle_id
    words = "Light at the other driver's eye; shaded where it is above the limit, the range above"
    yield Figure(lux_figure(drive, vehicle_id, policies), words, _file_name("lux", drive.name))
    guided = [name for name in policies if name not in UNGUIDED]
    if guided:
        words = "Dark gaps over time, and where the vehicle is: dashed while it cannot see us, then solid"
        yield Figure(corridor_figure(drive, vehicle_id, guided), words, _file_name("corridor", drive.name))


def _readme_figure(drives: Sequence[GlareDrive]) -> dict[str, bytes]:
    if not drives:
        return {}
    drive = next((drive for drive in drives if drive.pictures), drives[len(drives) // 2])
    policies = [name for name in IN_README if name in drive.runs]
    vehicle_id = eye_to_show(drive).vehicle_id
    return {"readme.png": lux_figure(drive, vehicle_id, policies, README_WIDTH_IN, height_in=3.5, font_size=8.0)}


def _file_name(kind: str, name: str) -> str:
    """Of a figure: names of scenes and parameters may hold spaces and slashes."""
    return f"{kind}_{re.sub(r'[^A-Za-z0-9.-]+', '_', name)}.png"


def _preamble(results: GlareResults) -> str:
    first = results.policies[0]
    empty = sum(drive.is_empty for drive in first.drives)
    return (
        f"{counted(len(first.drives), 'drive')}, {results.seconds / 60:.1f} minutes, {empty} of them without any other "
        f"driver; {counted(first.oncoming.num_eyes, 'oncoming driver')} and "
        f"{counted(first.preceding.num_eyes, 'preceding driver')}. Light is computed at "
        f"their eyes, with all that is in between. Limits: {results.limits}."
    )


def _notes(results: GlareResults) -> Iterator[str]:
    yield (
        "The limits are transcribed from public notes of the regulations, not from the official texts, and the "
        "regulations' test procedures are not followed: light is compared frame by frame and is not rounded. Nothing "
        "here is a statement of compliance. UN R123 limits the intensity towards drivers 50, 100 and 200 m away; what "
        "is drawn is the illuminance of two such lamps, in between a straight line."
    )
    yield (
        f"{PRODUCTION} and oracle have exact gaps: around the whole body, with {BODY_MARGIN_M:g} m and "
        f"{EXACT_MARGIN_DEG:g}° more on either side, in which each LED gives no more than led_limit_lx. A policy with "
        "narrower margins may keep more light than the oracle, and one with a guard, which limits all LEDs of a lamp "
        "together, may shine less into the gap."
    )
    yield (
        "Glare of all drives is added before it is divided: each second with a driver in range weighs the same. A "
        f"share of {PRODUCTION}'s dose is a dash where {PRODUCTION} has none. Doses at oncoming eyes and at mirrors "
        "have different limits and are not added."
    )
    yield (
        "A driver's first glare moment is the time with light above the limit, and above "
        f"{MORE_THAN_LOW:g} times the low beam's, from the first sight until there is none for {SETTLED_S:g} s. "
        "Shorter interruptions do not end it, and are not counted. "
        "Drivers who see us in the first frame of their drive are left out. At any range: the farthest limit is taken "
        "to go on; without that, to come into sight beyond it would count as dark. An approach is occluded if light of "
        "the vehicle is labelled before its driver can see us, and something stands in between, not the distance alone."
    )
    yield (
        "A vehicle is present from its first labelled light, or first sight of us, until it has passed. Frames below "
        "32 km/h, and on lit roads, count neither for road light nor for wrong dimming: there low beam is asked for."
    )
    yield (
        f"Wrong dimming: full beam (all LEDs at {FULL_LEVEL:g} or more) goes below full while nobody is there. Nobody "
        f"is there up to {AHEAD_S:g} s before a vehicle's first labelled light, and from {results.after_s:g} s after "
        "it has passed. A policy that never shines full beam has no event, and is dimmed all the time. Area dimmed: "
        "share of the LEDs' light that is off while dimmed."
    )
    yield "The drives that are shown lie at the quartiles of production's dose; nobody picked them."


def _tables(results: GlareResults, others: Sequence[GlareResults]) -> Iterator[tuple[str, str, Table]]:
    policies = results.policies
    yield (
        "Policies",
        "Dose: light above the limit at oncoming drivers' eyes, over time. In brackets: 95 % interval over drives, "
        "which has no width, and says nothing, where all are alike. "
        "First glare moment of drivers whose light was there before: median, mean, and share that has none. Light "
        "kept: share of the full high beam's while a vehicle is present, and after. Wrong: dimming for nobody.",
        _table(_MAIN, policies),
    )
    groups: dict[str, Callable[[PolicyScore], GroupGlare]] = {"Oncoming drivers": lambda policy: policy.oncoming}
    if policies[0].preceding.num_eyes:
        groups["Preceding drivers"] = lambda policy: policy.preceding
    for heading, of in groups.items():
        yield (
            heading,
            "Dose in lx s by range (share of the time in sight above the limit); seconds in sight in the head. Added: "
            "what the LEDs add to the low beam while the whole is above the limit.",
            _table(_glare_columns(of, of(policies[0]).bins), policies),
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
        f"is what no light above it means. After: from {results.after_s:g} s after the vehicle has passed.",
        _table(_ROAD, policies),
    )
    yield (
        "Wrong dimming",
        "In drives without any other driver.",
        _table(_dimming_columns(lambda policy: policy.empty), policies),
    )
    yield (
        "Wrong dimming in other drives",
        "While nobody is there yet, or any more.",
        _table(_dimming_columns(lambda policy: policy.between), policies),
    )
    if any(policy.lit_roads.num_streets for policy in policies):
        yield (
            "Lit roads",
            f"High beam more than {SWITCH_S:g} s after a lit road begins is a fault. There is no wrong dimming there.",
            _table(_LIT_ROADS, policies),
        )
    yield "Switching", "Changes of the road's light, as a share of full beam.", _table(_SWITCHING, policies)


def _table(columns: Columns, policies: Sequence[PolicyScore]) -> Table:
    return Table.of({"policy": lambda policy: policy.name, **columns}, policies)


_GLARE: Columns = {
    "dose, lx s": lambda policy: number(policy.oncoming.known_lxs(policy.oncoming.all_bins.glare.dose_lxs)),
    "of production's": lambda policy: interval(policy.oncoming.dose_vs_production, percent),
    "over low beam's": lambda policy: signed(policy.oncoming.known_lxs(policy.oncoming.all_bins.over_low_lxs)),
    "first glare, s": lambda policy: number(policy.oncoming.first_occluded.median),
    "mean, s": lambda policy: number(policy.oncoming.first_occluded.mean),
    "none": lambda policy: percent(policy.oncoming.first_occluded.dark_share),
}

_MAIN: Columns = {
    **_GLARE,
    "own lane kept": lambda policy: interval(policy.present.own_lane, percent),
    "verge kept": lambda policy: percent(policy.present.verge.value),
    "own lane after": lambda policy: percent(policy.passed.own_lane.value),
    "wrong a minute": lambda policy: number(policy.empty.events_per_minute.value),
}

_ROAD: Columns = {
    "own lane": lambda policy: interval(policy.present.own_lane, percent),
    "low beam alone, own lane": lambda policy: percent(policy.present.low_own_lane),
    "verge": lambda policy: interval(policy.present.verge, percent),
    "low beam alone, verge": lambda policy: percent(policy.present.low_verge),
    "seconds": lambda policy: number(policy.present.seconds, 1),
    "own lane after": lambda policy: percent(policy.passed.own_lane.value),
    "verge after": lambda policy: percent(policy.passed.verge.value),
    "seconds after": lambda policy: number(policy.passed.seconds, 1),
}

_LIT_ROADS: Columns = {
    "minutes": lambda policy: number(policy.lit_roads.minutes, 1),
    "with high beam": lambda policy: percent(policy.lit_roads.high_share),
    "streets": lambda policy: str(policy.lit_roads.num_streets),
    "low beam in time": lambda policy: percent(policy.lit_roads.switched_share),
    "minutes on dark roads": lambda policy: number(policy.lit_roads.dark_minutes, 1),
    "switched to low beam there, an hour": lambda policy: number(policy.lit_roads.low_per_hour, 1),
}

_SWITCHING: Columns = {
    "change a second": lambda policy: percent(policy.smoothness.change_per_s),
    f"falls > {JUMP:.0%} a minute": lambda policy: number(policy.smoothness.falls_per_minute, 1),
    f"rises > {JUMP:.0%} a minute": lambda policy: number(policy.smoothness.rises_per_minute, 1),
    "variation of levels a second": lambda policy: number(policy.smoothness.level_change_per_s, 3),
}


def _dimming_columns(of: Callable[[PolicyScore], WrongDimming]) -> Columns:
    return {
        "minutes": lambda policy: number(of(policy).minutes, 1),
        "events": lambda policy: str(of(policy).num_events),
        "a minute": lambda policy: interval(of(policy).events_per_minute, number),
        "shallow and short": lambda policy: str(of(policy).num_questions),
        "light lost": lambda policy: percent(of(policy).light_lost),
        "time dimmed": lambda policy: percent(of(policy).dimmed_share),
        "area dimmed": lambda policy: percent(of(policy).area_dimmed),
        "road light lost while dimmed": lambda policy: percent(of(policy).road_dimmed),
    }


def _moment_columns(of: Callable[[PolicyScore], GroupGlare]) -> Columns:
    return {
        "occluded, within the limits' reach": lambda policy: _moments(of(policy).first_occluded),
        "occluded, at any range": lambda policy: _moments(of(policy).first_anywhere_occluded),
        "all, within reach": lambda policy: _moments(of(policy).first),
        "all, at any range": lambda policy: _moments(of(policy).first_anywhere),
    }


def _glare_columns(of: Callable[[PolicyScore], GroupGlare], bins: Sequence[BinGlare]) -> Columns:
    """Dose by range, and of all ranges beside others'."""

    def dose(index: int) -> Callable[[PolicyScore], str]:
        return lambda policy: (
            f"{number(of(policy).known_lxs(of(policy).bins[index].glare.dose_lxs))} "
            f"({percent(of(policy).bins[index].above_share)})"
        )

    return {
        **{f"{part.name} ({seconds(part.glare.in_sight_s)})": dose(index) for index, part in enumerate(bins)},
        "of production's": lambda policy: interval(of(policy).dose_vs_production, percent),
        "of low beam's": lambda policy: interval(of(policy).dose_vs_low, number),
        "added, lx s": lambda policy: number(of(policy).known_lxs(of(policy).all_bins.glare.added_lxs)),
    }


def _dose_lxs(drive: DriveScore, is_oncoming: bool) -> float:
    return drive.dose_lxs(is_oncoming) if drive.of_group(is_oncoming) else math.nan


def _longest_first_glare_s(drive: DriveScore) -> float:
    times_s = (eye.first_glare_s for eye in drive.of_group(is_oncoming=True))
    return max((time_s for time_s in times_s if not math.isnan(time_s)), default=math.nan)


DRIVE_COLUMNS: Mapping[str, Callable[[DriveScore], float]] = {
    "oncoming_dose_lxs": lambda drive: _dose_lxs(drive, is_oncoming=True),
    "preceding_dose_lxs": lambda drive: _dose_lxs(drive, is_oncoming=False),
    "first_glare_s": _longest_first_glare_s,
    "own_lane_kept": lambda drive: ratio(drive.present.kept_lxs[0], drive.present.full_lxs[0]),
    "verge_kept": lambda drive: ratio(drive.present.kept_lxs[1], drive.present.full_lxs[1]),
    "wrong_dimmings": lambda drive: float(drive.dimming.num_events),
    "minutes_without_vehicle": lambda drive: drive.dimming.seconds / 60.0,
}
"""The figures of each drive by name."""


def _drive_table(results: GlareResults) -> Table:
    """A row a drive; a column a policy for each of three figures."""
    columns = {
        "dose": ("oncoming_dose_lxs", number),
        "first": ("first_glare_s", number),
        "lane": ("own_lane_kept", percent),
    }
    policies = [policy for policy in results.policies if policy.name not in UNGUIDED] or results.policies
    head = ["drive", "scenario", *(f"{what}: {policy.name}" for what in columns for policy in policies)]
    rows = []
    for drives in zip(*(policy.drives for policy in policies), strict=True):
        cells = [words(DRIVE_COLUMNS[name](drive)) for name, words in columns.values() for drive in drives]
        rows.append([drives[0].drive, drives[0].scenario, *cells])
    return Table(head, rows)


def interval(figure: Interval, words: Callable[[float], str]) -> str:
    """A figure and, in brackets, its interval."""
    if math.isnan(figure.low):
        return words(figure.value)
    return f"{words(figure.value)} [{words(figure.low)}, {words(figure.high)}]"


def _moments(moments: Moments) -> str:
    times_s = ", ".join(map(number, (moments.median, moments.mean, moments.p90)))
    return f"{times_s}; {percent(moments.dark_share)} ({moments.num})"
