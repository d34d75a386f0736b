"""The report on the glare experiment: one HTML page with everything in it, the figures beside it, JSON and CSV."""

from __future__ import annotations

import csv
import dataclasses
import html
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from foreglow.files import write_atomic, write_json_results
from foreglow.lab.reports.html import STYLE, html_figure, html_table
from foreglow.lab.reports.numbers import number, percent, signed
from foreglow.lab.studies.detector.tables import Table
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive
from foreglow.lab.studies.glare.eyes import MORE_THAN_LOW, SETTLED_S
from foreglow.lab.studies.glare.figures import (
    bin_figure,
    box_figure,
    corridor_figure,
    lux_figure,
    readme_figure,
    sensitivity_figure,
)
from foreglow.lab.studies.glare.metrics import PRODUCTION, typical_drives
from foreglow.lab.studies.glare.results import GlareResults
from foreglow.lab.studies.glare.road import AHEAD_S, FULL_LEVEL
from foreglow.lab.studies.glare.run import GlareExperiment
from foreglow.lab.studies.glare.tables import (
    DRIVE_COLUMNS,
    UNGUIDED,
    drive_table,
    glare_tables,
    interval,
    occurrence_table,
)
from foreglow.lab.studies.occurrence.metrics import LeadScore
from foreglow.provenance import provenance

VIDEOS = (".mp4", ".webm")


def write_report(
    results: GlareResults,
    shown: Sequence[GlareDrive],
    folder: Path,
    others: Sequence[GlareResults] = (),
    leads: Sequence[LeadScore] = (),
) -> Path:
    """Writes `report.html`, whose path it returns, `results.json`, `drives.csv` and the figures as PNG.

    Args:
        results: All figures.
        shown: Drives to look at, such as those of `typical_drives`; the first with a film, or else the middle one with
            an eye, becomes `readme.png`.
        folder: Is made where it is not there.
        others: The same drives by other limits.
        leads: How well the occurrence of hidden vehicles was told.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    plots = {"boxes.png": box_figure(results), "bins.png": bin_figure(results)}
    for name in dict.fromkeys(one.parameter for one in results.sensitivity):
        points = [one for one in results.sensitivity if one.parameter == name]
        plots[_file_name("sensitivity", name)] = sensitivity_figure(points)
    met = [drive for drive in shown if drive.eyes]
    drive_plots = {drive.name: _drive_plots(drive, results) for drive in met}
    files = plots | {name: plot for one in drive_plots.values() for name, plot in one.items()}
    if met:
        one = next((drive for drive in met if drive.pictures), met[len(met) // 2])
        files["readme.png"] = readme_figure(one, eye_to_show(one).vehicle_id)
    record = results.to_json() | {
        "others": [one.to_json() for one in others],
        "occurrence": [one.to_json() for one in leads],
    }
    write_json_results(folder / "results.json", {"made_with": provenance()} | record)
    write_atomic(folder / "drives.csv", drives_csv(results).encode())
    for name, plot in files.items():
        write_atomic(folder / name, plot)
    report = folder / "report.html"
    write_atomic(
        report,
        "\n".join(
            _lines(results, (*glare_tables(results, others), *occurrence_table(leads)), plots, shown, drive_plots)
        ).encode(),
    )
    return report


def write_experiment(experiment: GlareExperiment) -> Path:
    """Writes the report of a whole experiment into its folder, and returns the path of `report.html`.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    folder = experiment.folder
    films = {file.stem.removeprefix("film_"): file.name for file in sorted(folder.glob("film_*.mp4"))}
    names = dict.fromkeys([*typical_drives(experiment.results), *films])
    shown = [
        dataclasses.replace(drive, pictures={"Paper and ours": films[drive.name]}) if drive.name in films else drive
        for drive in experiment.drives(list(names))
    ]
    return write_report(experiment.results, shown, folder, experiment.others, experiment.leads)


def summary_lines(results: GlareResults, name: str = "foreglow") -> list[str]:
    """What the command says of one policy, a fact a line."""
    score = results.policy(name)
    oncoming, present, empty = score.oncoming, score.present, score.empty
    moments = oncoming.first_occluded
    return [
        f"{name}: glare dose of {oncoming.num_eyes} oncoming drivers {interval(oncoming.dose_vs_production, percent)} "
        f"of production's; {signed(oncoming.all_bins.over_low_lxs)} lx s beside that of the low beam alone",
        f"first glare moment in {moments.num} occluded approaches: median {number(moments.median)} s, "
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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["policy", "drive", "scenario", *DRIVE_COLUMNS])
    for policy in results.policies:
        for drive in policy.drives:
            cells = [values(drive) for values in DRIVE_COLUMNS.values()]
            plain = ["" if math.isnan(value) else f"{value:.6g}" for value in cells]
            writer.writerow([policy.name, drive.drive, drive.scenario, *plain])
    return text.getvalue()


