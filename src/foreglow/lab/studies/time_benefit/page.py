"""The report on the time benefit: Markdown with tables, its figures, and the numbers as JSON and CSV."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from foreglow.config import config_to_toml
from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, box_plot, legend_above, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Page, Table, number, percent, signed
from foreglow.lab.studies.time_benefit.metrics import MeanAndSpread, Method, least_delay_s
from foreglow.lab.studies.time_benefit.run import FIVE_FRAMES, TimeBenefitResults

COLOURS = {"single frame": AMBER, "tracker, paper": BLUE, "tracker, ours": GREEN}
CURVE_COLOURS = {"frames": BLUE, "m_of_n": GREY, "evidence": GREEN}
SHOWN = (*COLOURS, "first lamp in sight", "production system")
"""The methods that figures and the table of sequences show."""


def benefit_figure(results: TimeBenefitResults) -> bytes:
    """Box plots: seconds before the production system, and before a human."""
    figure, panels = subplots(2)
    production = np.array([encounter.production_s for encounter in results.encounters])
    human = np.array([encounter.human_s for encounter in results.encounters])
    rows = [*COLOURS, "human"]
    for axes, reference_s, label in zip(panels, (production, human), ("production system", "human"), strict=True):
        names = [name for name in rows if name != label]
        detected = [np.array(results.method(name).benefit.detected_s) for name in names]
        values = [(reference_s - times)[~np.isnan(reference_s - times)] for times in detected]
        colours = [COLOURS.get(name, PALE) for name in names]
        options: dict[str, Any] = {"tick_labels": names, "widths": 0.5, "medianprops": None}
        box_plot(axes, values, colours, alpha=0.6, showmeans=True, showfliers=True, **options)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set(ylabel=f"seconds before the {label}")
        axes.tick_params(axis="x", rotation=20)
    return png(figure)


def sequences_figure(results: TimeBenefitResults) -> bytes:
    """When each method detects, sequence by sequence, from the first annotated artifact."""
    figure, (axes,) = subplots(1, width_in=8.0, height_in=1.6 + 0.24 * len(results.encounters))
    light_s = np.array([encounter.light_s for encounter in results.encounters])
    rows = np.arange(len(results.encounters))
    markers = {"first lamp in sight": ("|", INK), "production system": ("s", GREY)}
    for name in SHOWN:
        marker, colour = markers.get(name, ("o", COLOURS.get(name, INK)))
        size = 60 if marker == "|" else 22
        delays_s = np.array(results.method(name).benefit.detected_s) - light_s
        axes.scatter(delays_s, rows, s=size, color=colour, marker=marker, label=name)
    axes.set_yticks(rows, [f"{met.sequence} {met.scenario}" for met in results.encounters], fontsize=7)
    axes.axvline(0.0, color=AMBER, linewidth=0.8)
    axes.set(xlabel="seconds after the first annotated artifact")
    axes.invert_yaxis()
    legend_above(figure, axes, fontsize=8, ncols=3)
    return png(figure)


def confirmation_figure(results: TimeBenefitResults) -> bytes:
    """Mean time to confirm over false confirmed tracks, a curve for each rule."""
    figure, (axes,) = subplots(1, width_in=6.5)
    for rule, curve in results.curves.items():
        points = sorted((method.false.per_minute, method.delay_s) for method in curve if method.false is not None)
        axes.plot(*np.array(points).T, marker="o", markersize=4, color=CURVE_COLOURS[rule], label=rule)
    paper = results.method("tracker, paper")
    assert paper.false is not None
    axes.plot(paper.false.per_minute, paper.delay_s, "*", color=INK, markersize=11, label="the paper's tracker")
    axes.set(xlabel="false confirmed tracks a minute", ylabel="mean seconds after the first artifact", ylim=(0, None))
    axes.legend(frameon=False)
    return png(figure)


Columns: TypeAlias = Mapping[str, Callable[[Method], object]]


def write_report(results: TimeBenefitResults, folder: Path) -> Path:
    """Writes `results.json`, `config.toml`, `sequences.csv`, three plots and `report.md`, whose path it returns.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    occluded = [encounter for encounter in results.encounters if encounter.is_occluded]
    unreported = [encounter for encounter in results.encounters if math.isnan(encounter.production_s)]
    page = Page(f"Time benefit on {results.name}")
    page.text(
        f"{results.num_sequences} sequences; in {len(results.encounters)} of them a vehicle's light is annotated, in "
        f"{len(occluded)} before its lamps. In {len(unreported)} the production system reports nothing: they are left "
        "out of what is compared with it."
    )
    page.table(Table.of(METHOD_COLUMNS, results.methods))
    page.text(
        "Times are means (medians), seconds. *After light*: from the first annotated artifact. *Before production*, "
        "*human*, *sight*: by how much it is earlier than the production system, a human (0.8 s after the light), the "
        "vehicle's first annotated lamp (occluded vehicles). *Provident*: share of the occluded vehicles that are "
        "detected before that lamp; a missed one counts against it. *Occluded*: before production, of occluded "
        "vehicles. False tracks *an empty minute* are those that come up in an image without any vehicle's light."
    )
    page.figure(Figure(benefit_figure(results), "Seconds before the production system and a human", "benefit.png"))
    _add_curves(page, results)
    page.section("Sequences")
    page.table(_sequence_table(results))
    page.text("Seconds from the first image of the sequence; – for never.")
    page.figure(Figure(sequences_figure(results), "When each method detects, by sequence", "sequences.png"))
    files = {"config.toml": config_to_toml(results.config), "sequences.csv": _sequences_csv(results)}
    return page.write(folder / "report.md", results=results, files=files)


def summary_lines(results: TimeBenefitResults) -> list[str]:
    """What the command says: our tracker in three lines."""
    ours = results.method("tracker, ours")
    assert ours.false is not None
    before, num = ours.benefit.occluded_before_production_s, len(results.encounters)
    num_occluded = sum(encounter.is_occluded for encounter in results.encounters)
    return [
        f"{num} vehicle{'' if num == 1 else 's'}, {num_occluded} of them occluded at first; our tracker confirms "
        f"{percent(ours.benefit.provident_share)} of these before their first lamp",
        f"these {signed(before.mean)} s before the production system (mean of {before.num}), all "
        f"{signed(ours.benefit.before_human_s.mean)} s before a human",
        f"{number(ours.false.per_minute)} false confirmed tracks a minute, {number(ours.false.per_km)} a kilometre",
    ]


METHOD_COLUMNS: Columns = {
    "method": lambda method: method.benefit.name,
    "after light": lambda method: _mean_and_median(method.benefit.delays_s),
    "before production": lambda method: _mean_and_median(method.benefit.before_production_s),
    "occluded": lambda method: _mean_and_median(method.benefit.occluded_before_production_s),
    "before human": lambda method: _mean_and_median(method.benefit.before_human_s),
    "before sight": lambda method: _mean_and_median(method.benefit.before_sight_s),
    "provident": lambda method: percent(method.benefit.provident_share),
    "missed": lambda method: method.benefit.num_missed,
    "false tracks a minute": lambda method: number(getattr(method.false, "per_minute", None)),
    "a km": lambda method: number(getattr(method.false, "per_km", None)),
    "an empty minute": lambda method: number(getattr(method.false, "per_empty_minute", None)),
}

CURVE_COLUMNS: Columns = {
    "setting": METHOD_COLUMNS["method"],
    "mean after light, s": lambda method: number(method.delay_s),
    **{head: METHOD_COLUMNS[head] for head in ("false tracks a minute", "a km", "provident", "missed")},
}


def _add_curves(page: Page, results: TimeBenefitResults) -> None:
    page.section(
        "Confirmation: how soon, and how often in vain",
        "All rules with our tracker's association. The least mean time after the light, with at most as many false "
        "confirmed tracks as",
    )
    five = next(method for method in results.curves["frames"] if method.benefit.name == FIVE_FRAMES)
    compared = {"five frames with our association": five, "the paper's tracker": results.method("tracker, paper")}
    page.items(_comparison(name, method, results) for name, method in compared.items())
    page.text(
        "Here a vehicle that a rule does not confirm before the production system reports it, or the sequence ends, "
        "counts as confirmed then."
    )
    rows = [
        [rule, *(cell(method) for cell in CURVE_COLUMNS.values())]
        for rule, curve in results.curves.items()
        for method in curve
    ]
    page.table(Table(["rule", *CURVE_COLUMNS], rows))
    page.figure(Figure(confirmation_figure(results), "Time to confirm over false confirmed tracks", "confirmation.png"))


def _comparison(name: str, method: Method, results: TimeBenefitResults) -> str:
    """How much earlier each rule confirms than `method` does, at its rate of false tracks."""
    assert method.false is not None
    limit = method.false.per_minute
    delays_s = {rule: least_delay_s(curve, limit) for rule, curve in results.curves.items()}
    rules = ", ".join(
        f"{rule} {number(delay_s)} s ({signed(method.delay_s - delay_s)} s earlier)"
        for rule, delay_s in delays_s.items()
    )
    return f"{name} ({number(limit)} a minute, {number(method.delay_s)} s): {rules}"


def _sequence_table(results: TimeBenefitResults) -> Table:
    times_s = zip(*(results.method(name).benefit.detected_s for name in SHOWN), strict=True)
    rows = [
        [
            encounter.sequence,
            encounter.scenario or DASH,
            encounter.vehicle,
            *map(number, (encounter.light_s, *detected)),
        ]
        for encounter, detected in zip(results.encounters, times_s, strict=True)
    ]
    return Table(["sequence", "scenario", "vehicle", "light", *SHOWN], rows)


def _sequences_csv(results: TimeBenefitResults) -> str:
    """A row for each sequence; empty for never."""
    head = ["sequence", "scenario", "vehicle", "is_occluded", "duration_s", "light_s"]
    detected_s = zip(*(method.benefit.detected_s for method in results.methods), strict=True)
    rows = [
        [
            *(encounter.sequence, encounter.scenario, encounter.vehicle, int(encounter.is_occluded)),
            *(number(time_s, 4, "") for time_s in (encounter.duration_s, encounter.light_s, *times_s)),
        ]
        for encounter, times_s in zip(results.encounters, detected_s, strict=True)
    ]
    return Table([*head, *(f"{method.benefit.name} s" for method in results.methods)], rows).csv()


def _mean_and_median(values: MeanAndSpread) -> str:
    return f"{number(values.mean)} ({number(values.median)})" if values.num else DASH