def _drive_plots(drive: GlareDrive, results: GlareResults) -> dict[str, bytes]:
    vehicle_id = eye_to_show(drive).vehicle_id
    policies = [one.name for one in results.policies]
    dark = [name for name in policies if name not in UNGUIDED]
    plots = {_file_name("lux", drive.name): lux_figure(drive, vehicle_id, policies)}
    if dark:
        plots[_file_name("corridor", drive.name)] = corridor_figure(drive, vehicle_id, dark)
    return plots


def _lines(
    results: GlareResults,
    tables: Sequence[tuple[str, str, Table]],
    plots: Mapping[str, bytes],
    shown: Sequence[GlareDrive],
    drive_plots: Mapping[str, Mapping[str, bytes]],
) -> Iterator[str]:
    title = html.escape(f"Glare on {results.name}")
    yield "<!doctype html>"
    yield f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
    yield f"<h1>{title}</h1><p>{html.escape(_preamble(results))}</p>"
    names = [one.name for one in results.policies]
    if "foreglow" in names:
        yield "<ul>"
        yield from (f"<li>{html.escape(line)}</li>" for line in summary_lines(results))
        yield "</ul>"
    for heading, remark, table in tables:
        yield f"<h2>{html.escape(heading)}</h2><p>{html.escape(remark)}</p>"
        yield from html_table(table)
    yield "<h2>All drives</h2>"
    yield from (html_figure(plot, _caption(name)) for name, plot in plots.items())
    for drive in shown:
        yield f"<h2>{html.escape(f'{drive.name} ({drive.scenario})')}</h2>"
        yield from (html_figure(plot, _caption(name)) for name, plot in drive_plots.get(drive.name, {}).items())
        yield from (_picture(caption, path) for caption, path in drive.pictures.items())
    yield "<h2>Drive by drive</h2><p>Dose of oncoming drivers, lx s; longest first glare moment of one of them, s; "
    yield "own lane's light while a vehicle is present, share of full beam.</p>"
    yield from html_table(drive_table(results))
    yield "<h2>What the figures are</h2><ul>"
    yield from (f"<li>{html.escape(note)}</li>" for note in _notes(results))
    yield "</ul></body></html>"


def _preamble(results: GlareResults) -> str:
    drives = results.policies[0].drives
    empty = sum(one.is_empty for one in drives)
    first = results.policies[0]
    return (
        f"{len(drives)} drives, {results.seconds / 60:.1f} minutes, {empty} of them without any other driver; "
        f"{first.oncoming.num_eyes} oncoming and {first.preceding.num_eyes} preceding drivers. Light is computed at "
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
        "Glare of all drives is added before it is divided: each second with a driver in range weighs the same. A "
        f"share of {PRODUCTION}'s dose is a dash where {PRODUCTION} has none. Doses at oncoming eyes and at mirrors "
        "have different limits and are not added."
    )
    yield (
        "A driver's first glare moment is the time with light above the limit, and above "
        f"{MORE_THAN_LOW:g} times the low beam's, from the first sight until there is none for {SETTLED_S:g} s. "
        "Drivers who see us in the first frame of their drive are left out. At any range: the farthest limit is taken "
        "to go on; without that, to come into sight beyond it would count as dark. An approach is occluded if light of "
        "the vehicle is labelled before its driver can see us."
    )
    yield (
        "A vehicle is present from its first labelled light, or first sight of us, until it has passed. Frames below "
        "32 km/h count neither for road light nor for wrong dimming: there low beam is asked for."
    )
    yield (
        f"Wrong dimming: full beam (all LEDs at {FULL_LEVEL:g} or more) goes below full while nobody is there. Nobody "
        f"is there up to {AHEAD_S:g} s before a vehicle's first labelled light, and from {results.restore_s:g} s after "
        "it has passed. A policy that never shines full beam has no event, and is dimmed all the time. Area dimmed: "
        "share of the LEDs' light that is off while dimmed."
    )
    yield "The drives that are shown lie at the quartiles of production's dose; nobody picked them."


def _picture(caption: str, path: str) -> str:
    source, words = html.escape(path), html.escape(caption)
    if path.endswith(VIDEOS):
        shown = f'<video controls style="max-width: 100%" src="{source}"></video>'
    else:
        shown = f'<img style="width: auto; max-width: 100%" alt="{words}" src="{source}">'
    return f'<figure style="margin: 1.5rem 0">{shown}<figcaption>{words}</figcaption></figure>'


def _file_name(kind: str, name: str) -> str:
    """Of a figure: names of scenes and parameters may hold spaces and slashes."""
    return f"{kind}_{re.sub(r'[^A-Za-z0-9.-]+', '_', name)}.png"


def _caption(name: str) -> str:
    for start, words in _CAPTIONS.items():
        if name.startswith(start):
            return words
    raise AssertionError(name)


_CAPTIONS = {
    "boxes": "Drives (points), their quartiles and 5th and 95th percentile",
    "bins": "Dose above the limit by range, all drives together; linear up to 0.1 lx s, logarithmic above",
    "sensitivity": "How the figures move with one parameter, all else as it is",
    "lux": "Light at the other driver's eye; shaded where it is above the limit, the range above",
    "corridor": "Dark gaps over time, and where the vehicle is: dashed while it cannot see us, then solid",
}
